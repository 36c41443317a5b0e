"""The machine of phases, over all phases and events."""

from __future__ import annotations

import itertools

import pytest

from companion.flight.phase import FlightPhase, PhaseEvent, PhaseMachine

CHECKING, WAITING, TAKING_OFF, EXPLORING, LEAVING, ENDED = FlightPhase
READY, STARTED, ENGAGED, STOPPED, LEFT = PhaseEvent

CHANGES = {
    (CHECKING, READY): WAITING,
    (CHECKING, STARTED): TAKING_OFF,
    (WAITING, STARTED): TAKING_OFF,
    (TAKING_OFF, ENGAGED): EXPLORING,
    (TAKING_OFF, STOPPED): LEAVING,
    (TAKING_OFF, LEFT): ENDED,
    (EXPLORING, STOPPED): LEAVING,
    (EXPLORING, LEFT): ENDED,
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
    assert [phase for phase in FlightPhase if phase.airborne] == [TAKING_OFF, EXPLORING, LEAVING, ENDED]
