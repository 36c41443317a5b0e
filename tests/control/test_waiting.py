"""Waiting: what a pause on the way home leaves as it was, what is asked without steering, and where nobody waits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.config.load import load_settings
from companion.control.homing.homing import NEAR_M, PATIENCE_S
from companion.control.separation import Clearance
from companion.control.trail import BACK_M, BACK_MPS
from companion.flight.warm_up import Eyes
from companion.model import Beam, Observation, Pose, RangeReading, Setpoint
from companion.pipeline import Explorer, Order, spacing
from companion.station_keeping import MOST_MPS

SETTINGS = load_settings(None, "flight")
PERIOD_S = SETTINGS.control.period_s
OFF_M = 1.0
"""Nearer than what is near enough after long enough, further off than what is home."""


class Flight:
    """In a cross of tunnels, one second after it began.

    Attributes:
        has_ground: whether the beam downward sees any.
        speed_mps: how fast something moves it along x.
    """

    def __init__(self) -> None:
        self.has_ground, self.speed_mps = True, 0.0
        self.explorer, self._eyes = Explorer(SETTINGS, np.random.default_rng(1)), Eyes(SETTINGS)
        self.pose = Pose(0.0, -8.0, 0.3, SETTINGS.control.height_m, 0.2)
        self.fly(Order.EXPLORE, 1.0)

    def fly(self, order: Order, duration_s: float, period_s: float = PERIOD_S) -> None:
        """Whatever is asked, something moves it as it is said, or holds it where it is."""
        for _ in range(round(duration_s / period_s)):
            pose = self.pose
            seen = Observation(pose.t_s, pose, self._eyes.frame(pose, read_only=False), self._ranges(pose))
            steering = self.explorer.step(seen, order)
            self.measurement, self.setpoint = steering.measurement, steering.setpoint
            self.pose = replace(pose, t_s=pose.t_s + period_s, x_m=pose.x_m + self.speed_mps * period_s)

    def towards_mps(self, setpoint: Setpoint) -> float:
        """What is asked for along x."""
        yaw_rad = self.pose.yaw_rad
        return setpoint.speed_mps * math.cos(yaw_rad) - setpoint.lateral_mps * math.sin(yaw_rad)

    def _ranges(self, pose: Pose) -> tuple[RangeReading, ...]:
        return tuple(
            replace(reading, range_m=reading.max_range_m)
            if reading.beam is Beam.DOWN and not self.has_ground
            else reading
            for reading in self._eyes.ranges(pose)
        )


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


def test_nobody_waits_where_the_ground_has_ended() -> None:
    """A vehicle without a height is landed after `mission.input_timeout_s`; over a shaft that is into it.

    Whoever lets it wait, another vehicle or a person: it goes back the way that it came first, and waits there.
    """
    flight = Flight()
    flight.speed_mps = 0.3
    flight.fly(Order.EXPLORE, 5.0)
    flight.speed_mps, flight.has_ground = 0.0, False
    flight.fly(Order.WAIT, 1.0)
    assert flight.measurement.over_shaft
    assert flight.towards_mps(flight.setpoint) == pytest.approx(-BACK_MPS, abs=0.02)
    right_behind = Clearance(1.5, True, ((-0.5, 0.0),), spacing(SETTINGS))
    assert flight.explorer.apart(flight.setpoint, right_behind, flight.pose.yaw_rad) == flight.setpoint
    flight.speed_mps, flight.has_ground = -BACK_MPS, True
    flight.fly(Order.WAIT, 0.8 * BACK_M / BACK_MPS)
    assert flight.towards_mps(flight.setpoint) == pytest.approx(-BACK_MPS, abs=0.02), "not at the edge"
    flight.fly(Order.WAIT, 0.3 * BACK_M / BACK_MPS)
    assert not flight.explorer.goes_back
    flight.speed_mps = 0.0
    backward = Setpoint(flight.pose.t_s, -BACK_MPS, 0.0, 0.0)
    assert flight.explorer.apart(backward, right_behind, 0.0).speed_mps == 0.0, "no more than anybody"
    flight.fly(Order.WAIT, 3.0)
    assert math.hypot(flight.setpoint.speed_mps, flight.setpoint.lateral_mps) <= MOST_MPS, "it only keeps its place"
