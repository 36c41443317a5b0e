"""The stopping budget: its arithmetic, its worst speeds, and the measurements that it rests on."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config.settings import Settings
from companion.gate.faults import Fault, Stage
from companion.gate.plan import CYCLE_S, Plan, Reaction
from companion.safety_case.gate_plan import to_basis, to_plan
from companion.safety_case.stopping_budget import (
    LAW_FLIES,
    MODE_BRAKE_MPS2,
    SILENCE_EXTRA_S,
    Basis,
    BudgetLine,
    Law,
    _cases,
    _line,
    stopping_budget,
)
from companion.station_keeping import GAIN_PER_S, PATIENCE_S

SETTINGS = Settings()
PLAN = to_plan(SETTINGS, command=(), restart_command=())
BASIS = to_basis(SETTINGS)
SPEED_MPS = PLAN.limits.speed_mps
MODE_CREEP_M = SETTINGS.safety.hold_creep_m
GRID = 60


def lines_at(speed_mps: float, plan: Plan, basis: Basis) -> list[BudgetLine]:
    """The budget at one speed, which need not be the worst."""
    return [_line(case, speed_mps, plan, basis) for case in _cases(plan, basis)]


def line_of(name: str, plan: Plan = PLAN, speed_mps: float = SPEED_MPS) -> BudgetLine:
    return next(line for line in lines_at(speed_mps, plan, BASIS) if line.fault == name)


def answered(fault: Fault, stage: Stage) -> Plan:
    return replace(PLAN, reactions=PLAN.reactions | {fault: Reaction(stage, None, None)})


def test_every_fault_and_the_end_of_the_gate_have_a_line() -> None:
    """A fault that is not in the table is not in the safety case; one alone nothing bounds: that nobody obeys."""
    names = [line.fault for line in stopping_budget(PLAN, BASIS)]
    bounded = [fault.value for fault in Fault if fault is not Fault.NOT_OBEYED]
    assert names == [*bounded, "gate killed", "computer dead", "link cut"]


def test_the_default_leaves_room_for_every_fault() -> None:
    """What ships must not be able to reach a wall; 10 cm is what is left of the least, with what it creeps on."""
    least = min(stopping_budget(PLAN, BASIS), key=lambda line: line.remaining_m)
    assert not any(line.reaches_wall for line in stopping_budget(PLAN, BASIS))
    assert least.remaining_m == pytest.approx(0.102, abs=0.001)


def test_the_sum_by_hand() -> None:
    """Depth, 0.55 m/s: 0.55·(0.55 + 0.06 + 0.15) + 0.55²/0.86 + 0.25 = 1.0197; allowed 0.8 + 0.55·0.6 + 0.55²/0.86."""
    line = line_of("depth_stale")
    assert (line.detection_s, line.autopilot_s) == (0.55, 0.15)
    assert line.reaction_s == pytest.approx(CYCLE_S + 0.05)
    assert line.creep_m == MODE_CREEP_M, "the gate's hold ends in the autopilot's"
    assert line.distance_m == pytest.approx(1.0197, abs=1e-4)
    assert line.allowed_m == pytest.approx(1.4817, abs=1e-4)
    assert line.remaining_m == pytest.approx(1.4817 - 1.0197 - 0.35, abs=1e-4)


@pytest.mark.parametrize(("speed_mps", "measured_m"), [(0.5, 0.54), (0.5, 0.4)])
def test_silence_covers_what_the_autopilots_were_measured_to_do(speed_mps: float, measured_m: float) -> None:
    """0.5 s of silence at 0.5 m/s: ArduCopter stood after 0.54 m, PX4 after 0.4 m, without the age of the pose."""
    line = line_of("gate killed", speed_mps=speed_mps)
    assert line.detection_s == pytest.approx(0.5 + SILENCE_EXTRA_S + BASIS.pose_fresh_s)
    assert line.distance_m - speed_mps * BASIS.pose_fresh_s >= measured_m


@pytest.mark.parametrize(
    ("speed_mps", "measured_m"),
    [
        pytest.param(0.38, 0.22, id="PX4, zero velocity"),
        pytest.param(0.42, 0.24, id="ArduCopter, zero velocity"),
        pytest.param(0.56, 0.35, id="ArduCopter, zero velocity, faster"),
    ],
)
def test_a_stop_covers_what_the_autopilots_were_measured_to_do(speed_mps: float, measured_m: float) -> None:
    """From the order on the wire until it stood, without what it creeps on afterwards, which is a term of its own."""
    line = line_of("pose_jump", speed_mps=speed_mps)
    assert speed_mps * line.autopilot_s + speed_mps**2 / (2.0 * line.brake_mps2) >= measured_m


@pytest.mark.parametrize(
    ("speed_mps", "measured_m"),
    [pytest.param(0.40, 0.48, id="PX4, land and hold, furthest"), pytest.param(0.56, 0.36, id="ArduCopter, land")],
)
@pytest.mark.parametrize("stage", [Stage.HOLD, Stage.LAND])
def test_a_mode_of_the_autopilots_covers_what_was_measured(stage: Stage, speed_mps: float, measured_m: float) -> None:
    """PX4 in its own hold and land stood after 0.27 m and went on to 0.48 m: further than under zero velocity."""
    line = line_of("pose_jump", answered(Fault.POSE_JUMP, stage), speed_mps)
    way_m = speed_mps * line.autopilot_s + speed_mps**2 / (2.0 * line.brake_mps2)
    assert way_m + line.creep_m >= measured_m
    assert 0.4 * line.autopilot_s + 0.4**2 / (2.0 * line.brake_mps2) >= 0.27
    weak = replace(answered(Fault.POSE_JUMP, stage), stopping=replace(PLAN.stopping, brake_mps2=0.2, creep_m=0.5))
    assert (line_of("pose_jump", weak).brake_mps2, line_of("pose_jump", weak).creep_m) == (0.2, 0.5)


def test_what_px4_creeps_on_until_its_place_is_kept_is_covered() -> None:
    """It creeps at 0.06 m/s, and a place is kept after 2 s at most; led back it ends where half of the way is that."""
    assert line_of("pose_jump").creep_m >= 0.06 * PATIENCE_S
    assert line_of("pose_jump").creep_m >= 0.06 / GAIN_PER_S


@pytest.mark.parametrize("extra_m", [0.0, 0.25])
def test_the_creep_counts_in_every_line(extra_m: float) -> None:
    """Protects from "left 0.04 m" of a vehicle that went on by a decimetre; the hard limit sees it coming."""
    creeping = replace(PLAN, stopping=replace(PLAN.stopping, creep_m=MODE_CREEP_M + extra_m))
    least = replace(PLAN, stopping=replace(PLAN.stopping, creep_m=MODE_CREEP_M))
    before = {line.fault: line for line in lines_at(0.3, least, BASIS)}
    for line in lines_at(0.3, creeping, BASIS):
        assert line.distance_m == pytest.approx(before[line.fault].distance_m + extra_m)
        earlier_m = extra_m if line.fault == "distance" else 0.0
        assert line.allowed_m == pytest.approx(before[line.fault].allowed_m + earlier_m)


@pytest.mark.parametrize(
    ("name", "drifts_s"),
    [
        ("aiding_lost", PLAN.thresholds.aiding_s + BASIS.estimator_period_s),
        ("gps_lost", PLAN.thresholds.gps_s),
        ("odometry_silent", PLAN.thresholds.odometry_s),
    ],
)
def test_a_place_that_nothing_measures_drifts_until_it_is_noticed(name: str, drifts_s: float) -> None:
    """The law still sees the wall, so only the drift is lost: the 0.17 m/s that ArduCopter drifted at."""
    line = line_of(name)
    assert line.detection_s == 0.0
    assert line.creep_m == pytest.approx(MODE_CREEP_M + 0.17 * drifts_s)
    assert line.keys == (f"safety.stale.{({'aiding_lost': 'aiding_s', 'gps_lost': 'gps_s'}).get(name, 'odometry_s')}",)


def test_a_vehicle_that_brakes_badly_does_so_in_a_failsafe() -> None:
    weak = replace(PLAN, stopping=replace(PLAN.stopping, brake_mps2=0.3))
    assert line_of("gate killed").brake_mps2 == MODE_BRAKE_MPS2
    assert line_of("gate killed", weak).brake_mps2 == 0.3


@pytest.mark.parametrize("stage", [Stage.HOLD, Stage.LAND])
def test_the_autopilots_own_braking_counts_where_it_brakes(stage: Stage) -> None:
    assert line_of("depth_stale").brake_mps2 == PLAN.stopping.brake_mps2
    assert line_of("depth_stale", answered(Fault.DEPTH_STALE, stage)).brake_mps2 == MODE_BRAKE_MPS2


def test_a_fault_of_the_application_finds_the_pose_as_old_as_it_may_be() -> None:
    for name in ("setpoint_late", "beat_late", "application", "setpoint_bad"):
        assert line_of(name).detection_s >= PLAN.thresholds.pose_s
        assert "safety.stale.pose_s" in line_of(name).keys


def test_where_the_law_still_flies_only_the_stop_counts() -> None:
    for fault in LAW_FLIES:
        assert line_of(fault.value).detection_s == 0.0


def test_the_hard_limit_stands_for_the_law() -> None:
    """The gate's own stop begins so far away that it ends at the hard limit, whatever the law wanted."""
    line = line_of("distance")
    later_m = MODE_CREEP_M - PLAN.stopping.creep_m  # in the autopilot's own hold, which follows
    assert line.allowed_m - line.distance_m == pytest.approx(PLAN.thresholds.hard_limit_m - later_m, abs=0.01)


