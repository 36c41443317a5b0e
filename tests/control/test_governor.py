"""Speeds: the governor only ever lowers them, and a commanded one never jumps up."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.control.governor import braking_speed_mps, governed_speed_mps
from companion.control.navigator import Navigator
from companion.control.ramp import LONGEST_GAP_S, Ramp
from companion.model import CLEAR, HIT, UNKNOWN, Input, Mode, Pose, Scan, Setpoint
from tests.control.scene import BEARINGS_RAD, BINS, Scene, box, fly, law_parameters, measurement, mirrored_scan, scan_of
from tests.control.stages import ORIGIN, compiled, edge_scan

LAW = law_parameters()

reactions = st.floats(0.0, 3.0)
brakes = st.floats(0.01, 10.0)
sides = st.sampled_from([-1, 1, None])


@st.composite
def scans(draw: st.DrawFn) -> Scan:
    """Anything a scan may hold: walls from 5 cm on in stretches, free and unknown ground between them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    edges = np.sort(rng.integers(0, BINS, draw(st.integers(1, 20))))
    stretch = np.searchsorted(edges, np.arange(BINS))
    state = rng.choice([HIT, HIT, CLEAR, UNKNOWN], len(edges) + 1)[stretch].astype(np.uint8)
    least_m = draw(st.floats(0.05, 9.0))
    ranges = rng.uniform(least_m, 10.0, len(edges) + 1)[stretch] + rng.uniform(0.0, 0.1, BINS)
    ranges = np.where(state == HIT, ranges, np.where(state == CLEAR, 10.0, 0.0))
    return Scan(BEARINGS_RAD.copy(), ranges, state, np.ones(BINS, np.bool_))


def way_m(scan: Scan, critical_m: float) -> float:
    """How far the vehicle can fly straight on until some HIT before it is as near as d_c, found by bisection."""
    hit = (scan.state == HIT) & (np.abs(scan.bearings_rad) < math.pi / 2.0)
    x, y = (scan.ranges_m * np.cos(scan.bearings_rad))[hit], (scan.ranges_m * np.sin(scan.bearings_rad))[hit]
    x, y = x[np.abs(y) < critical_m], y[np.abs(y) < critical_m]
    # From -d_c on, where the foremost of them is as far away as it can be, until its foot.
    low, high = np.full_like(x, -critical_m), x.copy()
    for _ in range(60):
        middle = 0.5 * (low + high)
        clear = np.hypot(x - middle, y) > critical_m
        low, high = np.where(clear, middle, low), np.where(clear, high, middle)
    return float(np.min(low, initial=math.inf))


def nearest_m(scan: Scan) -> float:
    """d: the nearest HIT all round."""
    return float(np.min(scan.ranges_m[scan.state == HIT], initial=math.inf))


def wall_ahead(distance_m: float) -> Scan:
    """A wall across the heading, and nothing else."""
    return scan_of(lambda bearing_rad: distance_m / math.cos(bearing_rad) if abs(bearing_rad) < 1.0 else math.inf)


# Braking.


@given(room_m=st.floats(1e-3, 1000.0), reaction_s=reactions, brake_mps2=brakes)
def test_the_braking_speed_uses_up_the_room_and_no_more(room_m: float, reaction_s: float, brake_mps2: float) -> None:
    """reaction·v + v²/(2a) = room: the vehicle stands exactly where the room ends."""
    speed = braking_speed_mps(room_m, reaction_s, brake_mps2)
    assert speed > 0.0
    # The root is a difference of numbers up to delay·a = 30 m/s, each rounded by 2^-53: 1e-14 m/s, times 3 s.
    assert reaction_s * speed + speed**2 / (2.0 * brake_mps2) == pytest.approx(room_m, rel=1e-9, abs=1e-13)


@given(room_m=st.floats(-1000.0, 0.0), reaction_s=reactions, brake_mps2=brakes)
def test_without_room_the_braking_speed_is_zero(room_m: float, reaction_s: float, brake_mps2: float) -> None:
    """Inside of the critical margin nothing may move towards the wall."""
    assert braking_speed_mps(room_m, reaction_s, brake_mps2) == 0.0


