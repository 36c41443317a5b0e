"""The way home: what is watched on it, how it ends, and what was promised for it and came."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from companion.flight.control_loop import ControlLoop
from companion.flight.events import Event, EventEmitter
from companion.flight.lookout import Lookout
from companion.flight.operator_commands import OperatorCommands
from companion.flight.phase import PhaseEvent
from companion.flight.preflight.ready import LOOK_PERIOD_S
from companion.flight.session import Session
from companion.flight.termination import Termination, homing_end
from companion.model import Measurement

TELL_PERIOD_S = 30.0
"""The pilot is told this often how far home is and what will be left there."""

SHORT_FOR_S = 10.0
"""A battery that will not last until home is told after this long: its percents come whole, and jump."""

LEVEL_SLOPE = 0.15
"""Steeper ground is told before it lands there; what legs stand on without sliding is the airframe's."""


@dataclass(slots=True)
class Homecoming:
    """How the way home was. What is not known is None.

    Attributes:
        ended: why it ended; None when the flight broke off on it.
        way_m: its length where it turned back.
        homing_s: how long it took.
        off_home_m: how far from home it landed, by its own account; the landing itself is in it.
        unsure_m: how far that may be wrong, by the drift of the position since walls last told a place.
        charge_turning_percent: of the battery where it turned back.
        charge_promised_percent: what should be left after the landing at home, by the first word on it.
        charge_came_percent: what was.
    """

    way_m: float | None
    charge_turning_percent: float | None
    charge_promised_percent: float | None
    ended: Termination | None = None
    homing_s: float | None = None
    off_home_m: float | None = None
    unsure_m: float | None = None
    charge_came_percent: float | None = None

    @property
    def as_it_should(self) -> bool:
        """Whether it came home, or a person had it land before."""
        return self.ended is not None and self.ended.as_it_should

    def as_json(self) -> dict[str, Any]:
        """As it stands in ``summary.json``."""
        return {
            "arrived": self.ended is Termination.HOME,
            "ended_because": None if self.ended is None else self.ended.value,
            "way_home_m": _rounded(self.way_m),
            "homing_s": _rounded(self.homing_s),
            "off_home_m": None if self.off_home_m is None else round(self.off_home_m, 2),
            "off_home_unsure_m": None if self.unsure_m is None else round(self.unsure_m, 2),
            "charge_turning_percent": _rounded(self.charge_turning_percent),
            "charge_promised_percent": _rounded(self.charge_promised_percent),
            "charge_came_percent": _rounded(self.charge_came_percent),
        }


class ComingHome:
    """From where the vehicle turns back until it lands.

    Args:
        session: what is listened to.
        operator: what people ask for.
        control_loop: steers.
        lookout: looks at everything.
        events: where it is told.
    """

    def __init__(
        self,
        session: Session,
        operator: OperatorCommands,
        control_loop: ControlLoop,
        lookout: Lookout,
        events: EventEmitter,
    ) -> None:
        prospect = lookout.prospect
        self.homecoming = Homecoming(
            None if prospect.way is None else prospect.way.length_m, prospect.charge_percent, prospect.left_percent
        )
        self._session = session
        self._settings = session.settings
        self._operator = operator
        self._control_loop = control_loop
        self._lookout = lookout
        self._prospect = prospect
        self._events = events
        self._short_since_s: float | None = None
        self._told_short = self._told_closed = False

    async def run(self, because: Termination) -> Termination:
        """Fly home; why that ended.

        Args:
            because: why the exploring ended.
        """
        clock, outlook = self._session.clock, self._prospect.in_words()
        began_s = clock.now_s()
        limit_s = self._prospect.longest_way_s(began_s)
        self._session.flight.update(PhaseEvent.TURNED_BACK)
        instead = "Ctrl-C once more" if self._operator.interrupted else "Ctrl-C twice"
        self._events.emit(Event.HOMING, why=because.value, brief=because.in_brief, outlook=outlook, instead=instead)
        self._lookout.begin()
        wish, next_tell_s = self._operator.wish, began_s + TELL_PERIOD_S
        while True:
            now = self._lookout.look()
            why = homing_end(now, self._settings, limit_s)
            if why is not None:
                break
            if self._operator.wish is not wish:
                wish = self._operator.wish
                self._events.emit(Event.HOMING_ALREADY)
            now_s = clock.now_s()
            if now_s >= next_tell_s:
                next_tell_s = now_s + TELL_PERIOD_S
                self._events.emit(Event.HOMING_PROGRESS, outlook=self._prospect.in_words())
            if self.homecoming.charge_promised_percent is None:
                self.homecoming.charge_promised_percent = self._prospect.left_percent
            self._watch_reach(now_s)
            if self._control_loop.way_is_closed and not self._told_closed:
                self._told_closed = True
                self._events.emit(Event.WAY_CLOSED)
            await clock.sleep(LOOK_PERIOD_S)
        came = self.homecoming
        came.ended, came.homing_s = why, clock.now_s() - began_s
        self._measure()
        self._tell(because, why)
        return why

    def landed(self) -> None:
        """The landing is over, as far as it was waited for."""
        self._measure()
        off_m, unsure_m = self.homecoming.off_home_m, self.homecoming.unsure_m
        off = "somewhere" if off_m is None else f"{off_m:.1f} m"
        self._events.emit(Event.LANDED, off=off, unsure="" if unsure_m is None else f", give or take {unsure_m:.1f} m")

    def _measure(self) -> None:
        now_s = self._session.clock.now_s()
        self._prospect.look(now_s, self._session.telemetry.state(now_s), self._prospect.way)
        self.homecoming.charge_came_percent = self._prospect.charge_percent
        self.homecoming.off_home_m = self._control_loop.off_home_m()
        self.homecoming.unsure_m = None if self.homecoming.off_home_m is None else self._control_loop.unsure_m

    def _watch_reach(self, now_s: float) -> None:
        """Tell once, when the battery turns out not to last: to be nearer to home is worth the way all the same."""
        left_percent, spent = self._prospect.left_percent, self._settings.spent_percent
        if left_percent is None or left_percent >= spent:
            self._short_since_s = None
        elif self._short_since_s is None:
            self._short_since_s = now_s
        elif now_s - self._short_since_s >= SHORT_FOR_S and not self._told_short:
            self._told_short = True
            self._events.emit(Event.OUT_OF_REACH, spent=f"{spent:.0f}")

    def _tell(self, because: Termination, why: Termination) -> None:
        then = "hands off" if why.hands_off else "landing"
        event = Event.HOMING_ENDED if why.as_it_should else Event.HOMING_ENDED_EARLY
        recorded = f"{because.value}; the way home: {why.value}"
        self._events.emit(event, why=why.value, brief=why.in_brief, then=then, recorded=recorded)
        if why is Termination.HOME and self._control_loop.lands_elsewhere:
            self._events.emit(Event.LANDS_BESIDE_HOME)
        unfit = self._unfit(self._control_loop.measurement)
        if why in (Termination.HOME, Termination.CLOSED) and unfit:
            self._events.emit(Event.UNFIT_TO_LAND, what=" and ".join(unfit))

    def _unfit(self, measurement: Measurement | None) -> list[str]:
        """What speaks against landing here, by what is seen of the place."""
        if measurement is None:
            return []
        d_m, slope = measurement.d_m, measurement.ground_slope
        critical_m = self._settings.control.critical_margin_m
        out = []
        if slope is not None and abs(slope) > LEVEL_SLOPE:
            out.append(f"a slope of {abs(slope):.0%}")
        if d_m is not None and d_m < critical_m:
            out.append(f"{d_m:.1f} m beside a wall")
        return out


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 1)
