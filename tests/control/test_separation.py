"""Vehicles that stay apart: in height where they can, in the plane until then."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from companion.control.fleet import Fleet, Report
from companion.control.separation import PATIENCE_S, STAYS_APART, Clearance, Separation, Spacing
from companion.model import Setpoint

SPACING = Spacing(
    apart_m=0.6,
    keep_m=1.0,
    speed_mps=0.5,
    reaction_s=0.6,
    brake_mps2=0.43,
    slope=0.35,
    body_height_m=0.3,
    lowest_m=0.75,
    highest_m=2.25,
)
ALONE_M, STALE_S, PERIOD_S = 1.5, 1.0, 0.05
PASSED_M = 0.8
"""Whoever is so near to another one in the plane passes above or below it."""

BODY_M = 0.7, 0.3
"""Two bodies touch when they are nearer than this in the plane and in height."""


def separation(own_id: int, spacing: Spacing = SPACING) -> tuple[Fleet, Separation]:
    """What keeps a vehicle apart that has heard nobody yet."""
    fleet = Fleet(own_id, group_range_m=4.0, tunnel_height_m=3.0, stale_after_s=STALE_S)
    return fleet, Separation(fleet, spacing, ALONE_M, STALE_S)


def meeting(own: tuple[float, float, float], *others: tuple[float, float, float], t_s: float = 0.0) -> Clearance:
    """What vehicle 1 may do that is at x, y and a height, others of numbers from 2 on likewise, over level ground."""
    fleet, apart = separation(1)
    for number, (x_m, y_m, height_m) in enumerate(others, start=2):
        fleet.on_report(number, Report(t_s, x_m, y_m, height_m, height_m))
    apart.report(t_s, own, own[2])
    return apart.clearance(t_s)


# One vehicle, one moment.


def test_alone_nothing_is_asked() -> None:
    """Before anybody was heard, and with one far away: its own height, no waiting, no limit."""
    for clearance in (meeting((0.0, 0.0, 1.5)), meeting((0.0, 0.0, 1.5), (30.0, 0.0, 1.5))):
        assert clearance.height_m == ALONE_M
        assert not clearance.holds
        assert clearance.limited(Setpoint(0.0, 0.5, 0.0, 0.0), 0.0).speed_mps == 0.5


def test_before_its_own_place_is_known_it_keeps_its_height() -> None:
    """Nothing can be said of distances; the setpoint without a place is none anyway."""
    fleet, apart = separation(1)
    fleet.on_report(2, Report(0.0, 1.0, 0.0, 1.5, 1.5))
    assert apart.clearance(0.0) == Clearance(ALONE_M, False, (), SPACING)


def test_at_one_height_and_near_both_wait_and_go_to_their_layers() -> None:
    """2 m from each other: they would have to brake, and layers 1 m apart are 3 s away."""
    clearance = meeting((0.0, 0.0, 1.5), (2.0, 0.0, 1.5))
    assert clearance.holds
    assert clearance.height_m == 2.0


def test_apart_in_height_nobody_waits() -> None:
    """That is what layers are for: one passes above the other."""
    clearance = meeting((0.0, 0.0, 2.0), (1.0, 0.0, 1.0))
    assert not clearance.holds
    assert clearance.limited(Setpoint(0.0, 0.5, 0.0, 0.0), 0.0).speed_mps == 0.5


def test_whoever_is_below_stays_below_while_one_is_above() -> None:
    """Their numbers say the other way round: not here, beside each other they may change."""
    below = meeting((0.0, 0.0, 0.9), (0.5, 0.0, 1.9))
    assert below.height_m <= 1.9 - 0.6
    beside = meeting((0.0, 0.0, 0.9), (3.5, 0.0, 1.9))
    assert beside.height_m == 2.0


def test_too_near_at_one_height_they_part_in_height_by_their_numbers() -> None:
    """Blown together, or a start too near: the smaller number goes up, the other down, whoever is asked."""
    up = meeting((0.0, 0.0, 1.5), (0.5, 0.0, 1.52))
    assert up.holds
    assert up.height_m > 1.5 + 0.5
    fleet, apart = separation(2)
    fleet.on_report(1, Report(0.0, 0.0, 0.0, 1.5, 1.5))
    apart.report(0.0, (0.5, 0.0, 1.52), 1.52)
    assert apart.clearance(0.0).height_m < 1.52 - 0.5


def test_no_layer_is_left_below_the_lowest_or_above_the_highest() -> None:
    """Making room for another one must not lead to the ground or to the roof."""
    assert meeting((0.0, 0.0, 0.8), (0.5, 0.0, 1.0)).height_m >= SPACING.lowest_m
    assert meeting((0.0, 0.0, 2.2), (0.5, 0.0, 2.0)).height_m <= SPACING.highest_m


def test_of_two_levels_of_a_mine_neither_waits() -> None:
    """8 m of rock are between them, though both fly 1.5 m above their ground."""
    fleet, apart = separation(1)
    fleet.on_report(2, Report(0.0, 0.5, 0.0, 9.5, 1.5))
    apart.report(0.0, (0.0, 0.0, 1.5), 1.5)
    assert not apart.clearance(0.0).holds


def test_on_a_slope_heights_above_the_ground_count() -> None:
    """1 comes up a ramp of 25 % at 2 m, 2 down it at 1 m: 2 m from each other their z differ by half a metre only."""
    fleet, apart = separation(1)
    fleet.on_report(2, Report(0.0, 2.0, 0.0, 1.5, 1.0))
    apart.report(0.0, (0.0, 0.0, 2.0), 2.0)
    assert not apart.clearance(0.0).holds


def test_the_back_of_whoever_flies_below_is_told() -> None:
    """How far down it is, and how high above the ground: the beam downward will meet it."""
    fleet, apart = separation(1)
    assert apart.beneath() == ()
    fleet.on_report(2, Report(0.0, 0.5, 0.0, 11.0, 1.0))
    fleet.on_report(3, Report(0.0, 0.5, 0.0, 13.0, 3.0))
    fleet.on_report(4, Report(0.0, 5.0, 0.0, 11.0, 1.0))
    apart.report(0.0, (0.0, 0.0, 12.0), 2.0)
    ((down_m, height_m),) = apart.beneath()
    assert down_m == pytest.approx(0.85)
    assert height_m == pytest.approx(1.15)


def test_the_back_of_one_that_has_lost_the_ground_is_no_ground() -> None:
    """Over the edge of a shaft it says no height; its back, taken for ground, would be where that ends for both."""
    fleet, apart = separation(1)
    fleet.on_report(2, Report(0.0, 0.5, 0.0, 11.0))
    apart.report(0.0, (0.0, 0.0, 12.0), None)
    assert apart.beneath() == ()
    apart.report(0.0, (0.0, 0.0, 12.0), 2.0)
    ((down_m, height_m),) = apart.beneath()
    assert down_m == pytest.approx(0.85)
    assert height_m == pytest.approx(1.15)


def test_who_has_landed_has_no_layer_but_its_place() -> None:
    """It needs no height: the others share what there is, and keep above it."""
    fleet, apart = separation(1)
    fleet.on_report(2, Report(0.0, 2.0, 0.0, 0.1, 0.1, flies=False))
    apart.report(0.0, (0.0, 0.0, 1.5), 1.5)
    assert apart.clearance(0.0) == Clearance(ALONE_M, False, (), SPACING)


def test_under_a_low_roof_patience_ends_and_the_distance_is_kept() -> None:
    """Where the layers cannot be reached they would wait for ever: they go on by sight, but not towards each other."""
    fleet, apart = separation(1)
    for tick in range(round((PATIENCE_S + 1.0) / PERIOD_S)):
        t_s = tick * PERIOD_S
        fleet.on_report(2, Report(t_s, 1.5, 0.0, 1.5, 1.5))
        apart.report(t_s, (0.0, 0.0, 1.5), 1.5)
        clearance = apart.clearance(t_s)
        assert clearance.holds == (t_s < PATIENCE_S)
    towards, away = (clearance.limited(Setpoint(t_s, 0.5, 0.0, 0.1), yaw_rad) for yaw_rad in (0.0, math.pi))
    # Half of the half metre that is left, by 0.6 s and 0.43 m/s².
    assert towards.speed_mps == pytest.approx(0.2726, abs=1e-4)
    assert towards.yaw_rate_radps == 0.1
    assert away.speed_mps == 0.5


@given(
    ahead_m=st.floats(-3.0, 3.0),
    aside_m=st.floats(-3.0, 3.0),
    forward_mps=st.floats(-0.5, 0.5),
    left_mps=st.floats(-0.5, 0.5),
    yaw=st.floats(-4.0, 4.0),
)
@example(ahead_m=0.0, aside_m=0.8, forward_mps=0.0, left_mps=0.4, yaw=0.0)
@example(ahead_m=-0.8, aside_m=0.0, forward_mps=-0.4, left_mps=0.0, yaw=0.0)
def test_a_limited_speed_is_one_that_can_be_stood_before(
    ahead_m: float, aside_m: float, forward_mps: float, left_mps: float, yaw: float
) -> None:
    """Whoever flies straight on at it, reacts late and brakes, has half of the way left to the other one.

    Aside and backward too: away from a wall a vehicle came sideways at another one as fast as it liked.
    """
    east_m = ahead_m * math.cos(yaw) - aside_m * math.sin(yaw)
    north_m = ahead_m * math.sin(yaw) + aside_m * math.cos(yaw)
    clearance = Clearance(1.5, False, ((east_m, north_m),), SPACING)
    limited = clearance.limited(Setpoint(0.0, forward_mps, 0.0, 0.0, left_mps), yaw)
    wanted_mps, limited_mps = math.hypot(forward_mps, left_mps), math.hypot(limited.speed_mps, limited.lateral_mps)
    assert limited_mps <= wanted_mps + 1e-12
    assert limited.speed_mps * left_mps == pytest.approx(limited.lateral_mps * forward_mps, abs=1e-9)
    if limited_mps <= 1e-9:
        return
    towards_m = (ahead_m * forward_mps + aside_m * left_mps) / wanted_mps
    beside_m = (aside_m * forward_mps - ahead_m * left_mps) / wanted_mps
    if towards_m <= 1e-9:
        assert limited_mps == pytest.approx(wanted_mps)
        return
    stop_m = limited_mps * SPACING.reaction_s + limited_mps**2 / (2.0 * SPACING.brake_mps2)
    apart_m = math.hypot(towards_m - 2.0 * stop_m, beside_m)
    assert apart_m >= SPACING.keep_m - 1e-6 or abs(beside_m) >= SPACING.keep_m - 1e-6


# Many of them, in a world that is nothing but them.


@dataclass
class Body:
    """A vehicle of the virtual world: it flies straight ahead, turns where it likes, and climbs as (6) says."""

    number: int
    x_m: float
    y_m: float
    height_m: float
    yaw_rad: float
    apart: Separation
    fleet: Fleet
    speed_mps: float = 0.0
    inbox: list[tuple[float, int, Report]] = field(default_factory=list)

    def hear(self, t_s: float) -> None:
        """What has arrived by now."""
        for _, number, report in [one for one in self.inbox if one[0] <= t_s]:
            self.fleet.on_report(number, report)
        self.inbox = [one for one in self.inbox if one[0] > t_s]

    def fly(self, wanted_mps: float, clearance: Clearance, roof_m: float) -> None:
        """One period: (6) with what (12) and the clearance leave; speed follows as the simulated vehicle's does."""
        setpoint = Setpoint(0.0, 0.0 if clearance.holds else wanted_mps, 0.0, 0.0)
        to_mps = clearance.limited(setpoint, self.yaw_rad).speed_mps
        change_mps = np.clip((to_mps - self.speed_mps) * (1.0 - math.exp(-PERIOD_S / 0.3)), -0.075, 0.075)
        self.speed_mps += float(change_mps)
        height_m = min(clearance.height_m, roof_m - SPACING.apart_m)
        self.height_m += float(np.clip(height_m - self.height_m, -0.4, 0.4)) * PERIOD_S
        self.x_m += self.speed_mps * math.cos(self.yaw_rad) * PERIOD_S
        self.y_m += self.speed_mps * math.sin(self.yaw_rad) * PERIOD_S


