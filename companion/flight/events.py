"""Events of a flight that people are told: one table, one emitter, and a sink each for console, pilot and recording."""

from __future__ import annotations

import enum
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from companion.autopilot.status_reporter import StatusReporter
from companion.mavlink.ids import MavSeverity, MavState
from companion.recording import Recorder, content


@dataclass(frozen=True, slots=True)
class Texts:
    """Texts of an event for each place where it is told. Braces are filled in with the details of its occurrence.

    Attributes:
        console: the operator's line; None: none.
        status: the STATUSTEXT for the pilot, of which 50 bytes are shown; None: none.
        kind: its name in the recording; empty: it is not recorded.
        recorded: the text in the recording, where it is not that of the console.
        severity: of the STATUSTEXT, and of the entry in the recording.
        state: what our heartbeat says from now on; None: as before.
        again: whether the pilot is told also when that was the last thing that he was told: somebody waits for it.
    """

    console: str | None = None
    status: str | None = None
    kind: str = ""
    recorded: str | None = None
    severity: MavSeverity = MavSeverity.INFO
    state: MavState | None = None
    again: bool = False


_NOTICE, _WARNING, _ERROR = MavSeverity.NOTICE, MavSeverity.WARNING, MavSeverity.ERROR


@enum.unique
class Event(enum.Enum):
    """Everything that happens in a flight and that somebody has to know of, in the order of a flight."""

    LOADING = Texts("loading the navigator (the first time on a computer compiles it, about a minute)")
    CONNECTING = Texts("looking for the autopilot at {url}")
    CONNECTED = Texts("connected; listening to the autopilot and the sensors")
    NOT_READY_YET = Texts("waiting for {what}, up to {timeout_s:g} s")
    REFUSED = Texts("{results}", "not armed: {failed}", severity=_ERROR)
    NAME_TAKEN = Texts(
        "{wanted} is there already (is the clock of this computer right?): this flight is kept in {folder}"
    )
    MAP_STARTING = Texts(
        "starting the map (the first start on a computer compiles it: a minute, on a small one several)"
    )
    MAP_RESUMED = Texts("the map of {folder} goes on: {chunks} chunks")
    GROUND_RESUMED = Texts("known ground goes on: {area_m2:.0f} m² of floor were seen before", kind="map")
    GROUND_NOT_RESUMED = Texts(
        "known ground is not gone on from: {why}; the map goes on, and what was seen before is flown to again",
        "companion: known ground was not taken up",
        "map",
        severity=_WARNING,
    )
    CHECK_PASSED = Texts(kind="check", recorded="{name} passed: {found}")
    CHECK_SKIPPED = Texts(kind="check", recorded="{name} skipped: {found}", severity=_WARNING)

    WAITING = Texts(
        "waiting for the start", "companion: waiting for the start", "phase", severity=_NOTICE, state=MavState.STANDBY
    )
    READY_FOR_KEY = Texts("ready: press Enter to take off")
    READY_FOR_COMMAND = Texts("ready: waiting for MAV_CMD_MISSION_START")
    CHECKING_AGAIN = Texts("checking again")
    TAKING_OFF = Texts("taking off", "companion: taking off", "phase", severity=_NOTICE, state=MavState.ACTIVE)
    TAKING_OVER = Texts(
        "taking the vehicle over from its own mission",
        "companion: taking over from the mission",
        "phase",
        severity=_NOTICE,
        state=MavState.ACTIVE,
    )
    EXPLORING = Texts("exploring", "companion: exploring", content.ENGAGED, severity=_NOTICE, state=MavState.ACTIVE)

    PAUSED = Texts("paused: it stands until it is told to continue", "companion: paused", "pause", severity=_NOTICE)
    CONTINUED = Texts("goes on", "companion: goes on", "pause", severity=_NOTICE)
    COMMAND_REFUSED = Texts(
        "{what} refused: {reason}", "{what} refused: {reason}", "command", severity=_WARNING, again=True
    )

    PROGRESS = Texts("{line}")
    NAVIGATOR_MODE = Texts(status="{mode}")
    INPUTS_LOST = Texts(
        "stopped: no {missing}", "stopped: no {missing}", "inputs", severity=_WARNING, state=MavState.CRITICAL
    )
    INPUTS_BACK = Texts(
        status="inputs are back", kind="inputs", recorded="back", severity=_NOTICE, state=MavState.ACTIVE
    )
    MAP_TROUBLE = Texts("map: {problem}", "map: {problem}", "map", severity=_WARNING)
    MAP_WELL = Texts("map: in order again", "map: in order again", "map", severity=_NOTICE)
    LINK_TROUBLE = Texts("link: {text}", kind="link", recorded="{text}", severity=_WARNING)
    LINK_COMMAND = Texts("{who} over the link: {command}: {answer}", kind="link", severity=_NOTICE)
    LINK_LOST = Texts(
        "nobody at the ground was heard for {silent_s:.0f} s: {then}",
        "link lost: {then}",
        "link",
        severity=_WARNING,
    )
    LINK_FINISHING = Texts("the ground still fetches what is missing of the map (Ctrl-C: not any more)")
    SENSOR_WARNING = Texts("sensors: {text}", "{text}", "sensors", "{text}", _WARNING)
    AUTOPILOT_TEXT = Texts("autopilot: {text}", kind="statustext", recorded="{text}")
    GATE_NOTICE = Texts("gate: {text}", kind="gate", recorded="{text}", severity=_WARNING)

    ENDED = Texts(
        "exploring ended: {why}", "companion: {end}: {then}", content.ENDED, "{why}", _NOTICE, state=MavState.ACTIVE
    )
    ENDED_EARLY = Texts(
        "exploring ended: {why}", "companion: {end}: {then}", content.ENDED, "{why}", _WARNING, state=MavState.EMERGENCY
    )

    HOMING = Texts(
        "exploring ended: {why}; coming home, {outlook} (to land here instead: {instead})",
        "coming home: {brief}, {outlook}",
        content.HOMING,
        "{why}, {outlook}",
        _NOTICE,
        MavState.ACTIVE,
    )
    HOMING_PROGRESS = Texts("on the way home: {outlook}", "home: {outlook}", content.HOMING, "{outlook}")
    HOMING_ALREADY = Texts("it is on its way home already; to land here instead: Ctrl-C once more")
    OUT_OF_REACH = Texts(
        "the battery will not last until home: it flies on towards it and lands with {spent} % left",
        "home out of reach: lands at {spent} %",
        content.HOMING,
        severity=_WARNING,
    )
    WAY_CLOSED = Texts(
        "the way home is closed, and no other was found: it lands as near to home as it gets",
        "way home closed: lands as near as it gets",
        content.HOMING,
        severity=_WARNING,
    )
    HOMING_ENDED = Texts(
        "the way home ended: {why}; {then}", "companion: {brief}: {then}", content.ENDED, "{recorded}", _NOTICE
    )
    HOMING_ENDED_EARLY = Texts(
        "the way home ended: {why}; {then}",
        "companion: {brief}: {then}",
        content.ENDED,
        "{recorded}",
        _WARNING,
        state=MavState.EMERGENCY,
    )
    LANDS_BESIDE_HOME = Texts(
        "where it took off cannot be got to any more: landing at the nearest place of its way that can",
        "home is taken: landing beside it",
        "landing",
        severity=_WARNING,
    )
    UNFIT_TO_LAND = Texts("the place to land is {what}", "landing place: {what}", "landing", severity=_WARNING)
    LANDED = Texts(
        "landed {off} from where it took off, by its own account{unsure}",
        "companion: landed {off} from home",
        "landing",
        severity=_NOTICE,
    )

    BROKE_OFF = Texts(kind=content.ENDED, recorded="{why}", severity=_ERROR)
    MAP_WRITING = Texts("writing the map")
    MAP_STILL_WRITTEN = Texts("writing the map: a moment; interrupt once more to end with what is there")
    GRAPH_NOT_WRITTEN = Texts(
        "the navigation graph was not written: {error}; companion replay --graph makes it of the recording"
    )
    MAP_NOT_WRITTEN = Texts("the map was not written: {error}")
    SUMMARY_NOT_WRITTEN = Texts("summary.json was not written: {error}; it would be {summary}")
    LEFT_OUT = Texts("map {share:.0%} (estimate); seen and left out: {places}")
    OVER = Texts("{why}: {files} map files are in {map_folder}, the recording in {folder}")
    LEFT_TO_EXPLORE = Texts(
        "{places} left to explore: fly again from the same place with --resume-map {map_folder}",
        "companion: {places} left to explore",
        severity=_NOTICE,
    )


