"""The simulated vehicle: how it follows setpoints, and which way it tilts."""

from __future__ import annotations

import math
from dataclasses import astuple
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config.sim import DynamicsSettings
from companion.model import Pose, Setpoint
from sitl.sim.vehicle import DISTURBANCE_TIME_S, GRAVITY_MPS2, Vehicle
from tests.perception.scenes import turned

DT_S = 0.02
START = Pose(0.0, 1.0, -2.0, 1.5, 0.3)
CALM = DynamicsSettings(drift_mps=0.0)
EXACT = 1e-9
"""Sums of some hundred doubles of the order of 1."""


def vehicle(dynamics: DynamicsSettings = CALM, seed: int = 1, start: Pose = START) -> Vehicle:
    return Vehicle(dynamics, start, np.random.default_rng(seed))


def fly(
    body: Vehicle, speed_mps: float, climb_mps: float, yaw_rate_radps: float, for_s: float, dt_s: float = DT_S
) -> list[Pose]:
    """Poses of every step, the present one first, with the same setpoint given anew at each of them."""
    poses = [body.pose]
    for _ in range(round(for_s / dt_s)):
        body.command(Setpoint(body.pose.t_s, speed_mps, climb_mps, yaw_rate_radps))
        poses.append(body.step(dt_s))
    return poses


def test_it_reaches_its_gain_times_the_command() -> None:
    """Protects the steady state in all three axes: speed, climb, and turn to the left for a positive yaw rate."""
    body = vehicle()
    last = fly(body, 0.5, -0.2, 0.3, for_s=10.0)[-1]
    # Ten seconds are 30 lags of the speed: what is still missing is e⁻³⁰.
    assert body.forward_mps == pytest.approx(0.5 * CALM.speed_gain, abs=EXACT)
    assert math.hypot(last.vx_mps, last.vy_mps) == pytest.approx(0.5 * CALM.speed_gain, abs=EXACT)
    assert last.vz_mps == pytest.approx(-0.2 * CALM.speed_gain, abs=EXACT)
    assert last.yaw_rate_radps == pytest.approx(0.3 * CALM.yaw_rate_gain, abs=EXACT)


@pytest.mark.parametrize("lateral_mps", [0.1, -0.1])
def test_it_moves_sideways_as_it_is_asked(lateral_mps: float) -> None:
    """Protects station keeping in simulated flights: positive is to the left, whatever the heading."""
    body = vehicle()
    for _ in range(500):
        body.command(Setpoint(body.pose.t_s, 0.0, 0.0, 0.0, lateral_mps))
        last = body.step(DT_S)
    left = -math.sin(START.yaw_rad), math.cos(START.yaw_rad)
    wanted_mps = lateral_mps * CALM.speed_gain
    assert (last.vx_mps, last.vy_mps) == pytest.approx((wanted_mps * left[0], wanted_mps * left[1]), abs=EXACT)
    assert body.forward_mps == pytest.approx(0.0, abs=EXACT)


def test_the_speed_follows_with_a_first_order_lag() -> None:
    """Protects the lag: after each 0.3 s, 1/e of what was missing is missing."""
    dynamics = CALM.model_copy(update={"command_latency_s": 0.0, "max_acceleration_mps2": 20.0})
    body = vehicle(dynamics)
    reached = 0.5 * dynamics.speed_gain
    for pose in fly(body, 0.5, 0.0, 0.0, for_s=1.5)[1:]:
        expected = reached * (1.0 - math.exp(-pose.t_s / dynamics.speed_lag_s))
        assert math.hypot(pose.vx_mps, pose.vy_mps) == pytest.approx(expected, abs=EXACT)


def test_without_lag_it_follows_at_once() -> None:
    """Protects the setting 0, which divides by nothing."""
    dynamics = DynamicsSettings(
        drift_mps=0.0, speed_lag_s=0.0, yaw_rate_lag_s=0.0, command_latency_s=0.0, max_acceleration_mps2=20.0,
        max_yaw_acceleration_radps2=50.0, speed_gain=1.0, yaw_rate_gain=1.0,
    )  # fmt: skip
    body = vehicle(dynamics)
    last = fly(body, 0.3, 0.1, 0.5, for_s=DT_S)[-1]
    assert (body.forward_mps, last.vz_mps, last.yaw_rate_radps) == (0.3, 0.1, 0.5)


