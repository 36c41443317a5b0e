"""The ladder by itself: stages, delays, what goes away and what does not."""

from __future__ import annotations

import pytest

from companion.gate.escalation import Escalation
from companion.gate.faults import Fault, Stage
from companion.gate.plan import Reaction

NOTHING: frozenset[Fault] = frozenset()
DEPTH, RANGES, MAP = (frozenset({fault}) for fault in (Fault.DEPTH_STALE, Fault.RANGES_STALE, Fault.MAP))
STOP = frozenset({Fault.GROUND_STOP})
REACTIONS = dict.fromkeys(Fault, Reaction(Stage.BRAKE, 5.0, 30.0)) | {
    Fault.MAP: Reaction(Stage.PASS, None, None),
    Fault.BATTERY: Reaction(Stage.LAND, None, None),
    Fault.GROUND_STOP: Reaction(Stage.BRAKE, 1.0, None),
    Fault.RANGES_STALE: Reaction(Stage.BRAKE, 5.0, None),
}


def escalation(recover_s: float = 1.0) -> Escalation:
    return Escalation(REACTIONS, recover_s)


def at(climbing: Escalation) -> Stage:
    return climbing.stage


def test_nothing_is_done_before_anything_is_wrong() -> None:
    """Protects the beginning: setpoints pass, because of nothing."""
    fresh = escalation()
    assert (fresh.stage, fresh.because, fresh.counting) == (Stage.PASS, None, NOTHING)
    assert fresh.update(NOTHING, 1.0) == NOTHING
    assert (fresh.stage, fresh.because) == (Stage.PASS, None)


def test_each_stage_comes_at_its_delay_and_not_before() -> None:
    """Protects the delays of the configuration: they count from the first appearance, to the cycle."""
    climbing = escalation()
    assert climbing.update(DEPTH, 10.0) == DEPTH
    stages = {}
    for now_s in (10.0, 14.75, 15.0, 39.75, 40.0):
        new = climbing.update(DEPTH, now_s)
        stages[now_s] = climbing.stage
        assert new == NOTHING, "it is told once"
    assert stages == {10.0: Stage.BRAKE, 14.75: Stage.BRAKE, 15.0: Stage.HOLD, 39.75: Stage.HOLD, 40.0: Stage.LAND}
    assert climbing.because is Fault.DEPTH_STALE


def test_where_no_delay_is_set_nothing_more_is_done() -> None:
    """Protects "no landing where nobody asked for one", for ever."""
    told = escalation()
    told.update(MAP, 0.0)
    told.update(MAP, 1e9)
    assert (told.stage, told.because, told.counting) == (Stage.PASS, None, MAP)
    held = escalation()
    held.update(STOP, 0.0)
    held.update(STOP, 1e9)
    assert at(held) is Stage.HOLD


def test_a_fault_is_over_when_it_has_been_gone_for_long_enough() -> None:
    """Protects both: a vehicle that flies on too soon, and one that never does."""
    braked = escalation()
    braked.update(DEPTH, 10.0)
    braked.update(NOTHING, 10.75)
    assert at(braked) is Stage.BRAKE
    braked.update(NOTHING, 11.0)
    assert (braked.stage, braked.because, braked.counting) == (Stage.PASS, None, NOTHING)
    assert braked.update(DEPTH, 11.25) == DEPTH, "new again"
    braked.update(DEPTH, 16.0)
    assert at(braked) is Stage.BRAKE, "and counted from its new beginning"


def test_a_fault_that_is_there_counts_even_when_nothing_has_to_be_waited_for() -> None:
    """Protects a configuration without a time to recover."""
    quick = escalation(recover_s=0.0)
    for now_s in (1.0, 7.0):
        quick.update(DEPTH, now_s)
        assert quick.counting == DEPTH
    assert at(quick) is Stage.HOLD
    quick.reset()
    quick.update(DEPTH, 8.0)
    quick.update(NOTHING, 8.0)
    assert at(quick) is Stage.PASS


@pytest.mark.parametrize("fault", [Fault.GROUND_STOP, Fault.APPLICATION])
def test_some_faults_are_never_over(fault: Fault) -> None:
    """Protects the order of a person, and the fact that a process is dead."""
    stopped = escalation()
    stopped.update(frozenset({fault}), 0.0)
    stopped.update(NOTHING, 0.5)
    stopped.update(NOTHING, 100.0)
    assert stopped.counting == {fault}
    assert at(stopped) >= Stage.HOLD


def test_the_first_of_those_that_ask_for_the_same_is_named() -> None:
    """Protects what the pilot reads: the cause, not its consequences; the same words on every computer."""
    braked = escalation()
    braked.update(frozenset({Fault.RANGES_STALE}), 1.0)
    braked.update(frozenset({Fault.RANGES_STALE, Fault.DEPTH_STALE}), 1.5)
    assert braked.because is Fault.RANGES_STALE
    both = escalation()
    both.update(frozenset({Fault.SETPOINT_LATE, Fault.RANGES_STALE, Fault.BEAT_LATE, Fault.LINK_LOST}), 1.0)
    assert both.because is Fault.BEAT_LATE
    both.update(frozenset({Fault.BATTERY}), 1.0)
    assert (both.stage, both.because) == (Stage.LAND, Fault.BATTERY), "who asks for more comes first"


def test_a_hold_keeps_its_cause_and_gives_way_to_a_landing_only() -> None:
    """Protects the way back: after a hold neither a recovery nor another fault makes it milder, or changes its name."""
    held = escalation()
    held.update(RANGES, 0.0)
    held.update(RANGES, 5.0)
    held.update(DEPTH, 6.0)
    held.update(DEPTH, 11.0)
    assert held.counting == DEPTH
    assert (held.stage, held.because) == (Stage.HOLD, Fault.RANGES_STALE)
    held.update(NOTHING, 12.0)
    assert (held.stage, held.because) == (Stage.HOLD, Fault.RANGES_STALE)
    held.update(frozenset({Fault.BATTERY}), 13.0)
    assert (held.stage, held.because) == (Stage.LAND, Fault.BATTERY)
    held.update(DEPTH, 20.0)
    held.update(DEPTH, 25.0)
    assert at(held) is Stage.LAND


def test_a_stage_that_cannot_be_had_leads_on_and_never_back() -> None:
    """Protects a vehicle that cannot hold, and one that lands already."""
    forced = escalation()
    forced.update(DEPTH, 0.0)
    forced.force(Stage.HOLD)
    assert at(forced) is Stage.HOLD
    forced.update(DEPTH, 0.5)
    assert at(forced) is Stage.HOLD
    forced.force(Stage.LAND)
    forced.force(Stage.HOLD)
    assert at(forced) is Stage.LAND


def test_a_new_flight_begins_with_nothing() -> None:
    """Protects the next flight from the faults of the last."""
    again = escalation()
    again.update(DEPTH | STOP, 0.0)
    again.update(DEPTH | STOP, 40.0)
    again.reset()
    assert (again.stage, again.because, again.counting) == (Stage.PASS, None, NOTHING)
    again.update(NOTHING, 50.0)
    assert at(again) is Stage.PASS
    assert again.update(DEPTH, 60.0) == DEPTH
    assert at(again) is Stage.BRAKE