@given(room_m=st.floats(0.0, 1e300), reaction_s=reactions, brake_mps2=brakes)
def test_the_braking_speed_is_a_speed(room_m: float, reaction_s: float, brake_mps2: float) -> None:
    """Finite and not negative for every room there could be; nothing ahead at all gives no bound."""
    assert braking_speed_mps(5e-324, 2.2e-180, 0.25) == 0.0, "found by a search: it was below zero"
    assert 0.0 <= braking_speed_mps(room_m, reaction_s, brake_mps2) < math.inf
    assert braking_speed_mps(math.inf, reaction_s, brake_mps2) == math.inf


@pytest.mark.parametrize(
    ("reaction_s", "brake_mps2", "room_m", "speed_mps"), [(0.0, 0.5, 1.0, 1.0), (1.0, 2.0, 3.0, 2.0)]
)
def test_the_braking_speed_by_hand(reaction_s: float, brake_mps2: float, room_m: float, speed_mps: float) -> None:
    """Without delay v = sqrt(2·a·room); with one of 1 s, 2 m/s need 2 m before and 1 m while braking at 2 m/s²."""
    assert braking_speed_mps(room_m, reaction_s, brake_mps2) == speed_mps


# The governed speed.


@compiled
@given(
    speed_mps=st.floats(0.0, 5.0), scan=scans(), gamma=sides, forward_mps=st.floats(-2.0, 5.0), d_m=st.floats(0.0, 20.0)
)
def test_the_governor_never_raises_the_speed_nor_turns_it_round(
    speed_mps: float, scan: Scan, gamma: int | None, forward_mps: float, d_m: float
) -> None:
    """A2 to A4 leave v(t) arbitrary below v_M: what (12) gives stays the upper bound, 0 the lower one."""
    for nearest in (d_m, nearest_m(scan)):
        assert 0.0 <= governed_speed_mps(speed_mps, scan, nearest, gamma, forward_mps, LAW) <= speed_mps


@compiled
@given(scan=scans(), gamma=sides, forward_mps=st.floats(0.0, 5.0))
def test_what_is_flown_can_be_braked_before_the_critical_margin(
    scan: Scan, gamma: int | None, forward_mps: float
) -> None:
    """Braked with reaction·v + v²/(2a) nothing before it comes nearer than d_c, but for the least speed."""
    speed = governed_speed_mps(5.0, scan, nearest_m(scan), gamma, forward_mps, LAW)
    governor, room_m = LAW.governor, way_m(scan, LAW.critical_margin_m)
    if speed > governor.least_speed_mps:
        # Rounding of the root, as above.
        assert governor.reaction_s * speed + speed**2 / (2.0 * governor.brake_mps2) <= room_m + 1e-9


@compiled
@given(scan=scans(), gamma=st.sampled_from([-1, 1]), forward_mps=st.floats(0.0, 1.0))
def test_a_mirrored_scan_is_governed_alike(scan: Scan, gamma: int, forward_mps: float) -> None:
    """With left and right exchanged, Γ too, the speed stays: a sign error in either turn would show here."""
    d_m = nearest_m(scan)
    here = governed_speed_mps(0.5, scan, d_m, gamma, forward_mps, LAW)
    there = governed_speed_mps(0.5, mirrored_scan(scan), d_m, -gamma, forward_mps, LAW)
    # sin and cos of mirrored bearings may differ in their last bit.
    assert here == pytest.approx(there, abs=1e-12)


@pytest.mark.parametrize("gamma", [-1, 1, None])
def test_open_ground_is_flown_at_the_set_speed(gamma: int | None) -> None:
    """Nothing in view, no reason to be slow."""
    assert governed_speed_mps(0.5, scan_of(lambda _: math.inf), math.inf, gamma, 0.5, LAW) == 0.5


@pytest.mark.parametrize("side", [-1, 1])
def test_a_straight_wall_at_the_margin_is_followed_at_the_set_speed(side: int) -> None:
    """Following a wall at d_s, the flight's usual state, must not be slowed by the wall that is followed."""
    scene = Scene(box(-50.0, -1.0, 50.0, 50.0))
    if side > 0:
        scene = scene.mirrored()
    scan = scene.scan(Pose(0.0, 0.0, 0.0, 1.5, 0.0))
    assert governed_speed_mps(0.5, scan, 1.0, side, 0.5, LAW) == 0.5


