"""Why a flight ends, and the machine of its phases."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import pytest

from companion.autopilot.vehicle_state import VehicleState
from companion.config.settings import Settings
from companion.flight.phase import FlightPhase, PhaseEvent, PhaseMachine
from companion.flight.termination import Conditions, Termination, homing_end, is_spent, termination
from companion.mavlink.ids import MavChargeState

SETTINGS = Settings()


def conditions(vehicle: dict[str, Any] | None = None, **changes: Any) -> Conditions:
    """A flight on which all is well, with changes."""
    state = VehicleState(
        armed=True,
        mode="offboard",
        landed=False,
        battery_percent=80.0,
        heartbeat_age_s=0.5,
        pose_age_s=0.03,
        position_valid=True,
        version="1.17.0",
    )
    state = replace(state, **(vehicle or {}))
    well = Conditions(
        state,
        taken_over=False,
        by_failsafe=False,
        gate_took_over=False,
        gate_lost=False,
        stop_asked=False,
        landing_asked=False,
        complete=False,
        flown_s=10.0,
        blind_s=0.0,
        awake_s=600.0,
        battery_silent_s=0.0,
        map_silent_s=0.5,
        charge_percent=80.0,
        reserve_due=False,
        is_home=False,
        way_closed=False,
    )
    return replace(well, **changes)


def test_a_flight_on_which_all_is_well_goes_on() -> None:
    assert termination(conditions(), SETTINGS) is None


@pytest.mark.parametrize(
    ("now", "why"),
    [
        (conditions({"heartbeat_age_s": 3.1}), Termination.LINK),
        (conditions({"armed": False}), Termination.DISARMED),
        (conditions(gate_lost=True), Termination.GATE_LOST),
        (conditions(taken_over=True, gate_took_over=True), Termination.GATE),
        (conditions(taken_over=True), Termination.PILOT),
        (conditions(taken_over=True, by_failsafe=True), Termination.FAILSAFE),
        (conditions({"battery_percent": 24.0}), Termination.BATTERY),
        (conditions({"battery_percent": None}, battery_silent_s=30.5), Termination.BATTERY),
        (conditions({"charge_state": MavChargeState.LOW}), Termination.BATTERY),
        (conditions({"charge_state": MavChargeState.CRITICAL}), Termination.BATTERY),
        (conditions({"charge_state": MavChargeState.EMERGENCY}), Termination.BATTERY),
        (conditions({"charge_state": MavChargeState.FAILED}), Termination.BATTERY),
        (conditions({"charge_state": MavChargeState.UNHEALTHY}), Termination.BATTERY),
        (conditions({"low_voltage_s": 5.1}), Termination.BATTERY),
        (conditions({"low_voltage_s": 0.5, "critical": True}), Termination.BATTERY),
        (conditions(blind_s=10.5), Termination.INPUTS),
        (conditions(map_silent_s=61.0), Termination.MAP),
        (conditions(stop_asked=True), Termination.STOPPED),
        (conditions(complete=True), Termination.COMPLETE),
        (conditions(flown_s=1200.5), Termination.TIME),
    ],
)
def test_each_reason_ends_it(now: Conditions, why: Termination) -> None:
    assert termination(now, SETTINGS) is why


def test_a_battery_that_says_nothing_is_not_an_empty_one() -> None:
    """Whoever skipped the check of the battery has none that says anything; one that falls silent may be empty."""
    assert termination(conditions({"battery_percent": None}), SETTINGS) is None
    assert termination(conditions({"battery_percent": None}, battery_silent_s=10.0), SETTINGS) is None


@pytest.mark.parametrize(
    "vehicle",
    [
        {"charge_state": MavChargeState.OK},
        {"charge_state": MavChargeState.CHARGING},
        {"low_voltage_s": 4.9},
        {"critical": True},
    ],
)
def test_a_sag_and_a_good_charge_end_no_flight(vehicle: dict[str, Any]) -> None:
    """A take-off pulls the voltage down for a moment; PX4's heartbeat says critical in any failsafe."""
    assert termination(conditions(vehicle), SETTINGS) is None


def test_a_count_that_began_at_100_percent_does_not_hide_an_empty_battery() -> None:
    """ArduPilot counts from 100 % at each boot: it said 100 % at 10.2 V, and that the battery is low."""
    found = conditions({"battery_percent": 100.0, "charge_state": MavChargeState.LOW})
    assert termination(found, SETTINGS) is Termination.BATTERY


