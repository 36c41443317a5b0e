"""The tick: observe, measure, steer. The same in flight, in simulation and in replay."""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np

from companion.config.settings import Settings
from companion.control.fleet import Fleet
from companion.control.known_ground import Outlook
from companion.control.navigator import Navigator
from companion.control.separation import Back, Clearance, Separation, Spacing
from companion.model import Input, Measurement, Mode, Observation, Setpoint
from companion.perception import Extractor


@enum.unique
class Order(enum.StrEnum):
    """What the navigator is told at a tick in which it steers."""

    EXPLORE = "explore"
    HOME = "home"
    """From now on home; after the first of these nothing leads back to exploring."""
    WAIT = "wait"
    """A person has paused the flight, or another vehicle is too near: stand, and go on with what was before."""


@dataclass(frozen=True, slots=True)
class Steering:
    """What a tick made of its observation."""

    measurement: Measurement
    setpoint: Setpoint


@dataclass(frozen=True, slots=True)
class Tick:
    """One sampling period, for whoever watches: the recording, the map, pilot and operator.

    Arrays in it must not be written to any more: they are encoded later, in another thread.

    Attributes:
        t_s: when it began.
        observation: exactly what the extractor was given; None while no pose is known.
        measurement: what it made of that; None without an observation.
        setpoint: what the navigator wants; None: nothing is to be sent, which is silence on the wire.
        mode: the navigator's mode after the tick; hold while it does not steer.
        sent: whether the setpoint went out to the autopilot.
        height_m: H, the height above ground that the navigator was to keep.
        duration_s: from the start of the tick until it was done.
        stepped: whether the navigator was asked, which changes what it remembers, even where its answer was not used.
        order: what it was told then.
    """

    t_s: float
    observation: Observation | None
    measurement: Measurement | None
    setpoint: Setpoint | None
    mode: Mode
    sent: bool
    height_m: float
    duration_s: float
    stepped: bool
    order: Order = Order.EXPLORE

    @property
    def missing(self) -> tuple[Input, ...]:
        """The inputs that were absent or stale."""
        return (Input.POSE,) if self.measurement is None else self.measurement.missing

    def known(self) -> tuple[Observation, Measurement]:
        """What the tick saw, and what it made of that.

        Raises:
            ValueError: it had no pose.
        """
        if self.observation is None or self.measurement is None:
            raise ValueError(f"the tick at {self.t_s} s had no pose")
        return self.observation, self.measurement


def spacing(settings: Settings) -> Spacing:
    """How far from each other vehicles with these settings are to be."""
    fleet, control = settings.fleet, settings.control
    layer_m = fleet.tunnel_height_m / (fleet.largest_group + 1)
    return Spacing(
        apart_m=control.vertical_margin_m,
        keep_m=2.0 * settings.vehicle.body_radius_m + fleet.margin_m,
        speed_mps=control.speed_mps,
        reaction_s=control.governor.reaction_s,
        brake_mps2=control.governor.brake_mps2,
        slope=settings.sensors.scan.max_ground_slope,
        body_height_m=settings.vehicle.body_height_m,
        lowest_m=layer_m,
        highest_m=fleet.largest_group * layer_m,
    )


def fleet_of(settings: Settings, own_id: int) -> tuple[Fleet, Separation]:
    """What a vehicle with these settings knows of others, and what keeps it apart from them.

    Whoever has to brake for another one is in a group with it, however small d_r is: only so do they come apart.
    """
    apart = spacing(settings)
    fleet = Fleet(
        own_id,
        group_range_m=max(settings.fleet.group_range_m, apart.near_m + apart.stop_m),
        tunnel_height_m=settings.fleet.tunnel_height_m,
        stale_after_s=settings.fleet.stale_after_s,
    )
    return fleet, Separation(fleet, apart, settings.control.height_m, settings.fleet.stale_after_s)


DENSE_VOXELS = 1.5
"""Rows of a picture that meet a floor no further apart leave no holes in the map: the next picture is of elsewhere."""


class Explorer:
    """From observations to setpoints. Knows no clock: the time of a tick is that of its observation.

    Args:
        settings: the whole configuration.
        rng: the only source of randomness.
    """

    def __init__(self, settings: Settings, rng: np.random.Generator) -> None:
        camera = settings.sensors.camera
        reach_m = min(camera.max_range_m, settings.mapping.max_range_m)
        dense_m = DENSE_VOXELS * settings.mapping.voxel_m * camera.model().fy_px
        self.navigator = Navigator(
            settings.control, rng, Outlook.of(*camera.elevations_rad(), *camera.bearings_rad(), reach_m, dense_m)
        )
        self.goes_back = False
        """The ground below has ended: it goes back the way that it came, and neither waits nor is landed before."""
        self._extractor = Extractor(settings.sensors, settings.vehicle, settings.control.height_m)

    def look(self, observation: Observation) -> Measurement:
        """Measure without steering: on the ground, and while the pilot flies."""
        return self._extractor.measure(observation)

    def step(self, observation: Observation, order: Order = Order.EXPLORE, beneath: tuple[Back, ...] = ()) -> Steering:
        """One sampling period: measure, then execute the navigation law, or wait.

        Args:
            observation: what the sensors said.
            order: what it is told.
            beneath: the other vehicles that it may be above.
        """
        measurement = self._extractor.measure(observation, beneath)
        if order is Order.HOME:
            self.navigator.go_home(observation.t_s)
        is_holding = self.navigator.status.mode is Mode.HOLD
        self.goes_back = measurement.over_shaft or (self.goes_back and is_holding)
        # Whoever lets it wait: over a shaft it would be landed for want of a height.
        waits = order is Order.WAIT and not self.goes_back
        steer = self.navigator.wait if waits else self.navigator.step
        return Steering(measurement, steer(measurement, observation.pose, observation.t_s))

    def apart(self, setpoint: Setpoint, clearance: Clearance, yaw_rad: float) -> Setpoint:
        """What is asked for, no nearer to other vehicles; but back from over a shaft in any case.

        Who stood there would be landed for want of a height.

        Args:
            setpoint: of the last step.
            clearance: what the others leave it to do.
            yaw_rad: the heading, in the frame that the vehicles share.
        """
        return setpoint if self.goes_back else clearance.limited(setpoint, yaw_rad)