@pytest.mark.parametrize("width_m", [2.6, 3.0, 4.0])
@pytest.mark.parametrize("gamma", [-1, 1, None])
@pytest.mark.parametrize("askew_rad", [-0.05, 0.0, 0.05])
def test_a_straight_drift_is_flown_at_the_set_speed(width_m: float, gamma: int | None, askew_rad: float) -> None:
    """Protects from creeping: 0.13 m/s in a drift 2.6 m wide, since no full turn fits where nothing is to turn from."""
    drift = Scene(box(-50.0, -1.0, 50.0, width_m - 1.0))
    drift = drift if gamma != 1 else drift.mirrored()
    scan = drift.scan(Pose(0.0, 0.0, 0.0, 1.5, askew_rad))
    assert governed_speed_mps(0.5, scan, nearest_m(scan), gamma, 0.5, LAW) == 0.5


@pytest.mark.parametrize("gamma", [-1, 1])
def test_before_the_end_of_a_narrow_drift_it_slows_to_the_turn_that_fits(gamma: int) -> None:
    """Protects d_s: there the turn away must fit, and from further off it comes down to that steadily."""
    turning_radps = LAW.governor.turn_share * LAW.max_yaw_rate_radps
    speeds = []
    for to_go_m in (6.0, 2.6, 2.2, 1.8, 1.5, 1.2):
        drift = Scene(box(-50.0, -1.0, to_go_m, 1.6))
        scan = (drift if gamma < 0 else drift.mirrored()).scan(Pose(0.0, 0.0, 0.0, 1.5, 0.0))
        speeds.append(governed_speed_mps(0.5, scan, nearest_m(scan), gamma, 0.0, LAW))
        # No bearing looks straight ahead: the nearest ones see the wall a fraction of a millimetre further.
        assert speeds[-1] <= max((1.6 - 0.9) / 2.0, to_go_m - 0.9) * turning_radps + 1e-3
    assert speeds[0] == 0.5
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] < 0.2


@pytest.mark.parametrize("side", [-1, 1])
def test_the_turn_that_the_wall_asks_for_is_the_one_that_counts(side: int) -> None:
    """Γ = -1 turns away to the left: the room on the left bounds the speed, not that on the right; mirrored for 1."""
    # A post ahead on the side of the wall that is followed: the turn away from that passes it by.
    post_rad, post_m = side * math.atan2(0.6, 1.6), math.hypot(0.6, 1.6)
    scan = scan_of(lambda bearing_rad: post_m if abs(bearing_rad - post_rad) < 0.03 else math.inf)
    away = governed_speed_mps(0.5, scan, 1.0, side, 0.5, LAW)
    into = governed_speed_mps(0.5, scan, 1.0, -side, 0.5, LAW)
    assert away == 0.5
    assert into < 0.4, "there only what braking for any turn leaves"
    assert governed_speed_mps(0.5, scan, 1.0, None, 0.5, LAW) == away


def test_at_the_wall_the_vehicle_stands() -> None:
    """With the nearest obstacle straight ahead there is not even creeping: that would bring it nearer."""
    scan = wall_ahead(0.6)
    assert governed_speed_mps(0.5, scan, nearest_m(scan), None, 0.0, LAW) == 0.0


@compiled
@given(distances_m=st.lists(st.floats(0.71, 9.0), min_size=2, max_size=2, unique=True))
def test_a_nearer_wall_ahead_is_never_flown_at_faster(distances_m: list[float]) -> None:
    """Monotonic in the distance: coming nearer slows down."""
    near, far = (governed_speed_mps(5.0, wall_ahead(m), m, None, 0.0, LAW) for m in sorted(distances_m))
    assert near <= far


@compiled
@given(scan=scans(), gamma=sides, forward_mps=st.floats(0.0, 5.0), faster_mps=st.floats(0.0, 5.0))
def test_a_faster_vehicle_gets_no_higher_speed(
    scan: Scan, gamma: int | None, forward_mps: float, faster_mps: float
) -> None:
    """What is flown before a turn takes effect is lost to the turn, so flying fast never earns more speed."""
    slow, fast = (
        governed_speed_mps(5.0, scan, nearest_m(scan), gamma, v, LAW) for v in sorted((forward_mps, faster_mps))
    )
    assert fast <= slow


