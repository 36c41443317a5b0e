"""Who is told of every tick: the map, the recording, the pilot and the operator."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from companion.autopilot.status_reporter import Announcer
from companion.autopilot.telemetry import Telemetry
from companion.control import Navigator
from companion.flight.control_loop import TickRecord
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.flight.preflight import CheckResult
from companion.flight.termination import Ending
from companion.mapping.process.client import MapWorker
from companion.mavlink.ids import MavSeverity, MavState
from companion.model import Mode
from companion.recording import Recorder, Tick
from companion.recording.content import ENDED, ENGAGED

Say = Callable[[str], None]
"""Shows a line to the operator."""

LINE_PERIOD_S = 5.0
"""The operator gets a line this often while exploring."""

MISSING_FOR_S = 0.5
"""Inputs that are missing for longer are told to the pilot: a frame that is late is no event."""

_IN_WORDS = {
    FlightPhase.WAITING: "waiting for the start",
    FlightPhase.TAKING_OFF: "taking off",
    FlightPhase.EXPLORING: "exploring",
}
_MEANING = {
    Mode.CIRCLE: "R1 initial circle",
    Mode.TANGENT: "R2 along tangent",
    Mode.BOUNDARY: "R3 along the wall",
    Mode.HOLD: "hold",
}


class MapFeed:
    """Gives every depth image and every planar scan to the map."""

    def __init__(self, mapper: MapWorker) -> None:
        self._mapper = mapper

    def __call__(self, tick: TickRecord) -> None:
        """Offer what the tick saw; when the map is slow it is dropped and counted there."""
        if tick.observation is None:
            return
        if tick.observation.frame is not None:
            self._mapper.offer(tick.observation.frame)
        if tick.observation.planar is not None:
            self._mapper.offer_scan(tick.observation.planar)


class Recording:
    """Gives every tick to the recorder."""

    def __init__(self, recorder: Recorder, navigator: Navigator) -> None:
        self._recorder = recorder
        self._navigator = navigator

    def __call__(self, tick: TickRecord) -> None:
        """Record it. A tick without a pose has nothing that could be flown again; the gap shows in the times."""
        if tick.observation is None or tick.measurement is None:
            return
        self._recorder.tick(
            Tick(
                observation=tick.observation,
                measurement=tick.measurement,
                setpoint=tick.setpoint,
                mode=tick.mode,
                sent=tick.sent,
                height_m=self._navigator.height_m,
                duration_s=tick.duration_s,
                stepped=tick.stepped,
            )
        )


class Announcements:
    """Tells pilot and operator what the vehicle does, and why it stops.

    Args:
        announcer: what ground stations see.
        telemetry: the autopilot's own words, which the operator and the recording get too.
        mapper: how complete the map is.
        recorder: events are recorded as well.
        say: shows a line to the operator.
        flight: knows the phase.
    """

    def __init__(
        self,
        announcer: Announcer,
        telemetry: Telemetry,
        mapper: MapWorker,
        recorder: Recorder,
        say: Say,
        flight: PhaseMachine,
    ) -> None:
        self._announcer = announcer
        self._telemetry = telemetry
        self._mapper = mapper
        self._recorder = recorder
        self._say = say
        self._flight = flight
        self._mode: Mode | None = None
        self._missing_since_s: float | None = None
        self._next_line_s = 0.0
        self._began_s: float | None = None
        self._texts_until_s = 0.0
        self._map_problem = ""

    def checks(self, results: Sequence[CheckResult]) -> None:
        """Put every check on record, above all those that were skipped."""
        for result in results:
            word = "skipped" if result.skipped else "passed"
            level = logging.WARNING if result.skipped else logging.INFO
            self._recorder.event("check", f"{result.name} {word}: {result.found}", level)

    def phase(self) -> None:
        """The flight has entered another phase."""
        phase = self._flight.phase
        what = _IN_WORDS[phase]
        self._say(what)
        self._announcer.say(f"companion: {what}", MavSeverity.NOTICE)
        self._announcer.state(MavState.ACTIVE if phase.airborne else MavState.STANDBY, armed=phase.airborne)
        self._recorder.event(ENGAGED if phase is FlightPhase.EXPLORING else "phase", what)

    def ended(self, why: Ending, detail: str) -> None:
        """The exploring is over."""
        severity = MavSeverity.NOTICE if why.as_it_should else MavSeverity.WARNING
        text = f"{why.value} {detail}".strip()
        self._say(f"exploring ended: {text}")
        self._announcer.say(f"companion: {text}", severity)
        self._announcer.state(MavState.ACTIVE if why.as_it_should else MavState.EMERGENCY, armed=True)
        self._recorder.event(ENDED, text)

    def __call__(self, tick: TickRecord) -> None:
        """Note what a pilot must know of this tick."""
        self._relay_texts()
        self._tell_map()
        measurement = tick.measurement
        self._announcer.value("d", None if measurement is None else measurement.d_m)
        self._announcer.value("h", None if measurement is None else measurement.h_m)
        self._announcer.value("complete", self._mapper.status.completeness)
        if self._flight.phase is not FlightPhase.EXPLORING:
            return
        self._tell_missing(tick)
        if tick.mode is not self._mode and not tick.missing:
            self._mode = tick.mode
            self._announcer.say(_MEANING[tick.mode])
        if self._began_s is None:
            self._began_s = tick.t_s
        if tick.t_s >= self._next_line_s:
            self._next_line_s = tick.t_s + LINE_PERIOD_S
            self._say(self._line(tick, tick.t_s - self._began_s))

    def _relay_texts(self) -> None:
        """What the autopilot says to its pilot concerns whoever reads our output as well."""
        texts = self._telemetry.texts
        for text in texts:
            if text.received_s > self._texts_until_s:
                self._say(f"autopilot: {text.text}")
                self._recorder.event("statustext", text.text)
        if texts:
            self._texts_until_s = max(self._texts_until_s, texts[-1].received_s)

    def _tell_map(self) -> None:
        """Nothing of the map ends a flight at once, so whoever could make room has to know of it."""
        problem = self._mapper.status.problem
        if problem == self._map_problem:
            return
        self._map_problem = problem
        text = f"map: {problem or 'in order again'}"
        self._say(text)
        self._announcer.say(text, MavSeverity.WARNING if problem else MavSeverity.NOTICE)
        self._recorder.event("map", text, logging.WARNING if problem else logging.INFO)

    def _tell_missing(self, tick: TickRecord) -> None:
        if not tick.missing:
            if self._missing_since_s is not None and tick.t_s - self._missing_since_s > MISSING_FOR_S:
                self._announcer.say("inputs are back", MavSeverity.NOTICE)
                self._announcer.state(MavState.ACTIVE, armed=True)
                self._recorder.event("inputs", "back")
            self._missing_since_s = None
            return
        if self._missing_since_s is None:
            self._missing_since_s = tick.t_s
        elif tick.t_s - self._missing_since_s > MISSING_FOR_S:
            text = f"stopped: no {', '.join(tick.missing)}"
            self._announcer.say(text, MavSeverity.WARNING)
            self._announcer.state(MavState.CRITICAL, armed=True)
            if self._mode is not Mode.HOLD:
                self._say(text)
                self._recorder.event("inputs", text, logging.WARNING)
            self._mode = Mode.HOLD

    def _line(self, tick: TickRecord, flown_s: float) -> str:
        measurement, status = tick.measurement, self._mapper.status
        d_m = None if measurement is None else measurement.d_m
        h_m = None if measurement is None else measurement.h_m
        what = f"stopped, no {', '.join(tick.missing)}" if tick.missing else _MEANING[tick.mode]
        return (
            f"{int(flown_s) // 60}:{int(flown_s) % 60:02d} min  {what}, d {_metres(d_m)}, h {_metres(h_m)}, "
            f"map {status.completeness:.0%} (estimate), frontiers {status.frontiers}"
        )


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} m"
