"""The tracker that is not there and the grid that positions lie on: frames, errors, silence, no jumps."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import InputError
from companion.model import Pose
from sitl.world.odometry import Align, Estimate, Odometry, OdometrySettings
from sitl.world.truth_messages import GAP_S, TAU_S, PositionFilter

PERFECT = OdometrySettings(position_noise_m=0.0, attitude_noise_rad=0.0, velocity_noise_mps=0.0, drift_share=0.0)
START = Pose(10.0, 3.0, 4.0, 1.0, 0.7)


def tracker(settings: OdometrySettings = PERFECT) -> Odometry:
    return Odometry(settings, np.random.default_rng(1))


def ahead(seconds: float, hz: float = 50.0, speed_mps: float = 0.5) -> Iterator[Pose]:
    """Straight ahead along the nose from the start."""
    for i in range(round(seconds * hz)):
        way_m = speed_mps * i / hz
        yield replace(
            START,
            t_s=START.t_s + i / hz,
            x_m=START.x_m + way_m * math.cos(START.yaw_rad),
            y_m=START.y_m + way_m * math.sin(START.yaw_rad),
            vx_mps=speed_mps * math.cos(START.yaw_rad),
            vy_mps=speed_mps * math.sin(START.yaw_rad),
        )


def seen(odometry: Odometry, poses: Iterator[Pose], offset_rad: float = 0.0) -> list[Estimate]:
    """What has left when each pose has just come."""
    out = []
    for pose in poses:
        odometry.observe(pose, offset_rad)
        out += odometry.due(pose.t_s)
    return out


def test_its_frame_starts_at_zero_along_the_nose() -> None:
    """What trackers call x is called north here: forward is north, left is west, whatever the compass says."""
    estimates = seen(tracker(), ahead(2.0), offset_rad=0.3)
    first, last = estimates[0].pose, estimates[-1].pose
    assert (first.x_m, first.y_m, first.z_m) == pytest.approx((0.0, 0.0, 0.0))
    assert first.yaw_rad == pytest.approx(math.pi / 2)
    way_m = 0.5 * (last.t_s - first.t_s)
    assert (last.x_m, last.y_m, last.z_m) == pytest.approx((0.0, way_m, 0.0), abs=1e-9)
    assert (last.vx_mps, last.vy_mps) == pytest.approx((0.0, 0.5))


def test_aligned_with_north_it_turns_as_the_compass() -> None:
    """The mine is turned by the offset against the compass: what is taken from it must be turned back."""
    settings = replace(PERFECT, align=Align.NORTH)
    last = seen(tracker(settings), ahead(2.0), offset_rad=0.3)[-1].pose
    assert last.yaw_rad == pytest.approx(0.7 - 0.3)
    way_m = 0.5 * (last.t_s - START.t_s)
    assert (last.x_m, last.y_m) == pytest.approx((way_m * math.cos(0.4), way_m * math.sin(0.4)))


def jittered(poses: Iterator[Pose]) -> Iterator[Pose]:
    """Arrival, as it comes over a wire."""
    rng = np.random.default_rng(2)
    for pose in poses:
        yield replace(pose, t_s=pose.t_s + float(rng.uniform(-0.002, 0.002)))


@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 50.0])
def test_it_keeps_its_rate(rate_hz: float) -> None:
    """Also at the very rate of the truth, which comes with jitter; autopilots time out on half of it."""
    estimates = seen(tracker(replace(PERFECT, rate_hz=rate_hz)), jittered(ahead(20.0)))
    assert len(estimates) == pytest.approx(20.0 * rate_hz, rel=0.03)
    assert max(b.pose.t_s - a.pose.t_s for a, b in itertools.pairwise(estimates)) < 2.0 / rate_hz


def test_after_a_silence_it_does_not_catch_up() -> None:
    """A simulator that stood still for 3 s: no burst of estimates follows."""
    odometry = tracker()
    seen(odometry, ahead(1.0))
    late = (replace(pose, t_s=pose.t_s + 4.0) for pose in ahead(1.0))
    assert len(seen(odometry, late)) == pytest.approx(30, abs=2)


def test_noise_is_as_large_as_it_was_asked_for() -> None:
    """Standard deviations over 1500 draws: three of their own standard errors, 5.5 %."""
    settings = replace(PERFECT, position_noise_m=0.05, attitude_noise_rad=0.02, velocity_noise_mps=0.1)
    poses = [estimate.pose for estimate in seen(tracker(settings), ahead(50.0, speed_mps=0.0))]
    assert len(poses) > 1450
    for name, wanted in (("x_m", 0.05), ("z_m", 0.05), ("yaw_rad", 0.02), ("roll_rad", 0.02), ("vy_mps", 0.1)):
        assert np.std([getattr(pose, name) for pose in poses]) == pytest.approx(wanted, rel=0.055), name


def test_drift_grows_with_the_way_and_not_with_time() -> None:
    """2 % of 100 m, in whatever direction: metres, not millimetres; at rest there is none."""
    settings = replace(PERFECT, drift_share=0.02)
    errors = []
    for seed in range(8):
        odometry = Odometry(settings, np.random.default_rng(seed))
        last = seen(odometry, ahead(50.0, speed_mps=2.0))[-1].pose
        errors.append(math.dist((last.x_m, last.y_m, last.z_m), (0.0, 2.0 * (last.t_s - START.t_s), 0.0)))
    assert 0.3 < float(np.mean(errors)) < 2.0
    at_rest = seen(tracker(settings), ahead(50.0, speed_mps=0.0))[-1].pose
    assert (at_rest.x_m, at_rest.y_m, at_rest.z_m) == (0.0, 0.0, 0.0)


def test_delay_is_kept_and_the_stamp_is_that_of_the_exposure() -> None:
    """Late data with an honest stamp: what an estimator has to live with."""
    odometry = tracker(replace(PERFECT, delay_s=0.1))
    odometry.observe(START, 0.0)
    assert odometry.due(START.t_s + 0.099) == []
    (estimate,) = odometry.due(START.t_s + 0.1)
    assert estimate.pose.t_s == START.t_s
    assert odometry.due(START.t_s + 9.0) == []


def test_lost_estimates_are_lost_by_chance() -> None:
    """30 % of 1500, give or take three standard deviations."""
    odometry = tracker(replace(PERFECT, loss_share=0.3))
    sent = len(seen(odometry, ahead(50.0)))
    assert odometry.lost == pytest.approx(450, abs=54)
    assert sent + odometry.lost == pytest.approx(1500, abs=10)


def test_blind_for_a_while_it_begins_a_new_frame() -> None:
    """From 2 s for 3 s: silence, then zero again with another reset counter, as a tracker that has lost itself."""
    odometry = tracker(replace(PERFECT, outage_s=(2.0, 3.0)))
    estimates = seen(odometry, ahead(10.0))
    times = [estimate.pose.t_s - START.t_s for estimate in estimates]
    assert not [t for t in times if 2.0 <= t < 5.0]
    after = next(estimate for estimate in estimates if estimate.pose.t_s >= START.t_s + 5.0)
    assert after.resets == 1
    assert (after.pose.x_m, after.pose.y_m) == pytest.approx((0.0, 0.0))
    assert estimates[-1].resets == 1
    assert estimates[-1].pose.y_m == pytest.approx(0.5 * (estimates[-1].pose.t_s - after.pose.t_s))


def test_a_short_blindness_keeps_the_frame() -> None:
    """Half a second is bridged by the inertial part."""
    estimates = seen(tracker(replace(PERFECT, outage_s=(2.0, 0.5))), ahead(5.0))
    assert estimates[-1].resets == 0
    assert estimates[-1].pose.y_m == pytest.approx(0.5 * (estimates[-1].pose.t_s - START.t_s))


def test_what_is_under_way_is_bounded() -> None:
    """Nobody fetches: the oldest go."""
    odometry = tracker(replace(PERFECT, rate_hz=200.0, delay_s=2.0))
    for pose in ahead(20.0, hz=200.0):
        odometry.observe(pose, 0.0)
    assert len(odometry.due(1e9)) <= 512


@pytest.mark.parametrize(
    "wrong",
    [
        {"rate_hz": 0.0},
        {"rate_hz": math.nan},
        {"position_noise_m": -0.1},
        {"drift_share": 0.5},
        {"delay_s": 3.0},
        {"loss_share": 1.1},
        {"outage_s": (-1.0, 2.0)},
        {"outage_s": (1.0, math.inf)},
    ],
)
def test_senseless_settings_are_refused(wrong: dict[str, object]) -> None:
    """Before anything is loaded, and with the option's name."""
    with pytest.raises(InputError, match="--odometry-"):
        replace(PERFECT, **wrong)  # type: ignore[arg-type]