def test_a_vehicle_that_obeys_stops_before_the_wall() -> None:
    """The braking inequality in a simulated approach: with the reaction's delay and the brake's limit, d_c is kept."""
    governor, dt_s = LAW.governor, LAW.period_s
    wall = Scene(box(-50.0, -50.0, 8.0, 50.0))
    pending = [2.0] * round(governor.reaction_s / dt_s)
    x_m, speed = 0.0, 2.0
    while speed > governor.least_speed_mps and x_m < 8.0:
        scan = wall.scan(Pose(0.0, x_m, 0.0, 1.5, 0.0))
        pending.append(governed_speed_mps(2.0, scan, 8.0 - x_m, None, speed, LAW))
        speed = max(pending.pop(0), speed - governor.brake_mps2 * dt_s)
        x_m += speed * dt_s
    assert 8.0 - x_m >= LAW.critical_margin_m


# The ramp: a commanded velocity never jumps up, and never waits to come down.


ACCEL_MPS2, DT_S = 1.0, 0.05
ROUNDING_MPS = 1e-9

wanted = st.builds(
    Setpoint,
    t_s=st.just(0.0),
    speed_mps=st.floats(-2.0, 2.0) | st.floats(),
    climb_mps=st.floats(-1.0, 1.0) | st.floats(),
    yaw_rate_radps=st.floats(-1.0, 1.0) | st.floats(),
)
gaps_s = st.floats(0.0, 0.6) | st.sampled_from([DT_S, 0.0, -1.0, 0.5, 0.501, 60.0, math.nan, math.inf])


def kept_mps(last: float, now: float) -> float:
    """What of the last velocity still goes the same way."""
    return abs(last) if math.copysign(1.0, last) == math.copysign(1.0, now) else 0.0


@given(ticks=st.lists(st.tuples(gaps_s, wanted), max_size=30), accel_mps2=st.floats(0.2, 5.0))
def test_it_never_grows_faster_never_brakes_later_and_is_always_a_number(
    ticks: list[tuple[float, Setpoint]], accel_mps2: float
) -> None:
    """The three promises to the gate and to the wall, whatever is asked for and however the ticks come."""
    ramp = Ramp(accel_mps2, DT_S)
    t_s, last = 0.0, Setpoint(-math.inf, 0.0, 0.0, 0.0)
    for gap_s, asked in ticks:
        t_s = t_s + gap_s if math.isfinite(t_s) else 0.0
        now = ramp.limit(replace(asked, t_s=t_s))
        passed_s = t_s - last.t_s
        rested = not passed_s <= LONGEST_GAP_S
        most_mps = accel_mps2 * (DT_S if rested else max(passed_s, 0.0))
        for want, before, after in (
            (asked.speed_mps, last.speed_mps, now.speed_mps),
            (asked.climb_mps, last.climb_mps, now.climb_mps),
        ):
            assert math.isfinite(after)
            assert abs(after) <= (0.0 if rested else kept_mps(before, after)) + most_mps + ROUNDING_MPS
            if not math.isfinite(want):
                assert after == 0.0
                continue
            assert abs(after) <= abs(want)
            assert after == 0.0 or math.copysign(1.0, after) == math.copysign(1.0, want)
            if not rested and abs(want) <= kept_mps(before, want):
                assert after == want
        assert now.yaw_rate_radps == (asked.yaw_rate_radps if math.isfinite(asked.yaw_rate_radps) else 0.0)
        last = now


def test_a_constant_wish_is_reached_in_a_straight_line() -> None:
    """0.5 m/s at 1 m/s² take ten periods, and then it is exactly what the law wants."""
    ramp = Ramp(ACCEL_MPS2, DT_S)
    speeds = [ramp.limit(Setpoint(DT_S * i, 0.5, -0.2, 0.6)).speed_mps for i in range(12)]
    assert speeds[:10] == pytest.approx([0.05 * (i + 1) for i in range(10)])
    assert speeds[10:] == [0.5, 0.5]


def test_it_stops_and_turns_round_at_once() -> None:
    """From climbing to sinking: zero is passed without waiting, and the way down begins there."""
    ramp = Ramp(ACCEL_MPS2, DT_S)
    for i in range(8):
        ramp.limit(Setpoint(DT_S * i, 0.4, 0.4, 0.0))
    turned = ramp.limit(Setpoint(DT_S * 8, 0.0, -0.4, 0.0))
    assert turned.speed_mps == 0.0
    assert turned.climb_mps == pytest.approx(-ACCEL_MPS2 * DT_S)