def test_told_is_no_stop() -> None:
    told = line_of(
        "distance", replace(answered(Fault.DISTANCE, Stage.PASS), limits=replace(PLAN.limits, speed_mps=5.0))
    )
    assert not told.stops
    assert not told.reaches_wall


def test_the_law_of_the_paper_knows_nothing_before_d_c() -> None:
    law = Law(governed=False, critical_margin_m=0.9, reaction_s=0.4, creep_mps=0.05)
    assert law.allows_down_to_m(0.01, 0.8) == law.allows_down_to_m(5.0, 0.8) == 0.9


def test_the_governor_creeps_down_to_d_c() -> None:
    law = BASIS.law
    assert law.allows_down_to_m(law.creep_mps, 0.8) == law.critical_margin_m
    assert law.allows_down_to_m(law.creep_mps + 1e-6, 0.8) > law.critical_margin_m + 0.02


@settings(max_examples=50)
@given(
    governed=st.booleans(),
    reaction_s=st.floats(0.0, 3.0),
    governor_mps2=st.floats(0.1, 10.0),
    creep_mps=st.floats(0.01, 0.5),
    speed_mps=st.floats(0.1, 5.0),
    depth_s=st.floats(0.05, 5.0),
    silence_s=st.floats(0.2, 2.0),
)
def test_no_speed_is_worse_than_the_worst(
    *,
    governed: bool,
    reaction_s: float,
    governor_mps2: float,
    creep_mps: float,
    speed_mps: float,
    depth_s: float,
    silence_s: float,
) -> None:
    """The argument for the worst speed, against a grid of all of them.

    Only what is reachable matters: standing, d_c less the body is left, which the configuration keeps above zero.
    """
    law = Law(governed, 0.7, reaction_s, creep_mps)
    basis = replace(BASIS, law=law)
    plan = replace(
        PLAN,
        silence_s=silence_s,
        limits=replace(PLAN.limits, speed_mps=speed_mps),
        thresholds=replace(PLAN.thresholds, depth_s=depth_s),
        stopping=replace(PLAN.stopping, brake_mps2=governor_mps2),
    )
    standing_m = min(0.7, PLAN.thresholds.hard_limit_m) - basis.body_radius_m
    worst = {line.fault: line for line in stopping_budget(plan, basis)}
    for i in range(1, GRID + 1):
        for line in lines_at(speed_mps * i / GRID, plan, basis):
            least_m = worst[line.fault].remaining_m
            assert line.remaining_m >= min(least_m, standing_m) - 1e-9


