"""The part of a flight in the air: take off, explore until there is a reason to end it, come home, end it."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

from companion.autopilot.vehicle import Vehicle
from companion.flight.coming_home import ComingHome, Homecoming
from companion.flight.control_loop import ControlLoop
from companion.flight.events import Event, EventEmitter
from companion.flight.gate_client import GateLostError, GateTookOverError
from companion.flight.lookout import Lookout
from companion.flight.operator_commands import InterruptedFlightError, OperatorCommands, Wish
from companion.flight.phase import PhaseEvent
from companion.flight.preflight.ready import LOOK_PERIOD_S
from companion.flight.prospect import Prospect
from companion.flight.session import Session
from companion.flight.tasks import background, first_of
from companion.flight.termination import Conditions, Termination, is_spent, not_ours, termination
from companion.mapping.process.client import MapClient
from companion.mavlink.modes import mode_name, personality
from companion.model import Pose

GOES_BACK_S = 10.0
"""A landing waits for ground below for so long: the way back to it is `companion.control.trail.BACK_M` and what it flew
on while it braked, and the battery lasts for that."""

THEN = {"land": "landing", "hold": "holding"}


class Airborne:
    """One flight, from the order to take off until the vehicle is left holding or landing, or in its pilot's hands.

    Attributes:
        explored_s: how long it explored.
        prospect: of coming home; None before it explores.
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
        self.prospect: Prospect | None = None
        self.done_at_s: float | None = None
        self.end: Pose | None = None
        self._session = session
        self._settings = session.settings
        self._gate = session.gate
        self._operator = operator
        self._vehicle = vehicle
        self._control_loop = control_loop
        self._mapper = mapper
        self._events = events
        self._coming_home: ComingHome | None = None
        self._lookout: Lookout | None = None

    @property
    def homecoming(self) -> Homecoming | None:
        """How the way home was; None when it did not try."""
        return None if self._coming_home is None else self._coming_home.homecoming

    async def run(self) -> Termination:
        """Fly; why the exploring ended. Leaving the vehicle's context leaves it holding or landing, whatever happened.

        Raises:
            GateLostError: the safety gate ended before or after the exploring.
            GateTookOverError: it ended the take-off.
            InterruptedFlightError: a person stopped the take-off.
            CompanionError: the flight broke off.
        """
        vehicle, phases = self._vehicle, self._session.flight
        if self._operator.stop.is_set():
            raise InterruptedFlightError("stopped before the take-off; nothing was armed")
        phases.update(PhaseEvent.STARTED)
        self._events.emit(Event.TAKING_OVER if self._operator.in_air else Event.TAKING_OFF)
        try:
            async with background(self._control_loop.run()), vehicle:
                try:
                    why, last = await self._explore()
                    if not last.hands_off:
                        last = await self._back_over_ground() or last
                finally:
                    phases.update(PhaseEvent.STOPPED)
                if not last.hands_off:
                    await self._while_it_can(vehicle.hold() if self._action(why) == "hold" else vehicle.land())
                    if self._coming_home is not None:
                        self._coming_home.landed()
        finally:
            if self._is_left():
                phases.update(PhaseEvent.LEFT)
                self._gate.ended()
        return why

    async def _explore(self) -> tuple[Termination, Termination]:
        """Take off, explore, and come home where that is what follows: why each of the two last ended."""
        vehicle, control_loop, ends = self._vehicle, self._control_loop, (self._operator.stop, self._gate.taken)
        begin = vehicle.take_over if self._operator.in_air else vehicle.take_off
        climb = begin(self._settings.control.height_m, control_loop.measured_height_m)
        await self._while_it_can(climb, *ends)
        await self._while_it_can(vehicle.engage(), *ends)
        began_s = self._session.clock.now_s()
        control_loop.fresh_s = began_s
        self._session.flight.update(PhaseEvent.ENGAGED)
        self._events.emit(Event.EXPLORING)
        lookout = self._lookout = Lookout(self._session, self._operator, vehicle, control_loop, self._mapper)
        self.prospect = lookout.prospect
        why, now = await self._until_the_end(lookout)
        self.explored_s = self._session.clock.now_s() - began_s
        self.done_at_s = round(self.explored_s, 1) if now.complete else None
        self.end = control_loop.pose
        if self._action(why) != "home" or is_spent(now, self._settings) or control_loop.off_home_m() is None:
            self._tell_end(why)
            return why, why
        self._coming_home = ComingHome(self._session, self._operator, control_loop, lookout, self._events)
        return why, await self._coming_home.run(why)

    def _action(self, why: Termination) -> str:
        """What follows the exploring: home, hold or land. What a person asked for goes before the settings."""
        wish, action = self._operator.wish, self._settings.mission.end_action
        if wish is Wish.LAND and why is Termination.STOPPED:
            return "land"
        if wish is Wish.HOME and why is Termination.STOPPED:
            return "home"
        return "land" if action == "home" and not why.leaves_a_way_home else action

    def _tell_end(self, why: Termination) -> None:
        detail = (self._gate.took_over if why is Termination.GATE else self._vehicle.taken_over) or ""
        self._events.emit(
            Event.ENDED if why.as_it_should else Event.ENDED_EARLY,
            why=f"{why.value} {detail}".strip(),
            end=why.in_brief,
            then="hands off" if why.hands_off else THEN.get(self._action(why), "landing"),
        )

    async def _until_the_end(self, lookout: Lookout) -> tuple[Termination, Conditions]:
        while True:
            now = lookout.look()
            why = termination(now, self._settings)
            if why is not None:
                return why, now
            await self._session.clock.sleep(LOOK_PERIOD_S)

    async def _back_over_ground(self) -> Termination | None:
        """Whatever ended the flight: over a shaft it is not landed, as long as it is on its way back from there.

        Returns:
            Who else has the vehicle, or why nobody can reach it; None: it is ours to land.
        """
        clock, lookout = self._session.clock, self._lookout
        give_up_s = clock.now_s() + GOES_BACK_S
        while lookout is not None and self._control_loop.goes_back and clock.now_s() < give_up_s:
            if (taken := not_ours(lookout.look(), self._settings)) is not None:
                return taken
            await clock.sleep(LOOK_PERIOD_S)
        return None

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