@given(
    st.lists(st.tuples(st.floats(-5.0, 5.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)), min_size=1, max_size=5),
    st.floats(0.1, 5.0),
    st.floats(0.1, 10.0),
)
@settings(deadline=None, max_examples=30)
def test_no_acceleration_is_beyond_its_limit(
    setpoints: list[tuple[float, float, float]], limit_mps2: float, limit_radps2: float
) -> None:
    """Protects the limits of speed, climb and yaw rate under any sequence of setpoints."""
    dynamics = CALM.model_copy(
        update={"max_acceleration_mps2": limit_mps2, "max_yaw_acceleration_radps2": limit_radps2}
    )
    body = vehicle(dynamics)
    for setpoint in setpoints:
        before_mps = body.forward_mps
        for before, after in pairwise(fly(body, *setpoint, for_s=0.2)):
            assert abs(after.vz_mps - before.vz_mps) <= limit_mps2 * DT_S + EXACT
            assert abs(after.yaw_rate_radps - before.yaw_rate_radps) <= limit_radps2 * DT_S + EXACT
        assert abs(body.forward_mps - before_mps) <= limit_mps2 * 0.2 + EXACT


def test_a_limited_acceleration_is_used_to_the_full() -> None:
    """Protects the limit from being a second lag: far from its target the speed grows by the limit."""
    dynamics = CALM.model_copy(update={"max_acceleration_mps2": 0.5, "command_latency_s": 0.0})
    body = vehicle(dynamics)
    fly(body, 5.0, 0.0, 0.0, for_s=1.0)
    assert body.forward_mps == pytest.approx(0.5, abs=EXACT)


@pytest.mark.parametrize("limit_mps2", [0.3, 1.5, 20.0])
@pytest.mark.parametrize("speed_mps", [0.2, 0.5, 1.5])
def test_a_zero_command_stops_it_within_what_lag_and_limit_need(speed_mps: float, limit_mps2: float) -> None:
    """Protects the braking distance, which the speed governor counts on.

    In continuous time: at the limit a from v down to the speed a·τ from which on the lag τ brakes less than that, then
    τ times that speed; and what is flown before the command works. One step at full speed is what sampling adds.
    """
    dynamics = CALM.model_copy(update={"max_acceleration_mps2": limit_mps2})
    body = vehicle(dynamics)
    fly(body, speed_mps, 0.0, 0.0, for_s=20.0)
    v_mps, flown_m = body.forward_mps, body.path_m
    fly(body, 0.0, 0.0, 0.0, for_s=20.0)
    lagging_mps = min(v_mps, limit_mps2 * dynamics.speed_lag_s)
    needed_m = (v_mps**2 - lagging_mps**2) / (2.0 * limit_mps2) + lagging_mps * dynamics.speed_lag_s
    stopped_m = body.path_m - flown_m
    assert stopped_m <= needed_m + v_mps * (dynamics.command_latency_s + DT_S)
    assert stopped_m >= needed_m - v_mps * DT_S
    assert body.forward_mps == pytest.approx(0.0, abs=EXACT)


def moves_at_s(latency_s: float, dt_s: float) -> float:
    """The time at the end of the first step in which a setpoint of time 0 has moved the vehicle."""
    body = vehicle(CALM.model_copy(update={"command_latency_s": latency_s}))
    body.command(Setpoint(0.0, 0.5, 0.0, 0.0))
    while body.path_m == 0.0:
        body.step(dt_s)
        assert body.pose.t_s < 1.0
    return body.pose.t_s


@pytest.mark.parametrize("latency_s", [0.0, 0.05, 0.1, 0.3])
def test_a_setpoint_works_at_the_latest_a_step_after_its_latency(latency_s: float) -> None:
    """Protects the latency from growing with the sampling: it is in force by the end of the step after it."""
    for dt_s in (DT_S, 0.05):
        assert moves_at_s(latency_s, dt_s) <= latency_s + dt_s + EXACT


@pytest.mark.parametrize("latency_s", [0.05, 0.1, 0.3])
def test_a_setpoint_does_not_work_before_its_latency(latency_s: float) -> None:
    """Protects the latency from being none: in the steps that end before it or at it nothing has moved."""
    for dt_s in (DT_S, 0.05):
        assert moves_at_s(latency_s, dt_s) > latency_s + EXACT


def test_setpoints_work_in_their_order_and_the_newest_counts() -> None:
    """Protects the queue of setpoints that are on their way: after a stop it stops, however many came before."""
    body = vehicle(CALM.model_copy(update={"command_latency_s": 0.09}))
    for i in range(5):
        body.command(Setpoint(0.001 * i, 0.5, 0.0, 0.0))
    body.command(Setpoint(0.005, 0.0, 0.0, 0.0))
    while body.pose.t_s < 1.0:
        body.step(DT_S)
    assert body.path_m == 0.0


