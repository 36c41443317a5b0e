"""Equations (6) to (9) and (12): their values, their signs, their bounds, and what they do beside a straight wall."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.control import laws
from companion.control.parameters import Parameters
from companion.model import Mode, Pose, Setpoint, wrap_rad
from tests.control.scene import law_parameters, unicycle

PAPER = law_parameters(law="paper")
SMOOTH = law_parameters(law="smooth")
LAWS = [pytest.param(PAPER, id="paper"), pytest.param(SMOOTH, id="smooth")]

finite = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False)
lengths = st.floats(-100.0, 100.0, allow_subnormal=False)
sides = st.sampled_from([-1, 1])


# (8) and (9).


def test_sign_is_zero_at_zero() -> None:
    """(8): sgn(0) = 0, also for the other zero; anything else there is a turn that nothing asked for."""
    assert laws.sign(0.0) == 0.0
    assert laws.sign(-0.0) == 0.0


@given(x=finite.filter(lambda x: x != 0.0))
def test_sign_is_the_side_of_zero(x: float) -> None:
    """(8): 1 above zero, -1 below, however small."""
    assert laws.sign(x) == (1.0 if x > 0.0 else -1.0)


@given(x=finite)
def test_saturation_is_odd_bounded_and_the_identity_within(x: float) -> None:
    """The smooth stand-in for sgn: never more than sgn, never another side."""
    assert laws.saturation(-x) == -laws.saturation(x)
    assert laws.saturation(x) == (x if abs(x) < 1.0 else laws.sign(x))


@given(x_m=finite, gain=st.floats(0.01, 5.0), width_m=st.floats(0.01, 10.0))
def test_closing_speed_is_equation_9(x_m: float, gain: float, width_m: float) -> None:
    """(9): odd, of slope l inside k, l·k·sgn(x) outside, so that no distance asks for more than l·k."""
    speed = laws.closing_speed_mps(x_m, gain, width_m)
    assert speed == (gain * x_m if abs(x_m) < width_m else gain * width_m * laws.sign(x_m))
    assert speed == -laws.closing_speed_mps(-x_m, gain, width_m)
    assert abs(speed) <= gain * width_m


@given(gain=st.floats(0.01, 5.0), width_m=st.floats(0.01, 10.0), side=sides)
def test_closing_speed_is_continuous_where_it_saturates(gain: float, width_m: float, side: int) -> None:
    """(9): just inside and just outside of k differ by rounding, so the yaw rate has no step there."""
    inside = laws.closing_speed_mps(side * math.nextafter(width_m, 0.0), gain, width_m)
    outside = laws.closing_speed_mps(side * width_m, gain, width_m)
    # Neighbouring numbers times l: two roundings of 2^-53 each, 1e-15 is four.
    assert inside == pytest.approx(outside, rel=1e-15)


# (7).


@pytest.mark.parametrize("direction", [-1, 1])
def test_initial_circle_turns_at_the_largest_rate(direction: int) -> None:
    """(7) R1: ±u_M, and the direction's sign is the turn's."""
    assert laws.circle_yaw_rate_radps(direction, PAPER) == direction * PAPER.max_yaw_rate_radps


@pytest.mark.parametrize("parameters", LAWS)
@pytest.mark.parametrize("bearing_rad", [0.01, 0.3, 1.0, 3.0])
def test_tangent_law_turns_towards_the_target(parameters: Parameters, bearing_rad: float) -> None:
    """(7) R2: a target on the left (positive bearing) gives a left turn (positive rate), one on the right a right."""
    assert laws.tangent_yaw_rate_radps(bearing_rad, parameters) > 0.0
    assert laws.tangent_yaw_rate_radps(-bearing_rad, parameters) < 0.0
    assert laws.tangent_yaw_rate_radps(0.0, parameters) == 0.0


@pytest.mark.parametrize("parameters", LAWS)
@pytest.mark.parametrize(
    ("gamma", "d_m", "d_dot_mps", "turn"),
    [
        pytest.param(-1, 2.0, 0.0, -1, id="wall right, too far: right, towards it"),
        pytest.param(-1, 0.5, 0.0, 1, id="wall right, too near: left, away"),
        pytest.param(1, 2.0, 0.0, 1, id="wall left, too far: left, towards it"),
        pytest.param(1, 0.5, 0.0, -1, id="wall left, too near: right, away"),
        pytest.param(-1, 1.0, 0.2, -1, id="wall right, at d_s but leaving it: right"),
        pytest.param(-1, 1.0, -0.2, 1, id="wall right, at d_s but closing in: left"),
        pytest.param(1, 1.0, 0.2, 1, id="wall left, at d_s but leaving it: left"),
        pytest.param(1, 1.0, -0.2, -1, id="wall left, at d_s but closing in: right"),
        pytest.param(-1, 1.0, 0.0, 0, id="at d_s and along the wall: straight on"),
        pytest.param(-1, 3.0, -0.45, 1, id="too far but closing in faster than X asks: away"),
    ],
)
def test_boundary_law_turns_to_the_right_side(
    parameters: Parameters, gamma: int, d_m: float, d_dot_mps: float, turn: int
) -> None:
    """(7) R3: Γ·sgn[ḋ + X(d - d_s)], the table of signs as a pilot would say it."""
    assert laws.sign(laws.boundary_yaw_rate_radps(gamma, d_m, d_dot_mps, parameters)) == turn


@pytest.mark.parametrize("parameters", LAWS)
@given(d_m=finite, d_dot_mps=finite)
def test_boundary_law_is_mirrored_by_gamma(parameters: Parameters, d_m: float, d_dot_mps: float) -> None:
    """(7) R3: the wall on the other side gives the opposite turn and nothing else."""
    on_the_left = laws.boundary_yaw_rate_radps(1, d_m, d_dot_mps, parameters)
    assert on_the_left == -laws.boundary_yaw_rate_radps(-1, d_m, d_dot_mps, parameters)


@given(gamma=sides, d_m=lengths, d_dot_mps=lengths, bearing_rad=st.floats(-math.pi, math.pi, allow_subnormal=False))
def test_smooth_law_lies_between_zero_and_the_paper_law(
    gamma: int, d_m: float, d_dot_mps: float, bearing_rad: float
) -> None:
    """The boundary layer softens sgn: the same side always, never more, and the same outside of the layer."""
    for paper, smooth in [
        (laws.boundary_yaw_rate_radps(gamma, d_m, d_dot_mps, p) for p in (PAPER, SMOOTH)),
        (laws.tangent_yaw_rate_radps(bearing_rad, p) for p in (PAPER, SMOOTH)),
    ]:
        assert laws.sign(smooth) == laws.sign(paper)
        assert abs(smooth) <= abs(paper)
    if abs(bearing_rad) >= SMOOTH.boundary_layer_rad:
        assert laws.tangent_yaw_rate_radps(bearing_rad, SMOOTH) == laws.tangent_yaw_rate_radps(bearing_rad, PAPER)


@pytest.mark.parametrize("parameters", LAWS)
@given(gamma=sides, d_m=finite, d_dot_mps=finite, bearing_rad=finite)
def test_yaw_rates_stay_within_the_largest(
    parameters: Parameters, gamma: int, d_m: float, d_dot_mps: float, bearing_rad: float
) -> None:
    """(2): |u_θ| <= u_M for whatever numbers come in, and never NaN."""
    for rate in (
        laws.boundary_yaw_rate_radps(gamma, d_m, d_dot_mps, parameters),
        laws.tangent_yaw_rate_radps(bearing_rad, parameters),
    ):
        assert abs(rate) <= parameters.max_yaw_rate_radps


@pytest.mark.parametrize(
    ("bearing_deg", "rate_mps"), [(0.0, -0.5), (60.0, -0.25), (90.0, 0.0), (-90.0, 0.0), (120.0, 0.25), (180.0, 0.5)]
)
def test_cruising_rate_is_that_of_flying_on_at_full_speed(bearing_deg: float, rate_mps: float) -> None:
    """ḋ = -v·cos α*: a wall ahead comes nearer at v, one beside stays, one behind goes away; left or right alike."""
    parameters = law_parameters(speed_mps=0.5)
    # cos of a right angle is 6e-17, not 0: rounding of π.
    assert laws.cruising_rate_mps(math.radians(bearing_deg), parameters) == pytest.approx(rate_mps, abs=1e-15)


# (12).


@pytest.mark.parametrize(
    ("mode", "d_front_m", "stands"),
    [
        (Mode.CIRCLE, None, True),
        (Mode.CIRCLE, 5.0, True),
        (Mode.TANGENT, None, False),
        (Mode.TANGENT, 0.1, False),
        (Mode.BOUNDARY, None, False),
        (Mode.BOUNDARY, 0.69999, True),
        (Mode.BOUNDARY, 0.7, False),
        (Mode.BOUNDARY, 5.0, False),
        (Mode.HOLD, None, True),
        (Mode.HOLD, 5.0, True),
    ],
)
def test_speed_is_equation_12(mode: Mode, d_front_m: float | None, stands: bool) -> None:
    """(12), exactly: 0 in R1 and in R3 when d_f < d_c, else v_c; the mode in which nothing may move stands."""
    parameters = law_parameters(critical_margin_m=0.7)
    assert laws.speed_mps(mode, d_front_m, parameters) == (0.0 if stands else parameters.speed_mps)


@given(mode=st.sampled_from(Mode), d_front_m=st.none() | finite)
def test_speed_is_zero_or_the_set_one(mode: Mode, d_front_m: float | None) -> None:
    """(3) and (12): two speeds and no third, whatever is measured."""
    assert laws.speed_mps(mode, d_front_m, PAPER) in (0.0, PAPER.speed_mps)


# (6).


@given(wanted_m=st.floats(0.3, 20.0), h_m=st.floats(0.0, 20.0))
def test_climb_is_equation_6_within_the_limit(wanted_m: float, h_m: float) -> None:
    """(6): g·(H - h), up when too low, cut at the configured rate."""
    parameters = law_parameters(height_gain_per_s=0.5, max_climb_mps=0.4)
    climb = laws.climb_mps(wanted_m, h_m, None, 0.0, parameters)
    assert climb == float(np.clip(0.5 * (wanted_m - h_m), -0.4, 0.4))


@given(wanted_m=finite, h_m=finite, roof_m=st.none() | finite, ground_mps=finite)
def test_climb_stays_within_the_limit(wanted_m: float, h_m: float, roof_m: float | None, ground_mps: float) -> None:
    """(6): no measurement asks for more than the configured rate, nor for NaN."""
    assert abs(laws.climb_mps(wanted_m, h_m, roof_m, ground_mps, PAPER)) <= PAPER.max_climb_mps


def test_feed_forward_removes_the_offset_on_a_slope() -> None:
    """(6) on a slope: at the right height the vehicle must already climb as the ground does, up and down."""
    for ground_mps in (-0.15, 0.15):
        assert laws.climb_mps(1.5, 1.5, None, ground_mps, PAPER) == ground_mps


@pytest.mark.parametrize(
    ("roof_m", "rests_at_m"),
    [
        pytest.param(10.0, 1.5, id="high roof: H"),
        pytest.param(1.2, 1.5, id="H leaves 0.7 m: still H"),
        pytest.param(0.6, 1.5, id="H leaves just the vertical margin: still H"),
        pytest.param(0.3, 1.2, id="1.8 m of room: the margin below the roof"),
        pytest.param(-0.5, 0.5, id="1 m of room: the middle, never lower"),
    ],
)
def test_height_gives_way_to_a_low_roof(roof_m: float, rests_at_m: float) -> None:
    """(6): the height at which the law rests, by the room there is (roof given as seen from H)."""
    room_m = 1.5 + roof_m
    parameters = law_parameters(height_m=1.5, vertical_margin_m=0.6)
    # Room minus height and back again rounds a few times 2^-53 of 12 m.
    at_rest = laws.climb_mps(1.5, rests_at_m, room_m - rests_at_m, 0.0, parameters)
    assert at_rest == pytest.approx(0.0, abs=1e-14)
    assert laws.climb_mps(1.5, rests_at_m + 0.1, room_m - rests_at_m - 0.1, 0.0, parameters) < 0.0
    assert laws.climb_mps(1.5, rests_at_m - 0.1, room_m - rests_at_m + 0.1, 0.0, parameters) > 0.0


# The loop: the paper's model (1) beside a straight wall along y = 0.


def beside_a_wall(parameters: Parameters, gamma: int, start: Pose, duration_s: float) -> list[Pose]:
    """Poses of a vehicle under (7) R3 and a constant speed, one a sampling period."""
    poses, side = [start], math.copysign(1.0, start.y_m)
    while poses[-1].t_s < start.t_s + duration_s:
        pose = poses[-1]
        d_dot_mps = side * parameters.speed_mps * math.sin(pose.yaw_rad)
        rate = laws.boundary_yaw_rate_radps(gamma, side * pose.y_m, d_dot_mps, parameters)
        poses.append(unicycle(pose, Setpoint(pose.t_s, parameters.speed_mps, 0.0, rate), parameters.period_s))
    return poses


def sampled_sliding_error_m(parameters: Parameters) -> float:
    """How far from d_s the paper's law may remain when it is sampled.

    In one period the sliding variable ḋ + l·(d - d_s) changes by no more than (u_M + l)·v·dt, so that is how far it
    can overshoot its change of sign; and where it stays within a band, d - d_s stays within that band over l.
    """
    gain, speed = parameters.closing_gain_per_s, parameters.speed_mps
    return (parameters.max_yaw_rate_radps + gain) * speed * parameters.period_s / gain


@pytest.mark.parametrize("parameters", LAWS)
@pytest.mark.parametrize(("start_m", "start_rad"), [(0.6, 0.0), (3.0, 0.0), (0.9, -0.5), (1.1, 0.5)])
@pytest.mark.parametrize(("side", "gamma"), [pytest.param(1.0, -1, id="right"), pytest.param(-1.0, 1, id="left")])
def test_boundary_law_settles_at_the_margin(
    parameters: Parameters, side: float, gamma: int, start_m: float, start_rad: float
) -> None:
    """(1) with (7) R3: Γ = -1 holds d_s from a wall on the right, Γ = 1 from one on the left, from near and far.

    The vehicle also has to keep its way: with the other Γ it would turn round and hold the same d_s on its other hand.
    """
    poses = beside_a_wall(parameters, gamma, Pose(0.0, 0.0, side * start_m, 1.5, side * start_rad), 40.0)
    assert max(abs(pose.yaw_rad) for pose in poses) < math.pi / 2.0
    # The closing speed is at most l·k = 0.35 m/s, so 2 m take 6 s; after that the error decays as exp(-l·t), which by
    # 30 s is below 1e-3 m: the smooth law has to be there to that, the paper's to what sampling leaves.
    allowed_m = sampled_sliding_error_m(parameters) if parameters.law == "paper" else 1e-3
    late = poses[round(30.0 / parameters.period_s) :]
    assert max(abs(side * pose.y_m - parameters.margin_m) for pose in late) <= allowed_m


@pytest.mark.parametrize("parameters", LAWS)
@pytest.mark.parametrize("gamma", [-1, 1])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_gamma_decides_which_hand_the_wall_is_on(parameters: Parameters, gamma: int, side: float) -> None:
    """(7) R3: whichever way the vehicle flies at first, it ends with the wall on the right for Γ = -1, left for 1."""
    end = beside_a_wall(parameters, gamma, Pose(0.0, 0.0, side * 1.5, 1.5, 0.0), 40.0)[-1]
    wall_bearing_rad = wrap_rad(-side * math.pi / 2.0 - end.yaw_rad)
    # Sampled, ḋ and l·(d - d_s) each stay within (u_M + l)·v·dt of zero (see above); ḋ is v times the heading error.
    allowed_rad = 2.0 * (parameters.max_yaw_rate_radps + parameters.closing_gain_per_s) * parameters.period_s
    assert wall_bearing_rad == pytest.approx(gamma * math.pi / 2.0, abs=allowed_rad)
