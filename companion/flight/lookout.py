"""Looks, a few times a second, at everything on which it depends whether a flight goes on."""

from __future__ import annotations

from companion.autopilot.vehicle import Vehicle
from companion.control.completion import Completion
from companion.flight.control_loop import ControlLoop
from companion.flight.operator_commands import OperatorCommands, Wish
from companion.flight.phase import FlightPhase
from companion.flight.preflight.ready import LOOK_PERIOD_S
from companion.flight.prospect import Prospect
from companion.flight.session import Session
from companion.flight.termination import Conditions
from companion.mapping.process.client import MapClient

DONE_PERIOD_S = 2.0
"""It is asked this often whether anything is left: a search takes some milliseconds of the loop that steers."""

STALL_S = 0.5
"""A look that comes later than this tells that we stood still ourselves, and that others may be well."""


class Lookout:
    """From the beginning of the exploring to the end of the flight.

    Attributes:
        prospect: how far home is, and what will be left there.
    """

    def __init__(
        self,
        session: Session,
        operator: OperatorCommands,
        vehicle: Vehicle,
        control_loop: ControlLoop,
        mapper: MapClient,
    ) -> None:
        self.prospect = Prospect(session.settings)
        self._session = session
        self._completion = Completion(2.0 * session.settings.control.critical_margin_m)
        self._operator = operator
        self._vehicle = vehicle
        self._control_loop = control_loop
        self._mapper = mapper
        now_s = session.clock.now_s()
        self._began_s = self._awake_since_s = self._looked_s = self._next_done_s = now_s
        self._paused_s = 0.0
        self._battery_s: float | None = None
        self._is_done = False

    def begin(self) -> None:
        """From now on the time of the flight counts anew: for the way home."""
        self._began_s = self._session.clock.now_s()

    def look(self) -> Conditions:
        """Conditions now."""
        session = self._session
        now_s = session.clock.now_s()
        if now_s - self._looked_s > LOOK_PERIOD_S + STALL_S:
            self._awake_since_s = now_s
        if session.flight.paused:
            self._paused_s += now_s - self._looked_s
        self._looked_s = now_s
        # First: a mode that is not ours is the gate's doing where it has said so.
        session.gate.look()
        state = session.telemetry.state(now_s)
        if state.battery_percent is not None:
            self._battery_s = now_s
        self._look_for_more(now_s)
        if self.prospect.is_due(now_s):
            self.prospect.look(now_s, state, self._control_loop.way_home())
            if self.prospect.should_turn_back and session.flight.phase is FlightPhase.EXPLORING:
                # Nobody turns back for a way that has become shorter meanwhile.
                self.prospect.look(now_s, state, self._control_loop.way_home(anew=True))
        return Conditions(
            vehicle=state,
            taken_over=self._vehicle.taken_over is not None,
            by_failsafe=self._vehicle.by_failsafe,
            gate_took_over=session.gate.took_over is not None,
            gate_lost=session.gate.lost.is_set(),
            stop_asked=self._operator.wish is not Wish.NOTHING,
            landing_asked=self._operator.wish is Wish.LAND,
            complete=self._is_done,
            flown_s=now_s - self._began_s,
            blind_s=now_s - self._control_loop.fresh_s,
            awake_s=now_s - self._awake_since_s,
            map_silent_s=self._mapper.status.age_s,
            battery_silent_s=0.0 if self._battery_s is None else now_s - self._battery_s,
            charge_percent=self.prospect.charge_percent,
            reserve_due=self.prospect.should_turn_back,
            is_home=self._control_loop.is_home,
            way_closed=self._control_loop.way_is_closed,
        )

    def _look_for_more(self, now_s: float) -> None:
        """Whether the mission is done, as long as it explores; a pause does not count."""
        if now_s < self._next_done_s or self._session.flight.phase is not FlightPhase.EXPLORING:
            return
        self._next_done_s = now_s + DONE_PERIOD_S
        if not self._session.flight.paused:
            left, word = self._control_loop.is_way_left(), self._mapper.status.word
            self._is_done = self._completion.update(now_s - self._paused_s, left, word)