@pytest.mark.parametrize("yaw_rate_radps", [0.4, -0.4])
def test_it_turns_to_the_side_of_the_yaw_rate(yaw_rate_radps: float) -> None:
    """Protects the sign: positive is counter-clockwise, and on a turn at speed the path bends that way too.

    Once steady it flies a circle of the radius v/u (paper Definition 3.2), whose middle is on that side.
    """
    body = vehicle()
    fly(body, 0.5, 0.0, yaw_rate_radps, for_s=10.0)
    v_mps, rate = 0.5 * CALM.speed_gain, yaw_rate_radps * CALM.yaw_rate_gain
    poses = fly(body, 0.5, 0.0, yaw_rate_radps, for_s=10.0)
    radius_m = v_mps / rate
    middles = np.array(
        [[p.x_m - radius_m * math.sin(p.yaw_rad), p.y_m + radius_m * math.cos(p.yaw_rad)] for p in poses]
    )
    # The middle of each step's chord is off the circle by its sagitta's order: (u·dt)²/8 of the radius.
    np.testing.assert_allclose(middles, np.broadcast_to(middles[0], middles.shape), atol=1e-4)


def test_the_yaw_stays_in_its_range() -> None:
    """Protects the convention [-π, π) over many turns."""
    yaws = [pose.yaw_rad for pose in fly(vehicle(), 0.0, 0.0, 2.0, for_s=20.0)]
    assert all(-math.pi <= yaw < math.pi for yaw in yaws)
    assert min(yaws) < -3.0
    assert max(yaws) > 3.0


@pytest.mark.parametrize("drift_mps", [0.0, 0.1])
def test_velocity_and_way_are_those_of_the_positions(drift_mps: float) -> None:
    """Protects the pose against contradicting itself: velocities are differences of positions, the way is their sum."""
    body = vehicle(CALM.model_copy(update={"drift_mps": drift_mps}))
    poses = fly(body, 0.5, 0.1, 0.5, for_s=5.0) + fly(body, 0.2, -0.2, -0.5, for_s=5.0)[1:]
    way_m = 0.0
    for before, after in pairwise(poses):
        assert after.t_s - before.t_s == pytest.approx(DT_S, abs=EXACT)
        moved = np.array([after.x_m - before.x_m, after.y_m - before.y_m, after.z_m - before.z_m])
        np.testing.assert_allclose(moved / DT_S, [after.vx_mps, after.vy_mps, after.vz_mps], atol=EXACT / DT_S)
        way_m += float(np.linalg.norm(moved))
    assert body.path_m == pytest.approx(way_m, abs=EXACT)


def test_the_thrust_makes_the_acceleration() -> None:
    """Protects the signs of pitch and roll by physics alone: a multicopter pushes along its own up axis.

    Gravity plus acceleration point where the body's up axis points, for speeding up, braking, and turns to both sides.
    """
    dt_s = 0.002
    body = vehicle()
    poses = fly(body, 1.0, 0.0, 0.0, 0.4, dt_s) + fly(body, 1.0, 0.0, 0.8, 2.0, dt_s)[1:]
    poses += fly(body, 0.0, 0.0, -0.8, 1.0, dt_s)[1:] + fly(body, 1.0, 0.0, -0.8, 2.0, dt_s)[1:]
    largest = 0.0
    for before, after in pairwise(poses):
        acceleration = np.array([after.vx_mps - before.vx_mps, after.vy_mps - before.vy_mps]) / dt_s
        up = turned(after.yaw_rad, after.pitch_rad, after.roll_rad)[:, 2]
        pushed = GRAVITY_MPS2 * up[:2] / up[2]
        # Accelerations are 1.5 and 0.7 m/s². Pitch and roll are worked out one by one, where the second should be
        # shorter by the cosine of the first: 1.2 % of 0.7 m/s². Half a step of sampling turns 1.5 m/s² by 0.8 mrad and
        # changes the yaw rate by 3 rad/s² · 1 ms, which is 0.003 m/s² at 0.85 m/s.
        np.testing.assert_allclose(pushed, acceleration, atol=0.008 + 0.001 + 0.003)
        largest = max(largest, abs(after.pitch_rad), abs(after.roll_rad))
    assert largest > 0.1


def test_nose_down_to_speed_up_and_left_side_down_to_turn_left() -> None:
    """Protects the same signs in words: positive pitch is nose down, positive roll is left side up."""
    speeding_up = fly(vehicle(), 0.5, 0.0, 0.0, for_s=0.2)[-1]
    assert speeding_up.pitch_rad > 0.05
    assert speeding_up.roll_rad == 0.0
    body = vehicle()
    turning_left = fly(body, 0.5, 0.0, 0.6, for_s=5.0)[-1]
    assert turning_left.roll_rad < -0.02
    assert turning_left.pitch_rad == pytest.approx(0.0, abs=1e-6)
    braking = fly(body, 0.0, 0.0, 0.0, for_s=0.2)[-1]
    assert braking.pitch_rad < -0.05


