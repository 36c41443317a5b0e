"""A pause on the way home: what it leaves as it was, and what is asked without steering."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from companion.config.load import load_settings
from companion.control.homing.homing import NEAR_M, PATIENCE_S
from companion.flight.warm_up import Eyes
from companion.model import Observation, Pose
from companion.pipeline import Explorer, Order

SETTINGS = load_settings(None, "flight")
PERIOD_S = SETTINGS.control.period_s
OFF_M = 1.0
"""Nearer than what is near enough after long enough, further off than what is home."""


class Flight:
    """In a cross of tunnels, one second after it began."""

    def __init__(self) -> None:
        self.explorer, self._eyes = Explorer(SETTINGS, np.random.default_rng(1)), Eyes(SETTINGS)
        self.pose = Pose(0.0, -8.0, 0.3, SETTINGS.control.height_m, 0.2)
        self.fly(Order.EXPLORE, 1.0)

    def fly(self, order: Order, duration_s: float, period_s: float = PERIOD_S) -> None:
        """Stand where it is, as if something held it there."""
        for _ in range(round(duration_s / period_s)):
            pose = self.pose
            seen = Observation(pose.t_s, pose, self._eyes.frame(pose, read_only=False), self._eyes.ranges(pose))
            self.measurement = self.explorer.step(seen, order).measurement
            self.pose = replace(pose, t_s=pose.t_s + period_s)


@pytest.mark.parametrize("order", [Order.WAIT, Order.HOME])
def test_a_pause_before_home_is_not_taken_for_something_that_stands_there(order: Order) -> None:
    """Protects the last metre: held up for so long it would be near enough; paused for so long it is not."""
    assert OFF_M < NEAR_M
    flight = Flight()
    flight.pose = replace(flight.pose, x_m=flight.pose.x_m + OFF_M)
    flight.fly(Order.HOME, 1.0)
    flight.fly(order, PATIENCE_S + 5.0, period_s=0.25)
    flight.fly(Order.HOME, 3.0)
    assert flight.explorer.navigator.is_home is (order is Order.HOME)


def test_who_asks_how_far_home_is_does_not_steer() -> None:
    """Protects the replay, in which nobody asks: the search that is asked for must not be the one that is flown by."""
    flight = Flight()
    flight.fly(Order.HOME, 1.0)
    homing = flight.explorer.navigator.homing
    assert homing.homeward is not None
    before = dict(vars(homing.homeward))
    later = replace(flight.measurement, t_s=flight.measurement.t_s + 60.0)
    assert flight.explorer.navigator.way_home(later, flight.pose) is not None
    assert vars(homing.homeward) == before