Lost = Callable[[float, int, int], bool]
"""Whether what one says at a time does not reach another."""


def flown(
    seed: int,
    size_m: tuple[float, float],
    numbers: list[int],
    duration_s: float,
    roof_m: float = 3.0,
    delay_s: float = 0.0,
    lost: Lost = lambda _t_s, _one, _other: False,
) -> tuple[float, int, list[Body]]:
    """Vehicles that fly at random in a rectangle, to one another all the time.

    Returns:
        The least of what they are apart, as a share of what they are to be: of `SPACING.keep_m` in the plane or of
        what is apart in height, whichever is more; how often one was passed within `PASSED_M`; the vehicles.
    """
    rng = np.random.default_rng(seed)
    bodies: list[Body] = []
    while len(bodies) < len(numbers):
        x_m, y_m = rng.uniform((0.0, 0.0), size_m)
        if all(math.hypot(x_m - body.x_m, y_m - body.y_m) >= 1.5 for body in bodies):
            fleet, apart = separation(numbers[len(bodies)])
            bodies.append(Body(fleet.own_id, x_m, y_m, ALONE_M, rng.uniform(-math.pi, math.pi), apart, fleet))
    least, passed = math.inf, 0
    was_near = dict.fromkeys(combinations(range(len(bodies)), 2), False)
    for tick in range(round(duration_s / PERIOD_S)):
        t_s = tick * PERIOD_S
        for body in bodies:
            report = body.apart.report(t_s, (body.x_m, body.y_m, body.height_m), body.height_m)
            for other in bodies:
                if other is not body and tick % 4 == 0 and not lost(t_s, body.number, other.number):
                    other.inbox.append((t_s + delay_s, body.number, report))
        for body in bodies:
            body.hear(t_s)
        for body in bodies:
            if rng.random() < 0.01 or not (0.0 < body.x_m < size_m[0] and 0.0 < body.y_m < size_m[1]):
                aim = rng.uniform((0.0, 0.0), size_m)
                body.yaw_rad = math.atan2(aim[1] - body.y_m, aim[0] - body.x_m)
            body.fly(SPACING.speed_mps, body.apart.clearance(t_s), roof_m)
        for i, j in was_near:
            a, b = bodies[i], bodies[j]
            beside_m = math.hypot(a.x_m - b.x_m, a.y_m - b.y_m)
            above_m = abs(a.height_m - b.height_m)
            least = min(least, max(beside_m / SPACING.keep_m, above_m / (STAYS_APART * SPACING.apart_m)))
            assert beside_m > BODY_M[0] or above_m > BODY_M[1], f"{a.number} and {b.number} touched at {t_s:.1f} s"
            passed += beside_m < PASSED_M and not was_near[i, j]
            was_near[i, j] = beside_m < PASSED_M
    return least, passed, bodies