# Positions on a grid: the error bound that the rendered depth relies on, and that nothing jumps.


STEP_M = 0.0111
DT_S = 0.02


def cut(value_m: float, step_m: float = STEP_M) -> float:
    """As an integer cast does."""
    return math.trunc(value_m / step_m) * step_m


def flown(speed_mps: float, told_mps: float, seconds: float) -> list[tuple[float, float]]:
    """Smooth and true x along a straight way."""
    smoother = PositionFilter((STEP_M, STEP_M, STEP_M))
    out = []
    for i in range(round(seconds / DT_S)):
        true_m = speed_mps * i * DT_S
        out.append((smoother.update(i * DT_S, (cut(true_m), 0.0, 0.0), (told_mps, 0.0, 0.0))[0], true_m))
    return out


@given(speed_mps=st.floats(-3.0, 3.0), told_mps=st.floats(-10.0, 10.0))
def test_the_error_is_two_steps_at_most_whatever_the_velocity_says(speed_mps: float, told_mps: float) -> None:
    """The bound of the docstring: cut off by one step, and held within one step of that."""
    assert max(abs(smooth - true) for smooth, true in flown(speed_mps, told_mps, 2.0)) <= 2.0 * STEP_M + 1e-9


def test_with_the_velocity_cut_off_at_1_cm_per_s_it_keeps_within_one_and_a_half_steps() -> None:
    """Half a second of at most 1 cm/s, and the step that the grid itself takes off."""
    for speed_mps in (0.013, 0.199, 0.4242, -0.4242, 0.777):
        errors = [abs(smooth - true) for smooth, true in flown(speed_mps, cut(speed_mps, 0.01), 20.0)]
        assert max(errors) <= STEP_M + TAU_S * 0.01 + 1e-9


