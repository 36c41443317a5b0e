"""What is compiled before a flight: all that its ticks run through."""

from __future__ import annotations

import numpy as np

from companion.config.load import load_settings
from companion.flight.warm_up import Eyes, come_home, moved
from companion.model import Observation, Pose
from companion.pipeline import Explorer


def test_the_way_home_is_compiled_before_a_flight_with_its_recognition_of_places() -> None:
    """Protects the turning back: compiled there, it took half a second without a setpoint: the gate braked."""
    settings = load_settings(None, "flight")
    explorer, eyes = Explorer(settings, np.random.default_rng(1)), Eyes(settings)
    pose = Pose(0.0, -8.0, 0.3, settings.control.height_m, 0.2)
    for _ in range(20):
        seen = Observation(pose.t_s, pose, eyes.frame(pose, read_only=False), eyes.ranges(pose))
        pose = moved(pose, explorer.step(seen).setpoint, settings.control.period_s)
    assert come_home(explorer, eyes, pose, settings.control.period_s) > 0
