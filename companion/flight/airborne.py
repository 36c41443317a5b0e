"""The part of a flight in the air: take off, explore until there is a reason to end it, end it."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

from companion.autopilot.vehicle import Vehicle
from companion.control.completion import Completion
from companion.flight.control_loop import ControlLoop
from companion.flight.events import Event, EventEmitter
from companion.flight.gate_client import GateLostError, GateTookOverError
from companion.flight.operator_commands import InterruptedFlightError, OperatorCommands
from companion.flight.phase import PhaseEvent
from companion.flight.preflight.ready import LOOK_PERIOD_S
from companion.flight.session import Session
from companion.flight.tasks import background, first_of
from companion.flight.termination import Conditions, Termination, termination
from companion.mapping.process.client import MapClient
from companion.mavlink.modes import mode_name, personality
from companion.model import Pose

DONE_PERIOD_S = 2.0
"""It is asked this often whether anything is left: a search takes some milliseconds of the loop that steers."""

STALL_S = 0.5
"""A look that comes later than this tells that we stood still ourselves, and that others may be well."""


class Airborne:
    """One flight, from the order to take off until the vehicle is left holding or landing, or in its pilot's hands.

    Attributes:
        explored_s: how long it explored.
        done_at_s: when the mission was done, from the beginning of the exploring; None when it was not.
        end: where the exploring ended; None where no pose was known.
    """

    def __init__(
        self,
        session: Session,
        operator: OperatorCommands,
        vehicle: Vehicle,
        control_loop: ControlLoop,
        mapper: MapClient,
        events: EventEmitter,
    ) -> None:
        self.explored_s = 0.0
        self.done_at_s: float | None = None
        self.end: Pose | None = None
        self._session = session
        self._settings = session.settings
        self._completion = Completion(2.0 * self._settings.control.critical_margin_m)
        self._gate = session.gate
        self._operator = operator
        self._vehicle = vehicle
        self._control_loop = control_loop
        self._mapper = mapper
        self._events = events

    async def run(self) -> Termination:
        """Fly. Leaving the vehicle's context leaves it holding or landing, whatever happened.

        Raises:
            GateLostError: the safety gate ended before or after the exploring.
            GateTookOverError: it ended the take-off.
            InterruptedFlightError: a person stopped the take-off.
            CompanionError: the flight broke off.
        """
        vehicle, phases = self._vehicle, self._session.flight
        phases.update(PhaseEvent.STARTED)
        self._events.emit(Event.TAKING_OFF)
        try:
            async with background(self._control_loop.run()), vehicle:
                try:
                    why = await self._explore()
                finally:
                    phases.update(PhaseEvent.STOPPED)
                if not why.hands_off:
                    lands = self._settings.mission.end_action == "land"
                    await self._while_it_can(vehicle.land() if lands else vehicle.hold())
        finally:
            if self._is_left():
                phases.update(PhaseEvent.LEFT)
                self._gate.ended()
        return why

    async def _explore(self) -> Termination:
        vehicle, control_loop, ends = self._vehicle, self._control_loop, (self._operator.stop, self._gate.taken)
        climb = vehicle.take_off(self._settings.control.height_m, control_loop.measured_height_m)
        await self._while_it_can(climb, *ends)
        await self._while_it_can(vehicle.engage(), *ends)
        began_s = self._session.clock.now_s()
        control_loop.fresh_s = began_s
        self._session.flight.update(PhaseEvent.ENGAGED)
        self._events.emit(Event.EXPLORING)
        why = await self._until_the_end(began_s)
        self.explored_s = self._session.clock.now_s() - began_s
        self.end = self._control_loop.pose
        self._tell_end(why)
        return why

    def _tell_end(self, why: Termination) -> None:
        detail = (self._gate.took_over if why is Termination.GATE else self._vehicle.taken_over) or ""
        then = {"land": "landing", "hold": "holding"}[self._settings.mission.end_action]
        self._events.emit(
            Event.ENDED if why.as_it_should else Event.ENDED_EARLY,
            why=f"{why.value} {detail}".strip(),
            end=why.value,
            then="hands off" if why.hands_off else then,
        )

    async def _until_the_end(self, began_s: float) -> Termination:
        session = self._session
        battery_s: float | None = None
        awake_since_s = looked_s = began_s
        is_done, next_done_s = False, began_s
        while True:
            now_s = session.clock.now_s()
            if now_s - looked_s > LOOK_PERIOD_S + STALL_S:
                awake_since_s = now_s
            looked_s = now_s
            state = session.telemetry.state(now_s)
            if state.battery_percent is not None:
                battery_s = now_s
            if now_s >= next_done_s:
                next_done_s = now_s + DONE_PERIOD_S
                is_done = self._completion.update(now_s, self._control_loop.is_way_left(), self._mapper.status.word)
            conditions = Conditions(
                vehicle=state,
                taken_over=self._vehicle.taken_over is not None,
                by_failsafe=self._vehicle.by_failsafe,
                gate_took_over=self._gate.took_over is not None,
                gate_lost=self._gate.lost.is_set(),
                stop_asked=self._operator.stop.is_set(),
                complete=is_done,
                flown_s=now_s - began_s,
                blind_s=now_s - self._control_loop.fresh_s,
                awake_s=now_s - awake_since_s,
                map_silent_s=self._mapper.status.age_s,
                battery_silent_s=0.0 if battery_s is None else now_s - battery_s,
            )
            why = termination(conditions, self._settings)
            if why is not None:
                self.done_at_s = round(now_s - began_s, 1) if is_done else None
                return why
            await session.clock.sleep(LOOK_PERIOD_S)

    async def _while_it_can(self, manoeuvre: Coroutine[Any, Any, object], *stops: asyncio.Event) -> None:
        """Run a manoeuvre. The loss of the gate breaks it off, and so does what else is handed in."""
        task = asyncio.ensure_future(manoeuvre)
        done = await first_of(task, *(event.wait() for event in (self._gate.lost, *stops)))
        if self._gate.lost.is_set():
            raise GateLostError(f"{Termination.GATE_LOST.value}: the autopilot's own failsafe has to end this flight")
        if task in done:
            task.result()
        elif self._gate.taken.is_set():
            raise GateTookOverError(
                f"{Termination.GATE.value} during the take-off: {self._gate.took_over or 'briefly'}"
            )
        else:
            raise InterruptedFlightError("stopped during the take-off; the vehicle holds or lands")

    def _is_left(self) -> bool:
        """Whether nothing more is to be expected of us: it is down, somebody else's, or flies by itself."""
        ours = personality(self._session.link.kind)
        leaves = [mode_name(ours.kind, mode) for mode in (ours.hold, ours.land)]
        state = self._session.telemetry.state(self._session.clock.now_s())
        return not state.armed or self._vehicle.taken_over is not None or state.mode in leaves