HALL, DRIFT = (8.0, 8.0), (14.0, 2.0)
"""A hall in which all are in one group all the time, and a drift in which groups are joined and left."""


@pytest.mark.parametrize("size_m", [HALL, DRIFT], ids=["hall", "drift"])
@pytest.mark.parametrize("seed", range(3))
def test_three_at_random_never_come_too_near(seed: int, size_m: tuple[float, float]) -> None:
    """Whoever joins or leaves, and in whatever order they come: nobody swaps through another one; and they do pass."""
    least, passed, _ = flown(seed, size_m, [1, 2, 3], 90.0)
    assert least >= 0.95
    assert passed > 0


@pytest.mark.parametrize("seed", range(2))
def test_late_reports_are_allowed_for(seed: int) -> None:
    """Five a second that take 0.4 s: one may be 0.3 m from where it says."""
    least, passed, _ = flown(seed, DRIFT, [5, 2, 9], 90.0, delay_s=0.4)
    assert least >= 0.85
    assert passed > 0


def test_a_roof_that_is_too_low_keeps_them_apart_in_the_plane() -> None:
    """d_M is not there: no layers can be reached, they wait, and go on by sight at their distance."""
    least, passed, bodies = flown(1, HALL, [1, 2], 90.0, roof_m=1.9)
    assert least >= 0.95
    assert passed == 0
    assert all(body.speed_mps >= 0.0 for body in bodies)


def test_silence_keeps_the_layers_that_are_flown() -> None:
    """Nobody hears anybody from 10 s on: each keeps its own layer, and above each other they stay apart."""
    least, _, bodies = flown(3, (3.5, 3.5), [1, 2, 3], 60.0, lost=lambda t_s, _one, _other: t_s > 10.0)
    assert least >= 0.95
    assert [round(body.height_m, 1) for body in bodies] == pytest.approx([2.25, 1.5, 0.75], abs=0.06)


@pytest.mark.parametrize("seed", [0, 3])
def test_who_hears_only_now_and_then_changes_no_sides(seed: int) -> None:
    """Each hears each other for some seconds and then not, so that their groups are not the same: nobody swaps."""
    least, passed, _ = flown(
        seed, HALL, [1, 2, 3], 90.0, lost=lambda t_s, one, other: (int(t_s / 4.0) * 7 + one * 3 + other * 5) % 4 == 0
    )
    assert least >= 1.0
    assert passed > 0
