"""Watchers of the tick: the map is fed by it, pilot and operator are told of what it shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from companion.autopilot.status_reporter import StatusReporter
from companion.autopilot.telemetry import Telemetry
from companion.flight.control_loop import Watcher
from companion.flight.events import Event, EventEmitter
from companion.flight.phase import PhaseMachine
from companion.mapping.process.client import MapClient
from companion.model import Mode
from companion.pipeline import Tick

LINE_PERIOD_S = 5.0
"""The operator gets a line this often while exploring and coming home."""

MISSING_FOR_S = 0.5
"""Inputs that are missing for longer are an event; a frame that is late is none."""

MEANING = {
    Mode.CIRCLE: "R1 initial circle",
    Mode.TANGENT: "R2 along tangent",
    Mode.BOUNDARY: "R3 along the wall",
    Mode.HOLD: "hold",
}
"""Modes of the navigator in words."""


def map_feed(mapper: MapClient) -> Watcher:
    """Gives every depth image and every planar scan to the map; when it is slow they are dropped and counted there."""

    def feed(tick: Tick) -> None:
        if tick.observation is not None and tick.observation.frame is not None:
            mapper.offer(tick.observation.frame)
        if tick.observation is not None and tick.observation.planar is not None:
            mapper.offer_scan(tick.observation.planar)

    return feed


class TickReporter:
    """Looks at every tick for what pilot and operator have to know of.

    Args:
        events: where it is told.
        status_reporter: numbers for ground stations to plot.
        telemetry: the autopilot's own words, which the operator and the recording get too.
        mapper: how complete the map is.
        flight: knows the phase.
        warnings: what the sensors' drivers have to tell since the last call.
    """

    def __init__(
        self,
        events: EventEmitter,
        status_reporter: StatusReporter,
        telemetry: Telemetry,
        mapper: MapClient,
        flight: PhaseMachine,
        warnings: Callable[[], Sequence[str]],
    ) -> None:
        self._emit = events.emit
        self._warnings = warnings
        self._status_reporter = status_reporter
        self._telemetry = telemetry
        self._mapper = mapper
        self._flight = flight
        self._mode: Mode | None = None
        self._paused = False
        self._missing_since_s: float | None = None
        self._lost: set[str] = set()
        """The missing inputs that were told."""
        self._next_line_s = 0.0
        self._began_s: float | None = None
        self._texts_until_s = 0.0
        self._map_problem = ""

    def __call__(self, tick: Tick) -> None:
        """Note what somebody must know of this tick."""
        self._relay_texts()
        self._watch_map()
        for text in self._warnings():
            self._emit(Event.SENSOR_WARNING, text=text)
        measurement = tick.measurement
        self._status_reporter.value("d", None if measurement is None else measurement.d_m)
        self._status_reporter.value("h", None if measurement is None else measurement.h_m)
        self._status_reporter.value("complete", self._mapper.status.completeness)
        if not self._flight.phase.steered:
            return
        self._watch_pause()
        self._watch_inputs(tick)
        if tick.mode is not self._mode and not tick.missing:
            self._mode = tick.mode
            self._emit(Event.NAVIGATOR_MODE, mode=MEANING[tick.mode])
        if self._began_s is None:
            self._began_s = tick.t_s
        if tick.t_s >= self._next_line_s:
            self._next_line_s = tick.t_s + LINE_PERIOD_S
            self._emit(Event.PROGRESS, line=self._line(tick, tick.t_s - self._began_s))

    def _relay_texts(self) -> None:
        """What the autopilot says to its pilot concerns whoever reads our output as well."""
        texts = self._telemetry.texts
        for text in texts:
            if text.received_s > self._texts_until_s:
                self._emit(Event.AUTOPILOT_TEXT, text=text.text)
        if texts:
            self._texts_until_s = max(self._texts_until_s, texts[-1].received_s)

    def _watch_map(self) -> None:
        """Nothing of the map ends a flight at once, so whoever could make room has to know of it."""
        problem = self._mapper.status.problem
        if problem == self._map_problem:
            return
        self._map_problem = problem
        if problem:
            self._emit(Event.MAP_TROUBLE, problem=problem)
        else:
            self._emit(Event.MAP_WELL)

    def _watch_pause(self) -> None:
        paused = self._flight.paused
        if paused is not self._paused:
            self._paused = paused
            self._emit(Event.PAUSED if paused else Event.CONTINUED)

    def _watch_inputs(self, tick: Tick) -> None:
        if not tick.missing:
            if self._lost:
                self._emit(Event.INPUTS_BACK)
            self._missing_since_s = None
            self._lost.clear()
            return
        if self._missing_since_s is None:
            self._missing_since_s = tick.t_s
        elif tick.t_s - self._missing_since_s > MISSING_FOR_S and not self._lost.issuperset(tick.missing):
            self._lost.update(tick.missing)
            self._mode = Mode.HOLD
            self._emit(Event.INPUTS_LOST, missing=", ".join(tick.missing))

    def _line(self, tick: Tick, flown_s: float) -> str:
        measurement, status = tick.measurement, self._mapper.status
        d_m = None if measurement is None else measurement.d_m
        h_m = None if measurement is None else measurement.h_m
        what = f"stopped, no {', '.join(tick.missing)}" if tick.missing else MEANING[tick.mode]
        return (
            f"{int(flown_s) // 60}:{int(flown_s) % 60:02d} min  {what}, d {_metres(d_m)}, h {_metres(h_m)}, "
            f"map {status.completeness:.0%} (estimate), frontiers {status.frontiers}"
        )


def _metres(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} m"