def test_what_takes_the_vehicle_away_comes_before_what_was_reached() -> None:
    """A pilot who takes over at the moment of completion must not see the vehicle land under his hands."""
    assert termination(conditions(taken_over=True, complete=True, stop_asked=True), SETTINGS) is Termination.PILOT
    assert termination(conditions({"heartbeat_age_s": 9.0, "armed": False}), SETTINGS) is Termination.DISARMED


def test_who_has_the_vehicle_keeps_it_whatever_else_is_wrong() -> None:
    """After a stall of ours the link looks lost: the landing that follows was once ordered over a pilot's hold."""
    lost = {"heartbeat_age_s": 9.0}
    assert termination(conditions(lost, taken_over=True), SETTINGS) is Termination.PILOT
    assert termination(conditions(lost, taken_over=True, by_failsafe=True), SETTINGS) is Termination.FAILSAFE


def test_what_we_slept_through_is_no_silence_of_the_autopilot() -> None:
    """A host that stood still for seconds has heard nothing: the autopilot gets its time from then on."""
    assert termination(conditions({"heartbeat_age_s": 9.0}, awake_s=0.2), SETTINGS) is None
    assert termination(conditions({"heartbeat_age_s": 9.0}, awake_s=3.1), SETTINGS) is Termination.LINK


def test_what_the_gate_did_is_not_blamed_on_a_pilot() -> None:
    """The mode that it takes shows up to a second after its word; who landed by it is disarmed as well."""
    assert termination(conditions(gate_took_over=True), SETTINGS) is None, "not before the mode shows"
    landed = conditions({"armed": False}, taken_over=True, gate_took_over=True)
    assert termination(landed, SETTINGS) is Termination.GATE


def test_without_the_gate_nothing_else_that_is_said_of_the_vehicle_counts() -> None:
    """All of it came through the gate."""
    assert (
        termination(conditions({"heartbeat_age_s": 9.0}, gate_lost=True, taken_over=True), SETTINGS)
        is Termination.GATE_LOST
    )


def test_hands_are_off_when_the_vehicle_is_not_ours_or_cannot_be_reached() -> None:
    """Everywhere else the vehicle would be left flying by nobody."""
    assert {why for why in Termination if why.hands_off} == {
        Termination.GATE_LOST,
        Termination.GATE,
        Termination.FAILSAFE,
        Termination.PILOT,
        Termination.DISARMED,
    }


def test_only_completion_a_stop_and_home_are_ends_as_they_should_be() -> None:
    as_it_should = {Termination.COMPLETE, Termination.STOPPED, Termination.HOME}
    assert {why for why in Termination if why.as_it_should} == as_it_should


@pytest.mark.parametrize("end_action", ["home", "hold", "land"])
def test_the_reserve_ends_the_exploring_of_those_that_come_home(end_action: str) -> None:
    """Protects files of before: who lands where it is has no way home for which anything were to be left."""
    settings = Settings.model_validate({"mission": {"end_action": end_action}})
    expected = Termination.RESERVE if end_action == "home" else None
    assert termination(conditions(reserve_due=True), settings) is expected


LIMIT_S = 300.0


@pytest.mark.parametrize(
    ("now", "why"),
    [
        (conditions(), None),
        # What has ended the exploring says nothing any more: it comes home because of it.
        (conditions(complete=True, reserve_due=True, stop_asked=True, map_silent_s=900.0), None),
        (conditions({"battery_percent": 20.0}, charge_percent=20.0), None),
        (conditions({"charge_state": MavChargeState.LOW}), None),
        (conditions(battery_silent_s=900.0), None),
        (conditions(is_home=True), Termination.HOME),
        (conditions(is_home=True, way_closed=True), Termination.CLOSED),
        (conditions(way_closed=True), None),
        (conditions(landing_asked=True), Termination.STOPPED),
        (conditions(flown_s=LIMIT_S + 1.0), Termination.TIME),
        (conditions(blind_s=10.1), Termination.INPUTS),
        (conditions(charge_percent=15.9), Termination.BATTERY),
        (conditions({"charge_state": MavChargeState.CRITICAL}), Termination.BATTERY),
        (conditions({"charge_state": MavChargeState.LOW, "critical": True}), Termination.BATTERY),
        (conditions({"heartbeat_age_s": 3.1}), Termination.LINK),
        (conditions(taken_over=True), Termination.PILOT),
        (conditions(taken_over=True, by_failsafe=True), Termination.FAILSAFE),
        (conditions(taken_over=True, gate_took_over=True, is_home=True), Termination.GATE),
        (conditions(gate_lost=True), Termination.GATE_LOST),
        (conditions({"armed": False}), Termination.DISARMED),
    ],
)
def test_how_a_way_home_ends(now: Conditions, why: Termination | None) -> None:
    assert homing_end(now, SETTINGS, LIMIT_S) is why