def test_after_a_pause_it_begins_at_rest() -> None:
    """Somebody else flew meanwhile, or the vehicle was held: what it was told before is not what it does."""
    ramp = Ramp(ACCEL_MPS2, DT_S)
    for i in range(20):
        ramp.limit(Setpoint(DT_S * i, 0.5, 0.0, 0.0))
    again_s = DT_S * 19 + LONGEST_GAP_S + 0.01
    assert ramp.limit(Setpoint(again_s, 0.5, 0.0, 0.0)).speed_mps == pytest.approx(ACCEL_MPS2 * DT_S)


def test_missed_ticks_are_made_good() -> None:
    """A tick that came late by four periods has their growth too: the vehicle is not slower for a busy computer."""
    ramp = Ramp(ACCEL_MPS2, DT_S)
    ramp.limit(Setpoint(0.0, 0.5, 0.0, 0.0))
    assert ramp.limit(Setpoint(5 * DT_S, 0.5, 0.0, 0.0)).speed_mps == pytest.approx(6 * ACCEL_MPS2 * DT_S)


def test_after_a_hold_the_navigator_begins_at_zero() -> None:
    """The whole law: an input was missing for one tick, and the speed before is not taken up where it was left."""
    navigator = Navigator(law_parameters(choice="coin", speed_law="paper"), np.random.default_rng(0))
    seen = measurement(edge_scan(1))
    speeds = [navigator.step(seen, ORIGIN, DT_S * i).speed_mps for i in range(15)]
    assert navigator.status.mode is Mode.TANGENT
    assert speeds[0] == pytest.approx(DT_S * navigator.parameters.max_accel_mps2)
    assert speeds[-1] == navigator.parameters.speed_mps
    assert navigator.step(replace(seen, missing=(Input.DEPTH,)), ORIGIN, DT_S * 15).speed_mps == 0.0
    assert navigator.step(seen, ORIGIN, DT_S * 16).speed_mps == pytest.approx(speeds[0])


@pytest.mark.parametrize("accel_mps2", [0.2, 1.0])
def test_a_flight_keeps_to_it(accel_mps2: float) -> None:
    """What the safety gate will check of every setpoint of a flight, with stops before walls in it."""
    navigator = Navigator(law_parameters(max_accel_mps2=accel_mps2), np.random.default_rng(3))
    track = fly(navigator, Scene(box(0.0, 0.0, 9.0, 6.0)), replace(ORIGIN, x_m=4.0, y_m=3.0), 60.0)
    speeds = np.array([setpoint.speed_mps for setpoint in track.setpoints])
    period_s = navigator.parameters.period_s
    assert speeds.max() == navigator.parameters.speed_mps
    assert np.diff(speeds, prepend=0.0).max() <= accel_mps2 * period_s + ROUNDING_MPS


def test_what_it_turns_to_is_braked_for_as_well_as_what_it_points_at() -> None:
    """Protects d_c in R2: it pointed past a wall, turned towards a target beside it at 1.1 m/s, and came to 0.75 m."""
    swift = law_parameters(speed_mps=1.5, max_yaw_rate_radps=1.0, margin_m=1.0, critical_margin_m=0.8)
    # Seen 1.2 m away at 57° to the right, where a target at 21° has 0.7 m to it beside.
    beside = scan_of(lambda bearing_rad: 1.2 if abs(bearing_rad + 1.0) < 0.2 else math.inf)
    past = governed_speed_mps(1.5, beside, 1.2, None, 1.1, swift)
    into = governed_speed_mps(1.5, beside, 1.2, None, 1.1, swift, towards_rad=-0.37)
    away = governed_speed_mps(1.5, beside, 1.2, None, 1.1, swift, towards_rad=0.37)
    assert past == away > 1.0
    x_m, y_m = 1.2 * math.cos(0.8 - 0.37), 1.2 * math.sin(0.8 - 0.37)
    room_m = x_m - math.sqrt(0.85**2 - y_m**2)
    governor = swift.governor
    assert into == pytest.approx(braking_speed_mps(room_m, governor.reaction_s, governor.brake_mps2), rel=0.1)
