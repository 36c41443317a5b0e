"""How either autopilot follows a velocity and comes to a stand, against what was measured on the real ones."""

from __future__ import annotations

import math

import pytest

from companion.model import Pose
from sitl.autopilot import ARDUPILOT, PX4, Personality
from tests.sitl.autopilot.rig import flying, travelled


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_px4_brakes_and_then_creeps_on(seed: int) -> None:
    """Zero velocity from 0.35 m/s: 0.15 m after 0.5 s, 0.22 at 1 s, 0.28 at 2 s, 0.33 to 0.44 at 5 s."""
    rig = flying(PX4, seed=seed)
    rig.streaming = (0.4, 0.0, 0.0, 0.0)
    rig.run(5.0)
    assert rig.vehicle.state.airframe.speed_mps == pytest.approx(0.36, abs=0.03)
    since, begun_s = rig.pose, rig.t_s
    rig.streaming = (0.0, 0.0, 0.0, 0.0)
    rig.setpoint(0.0)
    for after_s, way_m, about_m in ((0.5, 0.15, 0.02), (1.0, 0.22, 0.03), (2.0, 0.28, 0.04), (5.0, 0.385, 0.08)):
        rig.run(begun_s + after_s - rig.t_s)
        assert travelled(rig, since) == pytest.approx(way_m, abs=about_m)


def test_px4_creeps_while_it_turns_on_the_spot() -> None:
    """0.5 m in 9 s."""
    rig = flying(PX4)
    rig.streaming = (0.4, 0.0, 0.0, 0.0)
    rig.run(4.0)
    rig.streaming = (0.0, 0.0, 0.0, 0.3)
    rig.run(3.0)
    since = rig.pose
    rig.run(9.0)
    assert travelled(rig, since) == pytest.approx(0.5, abs=0.25)


@pytest.mark.parametrize(
    ("how", "way_m", "within_s"),
    [("zero", 0.24, 1.0), ("silence", 0.45, 1.46), ("LAND", 0.26, 1.1), ("LOITER", 0.37, 1.7), ("BRAKE", 0.58, 3.1)],
)
def test_ardupilot_brakes_as_each_of_its_modes_was_measured(how: str, way_m: float, within_s: float) -> None:
    """From 0.42 m/s to below 0.05: BRAKE needs more than twice the way of zero velocity."""
    rig = flying(ARDUPILOT, parameters={"GUID_TIMEOUT": 0.5})
    rig.streaming = (0.42, 0.0, 0.0, 0.0)
    rig.run(5.0)
    since, begun_s = rig.pose, rig.t_s
    if how == "zero":
        rig.streaming = (0.0, 0.0, 0.0, 0.0)
        rig.setpoint(0.0)
    elif how == "silence":
        rig.streaming = None
        rig.setpoint(0.42)
    else:
        assert rig.set_mode(how) == 0
    rig.until(lambda: rig.vehicle.state.airframe.speed_mps < 0.05, 5.0)
    assert rig.t_s - begun_s == pytest.approx(within_s, abs=0.4)
    rig.run(2.0)
    assert travelled(rig, since) == pytest.approx(way_m, abs=0.06)


@pytest.mark.parametrize(
    ("parameters", "zero_m"),
    [
        ({}, 0.29),
        ({"WPNAV_ACCEL": 500}, 0.52),
        ({"PSC_JERK_XY": 2}, 0.64),
        ({"PSC_JERK_XY": 1}, 1.2),
        ({"WPNAV_ACCEL": 100}, 0.25),
    ],
    ids=str,
)
def test_ardupilot_brakes_by_acceleration_over_jerk(parameters: dict[str, float], zero_m: float) -> None:
    """All of them inside the documented ranges; from 0.5 m/s."""
    rig = flying(ARDUPILOT, parameters=parameters)
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(8.0)
    since = rig.pose
    rig.streaming = (0.0, 0.0, 0.0, 0.0)
    rig.setpoint(0.0)
    rig.run(8.0)
    assert travelled(rig, since) == pytest.approx(zero_m, rel=0.12)


@pytest.mark.parametrize("mode", ["ALT_HOLD", "STABILIZE"])
def test_ardupilot_coasts_in_the_modes_that_only_keep_the_height(mode: str) -> None:
    """2 m and more."""
    rig = flying(ARDUPILOT)
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(4.0)
    since = rig.pose
    assert rig.set_mode(mode) == 0
    rig.run(10.0)
    assert travelled(rig, since) > 2.0
    assert rig.height_m == pytest.approx(1.5, abs=0.2)


def test_ardupilot_answers_a_step_and_then_does_not_drift() -> None:
    """63 % after 0.61 s, 90 % after 0.98 s; in zero velocity 0.01 to 0.02 m in 10 s."""
    rig = flying(ARDUPILOT)
    rig.streaming = (0.42, 0.0, 0.0, 0.0)
    rig.setpoint(0.42)
    speed_mps = 0.42 * 1.014
    assert rig.until(lambda: rig.vehicle.state.airframe.speed_mps > 0.63 * speed_mps, 2.0) == pytest.approx(
        0.61, abs=0.1
    )
    rig.until(lambda: rig.vehicle.state.airframe.speed_mps > 0.9 * speed_mps, 2.0)
    rig.streaming = (0.0, 0.0, 0.0, 0.0)
    rig.run(4.0)
    since = rig.pose
    rig.run(10.0)
    assert travelled(rig, since) < 0.03
    assert abs(rig.pose.z_m - since.z_m) < 0.03


def test_px4s_height_drifts_in_velocity_mode() -> None:
    """The height loop is the application's."""
    rig = flying(PX4)
    heights = []
    for _ in range(30):
        rig.run(1.0)
        heights.append(rig.height_m)
    assert 0.02 < max(heights) - min(heights) < 1.5


@pytest.mark.parametrize(("personality", "flown_mps"), [(PX4, 0.46), (ARDUPILOT, 0.507)], ids=["px4", "ardupilot"])
def test_commanded_speed_and_turn_as_they_are_reached(personality: Personality, flown_mps: float) -> None:
    """0.5 m/s along the nose: 0.92 of it on PX4, all on ArduPilot; 17 degrees/s gave 16 to 17, clockwise."""
    rig = flying(personality, start=Pose(0.0, 0.0, 0.0, 0.0, 1.0))
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(3.0)
    since, begun_s = rig.pose, rig.t_s
    rig.run(10.0)
    assert travelled(rig, since) / (rig.t_s - begun_s) == pytest.approx(flown_mps, abs=0.02)
    assert math.atan2(rig.pose.y_m - since.y_m, rig.pose.x_m - since.x_m) == pytest.approx(1.0, abs=0.25)
    rig.streaming = (0.0, 0.0, 0.0, math.radians(17.0))
    rig.run(2.0)
    assert -17.0 < math.degrees(rig.pose.yaw_rate_radps) < -16.0