@pytest.mark.parametrize(("gate_percent", "spent"), [(15.0, 16.0), (20.0, 21.0), (0.0, 5.0), (3.0, 5.0)])
def test_it_lands_by_itself_before_the_gate_has_it_land(gate_percent: float, spent: float) -> None:
    """Protects the last metres: the gate lands at once, this one comes to stand before, and says so."""
    settings = Settings.model_validate({"safety": {"battery_percent": gate_percent}})
    assert settings.spent_percent == spent
    assert is_spent(conditions(charge_percent=spent - 0.1), settings)
    assert not is_spent(conditions(charge_percent=spent), settings)
    assert not is_spent(conditions(charge_percent=None), settings)


def test_who_lost_the_way_or_the_vehicle_does_not_come_home() -> None:
    """Protects from flying on blind, and from taking back what is another's."""
    assert {why for why in Termination if not why.leaves_a_way_home} == {
        *(why for why in Termination if why.hands_off),
        Termination.LINK,
        Termination.INPUTS,
        Termination.HOME,
        Termination.CLOSED,
    }


# The machine of phases, over all phases and events.


CHECKING, WAITING, TAKING_OFF, EXPLORING, HOMING, LEAVING, ENDED = FlightPhase
READY, STARTED, ENGAGED, TURNED_BACK, STOPPED, LEFT = PhaseEvent

CHANGES = {
    (CHECKING, READY): WAITING,
    (CHECKING, STARTED): TAKING_OFF,
    (WAITING, STARTED): TAKING_OFF,
    (TAKING_OFF, ENGAGED): EXPLORING,
    (TAKING_OFF, STOPPED): LEAVING,
    (TAKING_OFF, LEFT): ENDED,
    (EXPLORING, TURNED_BACK): HOMING,
    (EXPLORING, STOPPED): LEAVING,
    (EXPLORING, LEFT): ENDED,
    (HOMING, STOPPED): LEAVING,
    (HOMING, LEFT): ENDED,
    (LEAVING, LEFT): ENDED,
}


@pytest.mark.parametrize(("phase", "event"), list(itertools.product(FlightPhase, PhaseEvent)))
def test_every_event_in_every_phase(phase: FlightPhase, event: PhaseEvent) -> None:
    """Protects above all the end: no event leads back from it to a phase in which setpoints are sent."""
    machine = PhaseMachine()
    machine.phase = phase
    after = machine.update(event)
    assert after is machine.phase is CHANGES.get((phase, event), phase)
    assert after >= phase, "no phase is entered twice"


def test_a_flight_begins_on_the_ground() -> None:
    assert PhaseMachine().phase is CHECKING


def test_from_the_order_to_take_off_on_the_vehicle_may_be_armed() -> None:
    assert [phase for phase in FlightPhase if phase.airborne] == [TAKING_OFF, EXPLORING, HOMING, LEAVING, ENDED]


@pytest.mark.parametrize("phase", FlightPhase)
def test_only_what_is_steered_can_be_paused(phase: FlightPhase) -> None:
    machine = PhaseMachine()
    machine.phase = phase
    assert machine.pause(True) is machine.paused is (phase in (EXPLORING, HOMING))


@pytest.mark.parametrize("event", [TURNED_BACK, STOPPED, LEFT])
def test_what_turns_a_flight_back_or_ends_it_ends_its_pause(event: PhaseEvent) -> None:
    """Protects the battery: a pause that nobody ends must not hold it until nothing is left."""
    machine = PhaseMachine()
    machine.phase = EXPLORING
    machine.pause(True)
    machine.update(READY)
    assert machine.paused, "what means nothing changes nothing"
    machine.update(event)
    assert not machine.paused
