"""The tick: observe, measure, steer. The same in flight, in simulation and in replay."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.config.settings import Settings
from companion.control.navigator import Navigator
from companion.model import Measurement, Observation, Setpoint
from companion.perception import Extractor


@dataclass(frozen=True, slots=True)
class Steering:
    """What a tick made of its observation."""

    measurement: Measurement
    setpoint: Setpoint


class Explorer:
    """From observations to setpoints. Knows no clock: the time of a tick is that of its observation.

    Args:
        settings: the whole configuration.
        rng: the only source of randomness.
    """

    def __init__(self, settings: Settings, rng: np.random.Generator) -> None:
        self.navigator = Navigator(settings.control, rng)
        self._extractor = Extractor(settings.sensors, settings.vehicle)

    def look(self, observation: Observation) -> Measurement:
        """Measure without steering: on the ground, and while the pilot flies."""
        return self._extractor.measure(observation)

    def step(self, observation: Observation) -> Steering:
        """One sampling period: measure, then execute the navigation law."""
        measurement = self._extractor.measure(observation)
        return Steering(measurement, self.navigator.step(measurement, observation.pose, observation.t_s))