def test_it_moves_as_the_vehicle_does_and_not_in_steps() -> None:
    """Between two messages the raw position stands still or jumps 1.1 cm; the smooth one never jumps."""
    places = [smooth for smooth, _ in flown(0.4, 0.4, 10.0)]
    moved = [after - before for before, after in itertools.pairwise(places)]
    # v·dt, give or take the share dt/TAU of one step.
    slack_m = DT_S / TAU_S * STEP_M
    assert max(abs(way - 0.4 * DT_S) for way in moved) <= slack_m + 1e-9


def test_a_vehicle_at_rest_stands_still() -> None:
    """Hovering on the edge of a cell: the grid flickers, the walls must not."""
    smoother = PositionFilter((STEP_M, STEP_M, STEP_M))
    draw = random.Random(1)  # noqa: S311 - not a secret
    places = [smoother.update(i * DT_S, (draw.choice((0.0, STEP_M)), 0.0, 0.0), (0.0, 0.0, 0.0))[0] for i in range(500)]
    jumps = [abs(after - before) for before, after in itertools.pairwise(places)]
    assert max(jumps) <= DT_S / TAU_S * STEP_M + 1e-9


@pytest.mark.parametrize("dt_s", [GAP_S + 0.01, -1.0])
def test_after_a_gap_it_believes_the_position(dt_s: float) -> None:
    """Nothing is known of the velocity in between."""
    smoother = PositionFilter((STEP_M, STEP_M, STEP_M))
    smoother.update(10.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    assert smoother.update(10.0 + dt_s, (5.0, 6.0, 7.0), (1.0, 0.0, 0.0)) == (5.0, 6.0, 7.0)