Details = Mapping[str, object]
Sink = Callable[[Event, Details], None]
"""Takes every event with its details; never blocks and never raises."""


class EventEmitter:
    """Passes every event to every sink."""

    def __init__(self, *sinks: Sink) -> None:
        self._sinks = list(sinks)

    def add(self, sink: Sink) -> None:
        """From now on this one gets every event too."""
        self._sinks.append(sink)

    def emit(self, event: Event, **details: object) -> None:
        """Something happened; ``details`` fill in the texts of the table."""
        for sink in self._sinks:
            sink(event, details)


_LEVELS = {MavSeverity.WARNING: logging.WARNING, MavSeverity.ERROR: logging.ERROR}


def console(show: Callable[[str], None]) -> Sink:
    """A line for the operator, which ``show`` prints."""

    def sink(event: Event, details: Details) -> None:
        if event.value.console is not None:
            show(event.value.console.format_map(details))

    return sink


def status_text(status_reporter: StatusReporter) -> Sink:
    """A STATUSTEXT for the pilot, and the state in our heartbeat: standby on the ground, anything else in the air."""

    def sink(event: Event, details: Details) -> None:
        texts = event.value
        if texts.status is not None:
            status_reporter.say(texts.status.format_map(details), texts.severity, texts.again)
        if texts.state is not None:
            status_reporter.state(texts.state, armed=texts.state is not MavState.STANDBY)

    return sink


def recording(recorder: Recorder) -> Sink:
    """An entry in the recording's log."""

    def sink(event: Event, details: Details) -> None:
        texts = event.value
        text = texts.console if texts.recorded is None else texts.recorded
        if texts.kind and text is not None:
            recorder.event(texts.kind, text.format_map(details), _LEVELS.get(texts.severity, logging.INFO))

    return sink