@pytest.mark.parametrize("fault", ["gate killed", "computer dead", "link cut"])
def test_what_ends_the_gate_itself_is_held_against_the_wall_too(fault: str) -> None:
    """Only the autopilot's own failsafe stops the vehicle then: the longest way of all must count."""
    assert line_of(fault).stops


@pytest.mark.parametrize(
    ("stops", "remaining_m", "reaches"),
    [(True, -0.1, True), (True, 0.0, True), (True, 0.001, False), (False, -0.1, False)],
)
def test_a_wall_is_reached_by_who_stops_too_late(stops: bool, remaining_m: float, reaches: bool) -> None:
    """Nothing left is a wall; what is only told stops nothing, and is not held against the distance."""
    assert replace(line_of("depth_stale"), stops=stops, remaining_m=remaining_m).reaches_wall is reaches


def test_every_key_is_a_setting() -> None:
    """A name that does not exist sends whoever has to change it on a search."""
    for line in stopping_budget(PLAN, BASIS):
        for key in line.keys:
            found: object = SETTINGS
            for part in key.split("."):
                assert hasattr(found, part), key
                found = getattr(found, part)


def test_what_the_autopilot_tells_late_counts() -> None:
    """A word about the estimator, or the second of two equal poses, comes a period and its way later."""
    fresh_s = 2.0 * BASIS.pose_period_s
    assert line_of("pose_frozen").detection_s == pytest.approx(PLAN.thresholds.pose_frozen_s + fresh_s)
    assert line_of("estimator").detection_s == pytest.approx(BASIS.estimator_period_s + fresh_s)


@pytest.mark.parametrize(("governed", "creep_mps"), [(True, 0.05), (True, 9.0), (False, 0.05)])
def test_each_fault_is_shown_at_its_worst_speed(*, governed: bool, creep_mps: float) -> None:
    """Before a cautious governor the slowest goes nearest, down to d_c; at the hard limit no governor counts."""
    basis = replace(BASIS, law=Law(governed=governed, critical_margin_m=0.7, reaction_s=3.0, creep_mps=creep_mps))
    worst = {line.fault: line.speed_mps for line in stopping_budget(PLAN, basis)}
    assert worst["depth_stale"] == (min(creep_mps, SPEED_MPS) if governed else SPEED_MPS)
    assert worst["distance"] == SPEED_MPS


def test_an_autopilot_that_keeps_its_place_better_leaves_more() -> None:
    """Protects narrow places, whose whole room is what an autopilot wanders in its own hold; a brake stays a brake."""
    slim, gained_m = replace(BASIS, hold_creep_m=MODE_CREEP_M - 0.1), {}
    for before, after in zip(stopping_budget(PLAN, BASIS), stopping_budget(PLAN, slim), strict=True):
        gained_m[before.fault] = after.remaining_m - before.remaining_m if before.stops else 0.0
    assert gained_m.pop(Fault.MAP) == 0.0
    assert list(gained_m.values()) == [pytest.approx(0.1)] * len(gained_m)