def test_the_same_seed_flies_the_same_way() -> None:
    """Protects the repeatability of runs, and shows that the seed matters."""
    windy = DynamicsSettings(drift_mps=0.1)
    ways = [fly(vehicle(windy, seed), 0.5, 0.1, 0.2, for_s=2.0) for seed in (7, 7, 8)]
    assert ways[0] == ways[1]
    assert ways[0] != ways[2]


def test_without_disturbance_the_seed_does_not_matter() -> None:
    """Protects drift_mps = 0: it stands still, and flies the same way whatever the seed."""
    still = fly(vehicle(CALM, seed=1), 0.0, 0.0, 0.0, for_s=5.0)
    np.testing.assert_allclose(astuple(still[-1])[1:], astuple(START)[1:], atol=EXACT)
    assert fly(vehicle(CALM, 1), 0.5, 0.1, 0.2, 2.0) == fly(vehicle(CALM, 2), 0.5, 0.1, 0.2, 2.0)


def test_the_disturbance_has_the_configured_size_from_the_start_on() -> None:
    """Protects drift_mps: hovering vehicles drift by it, after 1.5 s as after 15 s.

    Each of 200 vehicles has three independent Gaussian axes, so the mean square of 600 numbers is within 5 standard
    deviations, 5·√(2/600) = 29 %, of its expectation. The body follows the gusts with its own lag τ, which lets pass
    T/(T + τ) of the square of a disturbance with correlation time T; at the start it has reached 1 - exp(-t/τ) of it.
    """
    drift_mps = 0.05
    dynamics = CALM.model_copy(update={"drift_mps": drift_mps, "max_acceleration_mps2": 20.0})
    lag_s = dynamics.speed_lag_s
    squares: dict[float, list[float]] = {1.5: [], 15.0: []}
    for seed in range(200):
        body = vehicle(dynamics, seed)
        for t_s, found in squares.items():
            while body.pose.t_s < t_s - 1e-6:
                body.step(0.1)
            found += [body.pose.vx_mps**2, body.pose.vy_mps**2, body.pose.vz_mps**2]
    passed = DISTURBANCE_TIME_S / (DISTURBANCE_TIME_S + lag_s)
    for found in squares.values():
        # Five lags have passed at 1.5 s: 1.3 % of the square may still be missing.
        assert np.mean(found) == pytest.approx(drift_mps**2 * passed, rel=0.29 + 0.013)


def test_a_wind_that_sets_in_is_taken_out_as_px4_does() -> None:
    """Protects honesty: of 2 m/s across the way an error is left for seconds, and 1.5 m where nothing else holds it.

    The error is that of a_d·s / (s² + P·s + I), a_d = 0.6 m/s²: with roots of -0.26 and -1.54 in 1/s it is greatest
    after 1.4 s, 0.27 m/s, and its integral is a_d / I.
    """
    body = Vehicle(CALM, START, np.random.default_rng(1), lambda _pose: (0.0, 2.0))
    errors_mps = [pose.vy_mps for pose in fly(body, 0.0, 0.0, 0.0, for_s=40.0)]
    assert max(errors_mps) == pytest.approx(0.27, abs=0.01)
    assert errors_mps.index(max(errors_mps)) * DT_S == pytest.approx(1.4, abs=0.2)
    assert abs(errors_mps[-1]) < 1e-3
    assert body.pose.y_m - START.y_m == pytest.approx(0.6 / 0.4, abs=0.02)
    assert body.pose.x_m == pytest.approx(START.x_m, abs=EXACT)
    # It leans against the wind with 0.6 m/s²: its right side, which is down the yaw of 0.3 rad, goes up.
    lean = math.tan(body.pose.roll_rad), math.tan(body.pose.pitch_rad)
    against = 0.6 / GRAVITY_MPS2
    assert lean == pytest.approx((against * math.cos(0.3), -against * math.sin(0.3)), abs=1e-3)


def test_in_still_air_nothing_is_added() -> None:
    """Protects every flight without wind, to the last bit."""
    still = Vehicle(CALM, START, np.random.default_rng(1), lambda _pose: (0.0, 0.0))
    assert fly(still, 0.5, 0.1, 0.2, for_s=3.0) == fly(vehicle(), 0.5, 0.1, 0.2, for_s=3.0)
