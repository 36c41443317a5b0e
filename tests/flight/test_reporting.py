"""What pilot, operator and recording are told, and the table of events that it is taken from."""

from __future__ import annotations

import ast
import logging
import string
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

import companion.flight
from companion.autopilot.status_reporter import TEXT_BYTES, StatusReporter
from companion.autopilot.telemetry import Telemetry
from companion.config.settings import Settings
from companion.flight.events import Event, EventEmitter, Texts, console, recording, status_text
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.flight.reporting import TickReporter, map_feed
from companion.flight.termination import Termination
from companion.mapping.process.client import MapClient
from companion.mapping.process.messages import MapStatus
from companion.model import DepthFrame, Input, Mode, Observation, PlanarScan, Pose, Setpoint
from companion.pipeline import Tick
from companion.recording import Recorder
from companion.recording.content import ENDED, ENGAGED
from companion.sensors.sink import SensorSink
from tests.autopilot.fake_link import FakeLink
from tests.control.stages import beside
from tests.flight.test_control_loop import CAMERA
from tests.shared.clocks import HandClock

STATUS = MapStatus(
    frames=5,
    dropped=0,
    refused=0,
    occupied=100,
    completeness=0.4,
    frontiers=3,
    survey_s=0.01,
    age_s=0.1,
    alive=True,
    restarts=0,
)
POSE = Pose(0.0, 0.0, 0.0, 1.5, 0.0)


@dataclass
class Mapper:
    """Notes the images and scans that it is offered."""

    status: MapStatus = STATUS
    offered: list[DepthFrame] = field(default_factory=list)
    scans: list[PlanarScan] = field(default_factory=list)

    def offer(self, frame: DepthFrame) -> bool:
        self.offered.append(frame)
        return True

    def offer_scan(self, scan: PlanarScan) -> bool:
        self.scans.append(scan)
        return True


@dataclass
class Notes:
    """A recorder that keeps its events."""

    events: list[tuple[str, str, int]] = field(default_factory=list)

    def event(self, name: str, text: str, level: int = logging.INFO) -> None:
        self.events.append((name, text, level))


class Stand:
    """A reporter with everything around it."""

    def __init__(self) -> None:
        self.clock = HandClock(100.0)
        self.link = FakeLink(self.clock)
        self.telemetry = Telemetry(self.link, self.clock, Settings())
        self.status_reporter = StatusReporter(self.link, self.clock)
        self.notes = Notes()
        self.said: list[str] = []
        self.mapper = Mapper()
        self.flight = PhaseMachine()
        self.events = EventEmitter(
            console(self.said.append), status_text(self.status_reporter), recording(cast("Recorder", self.notes))
        )
        self.sink = SensorSink(self.clock)
        self.reporter = TickReporter(
            self.events,
            self.status_reporter,
            self.telemetry,
            cast("MapClient", self.mapper),
            self.flight,
            self.sink.warnings,
        )

    def tick(self, *, missing: tuple[Input, ...] = (), mode: Mode = Mode.BOUNDARY) -> None:
        """50 ms later, a tick along a wall unless told otherwise."""
        self.clock.advance(0.05)
        now_s = self.clock.time_s
        told = replace(beside(1), t_s=now_s, missing=missing)
        setpoint = Setpoint(now_s, 0.5, 0.0, 0.1)
        self.reporter(Tick(now_s, Observation(now_s, POSE), told, setpoint, mode, True, 1.5, 0.001, stepped=True))
        self.status_reporter.tick()

    def texts(self) -> list[str]:
        """What ground stations got to read."""
        return [fields["text"] for fields in self.link.sent_named("STATUSTEXT")]


def test_ground_stations_get_d_h_and_completeness() -> None:
    stand = Stand()
    stand.tick()
    values = {fields["name"]: fields["value"] for fields in stand.link.sent_named("NAMED_VALUE_FLOAT")}
    told = beside(1)
    assert values == {"d": told.d_m, "h": told.h_m, "complete": 0.4}


def test_a_change_of_mode_is_told_once() -> None:
    stand = Stand()
    stand.flight.phase = FlightPhase.EXPLORING
    for _ in range(40):
        stand.tick()
    for _ in range(40):
        stand.tick(mode=Mode.TANGENT)
    modes = [text for text in stand.texts() if text.startswith("R")]
    assert modes == ["R3 along the wall", "R2 along tangent"]


@pytest.mark.parametrize("phase", [FlightPhase.EXPLORING, FlightPhase.HOMING])
def test_a_pause_is_told_and_its_end(phase: FlightPhase) -> None:
    """Protects whoever looks at a vehicle that stands: it is told from one that has no way on."""
    stand = Stand()
    stand.flight.phase = phase
    for paused in (False, True, False):
        stand.flight.pause(paused)
        for _ in range(20):
            stand.tick(mode=Mode.HOLD)
    assert [text for text in stand.texts() if text.startswith("companion")] == [
        "companion: paused",
        "companion: goes on",
    ]
    assert stand.said.count("goes on") == 1
    assert [text for kind, text, _ in stand.notes.events if kind == "pause"] == [
        "paused: it stands until it is told to continue",
        "goes on",
    ]


def test_a_stop_says_why_and_that_it_is_over() -> None:
    """A late frame is no event; inputs lost for longer than half a second are."""
    stand = Stand()
    stand.flight.phase = FlightPhase.EXPLORING
    stand.tick()
    for _ in range(4):
        stand.tick(missing=(Input.DEPTH,), mode=Mode.HOLD)
    for _ in range(40):
        stand.tick()
    assert not any("depth" in text for text in stand.texts())
    for _ in range(60):
        stand.tick(missing=(Input.DEPTH,), mode=Mode.HOLD)
    assert stand.texts()[-1] == "stopped: no depth"
    assert stand.link.sent_named("HEARTBEAT")[-1]["system_status"] == 5
    assert stand.said.count("stopped: no depth") == 1
    for _ in range(60):
        stand.tick()
    assert "inputs are back" in stand.texts()
    assert stand.link.sent_named("HEARTBEAT")[-1]["system_status"] == 4


def test_what_the_autopilot_says_reaches_the_operator_once() -> None:
    stand = Stand()
    stand.link.deliver("STATUSTEXT", {"severity": 4, "text": "Low battery"})
    stand.tick()
    stand.tick()
    assert stand.said == ["autopilot: Low battery"]


def test_trouble_of_the_map_is_told_once_and_when_it_is_over() -> None:
    """Protects the map from a full disk that somebody could clear: who can must hear of it, once."""
    stand = Stand()
    stand.tick()
    stand.mapper.status = replace(STATUS, problem="disk full, in memory only: make room (No space left)")
    for _ in range(60):
        stand.tick()
    stand.mapper.status = STATUS
    for _ in range(60):
        stand.tick()
    told = [line for line in stand.said if line.startswith("map: ")]
    assert told == ["map: disk full, in memory only: make room (No space left)", "map: in order again"]
    assert [text for text in stand.texts() if text.startswith("map: ")] == [
        "map: disk full, in memory only: make room (No sp..",
        "map: in order again",
    ]
    assert ("map", told[0], logging.WARNING) in stand.notes.events


@pytest.mark.parametrize("with_frame", [True, False])
@pytest.mark.parametrize("with_scan", [True, False])
def test_the_map_gets_every_image_and_every_scan(with_frame: bool, with_scan: bool) -> None:
    """Protects the map from a sensor that is heard by the law only."""
    mapper = Mapper()
    frame = DepthFrame(1.0, np.full((CAMERA.height_px, CAMERA.width_px), 2.0, np.float32), CAMERA, POSE)
    scan = PlanarScan(1.0, np.array([0.0, 0.1]), np.array([2.0, 2.0]), 10.0, POSE)
    seen = Observation(1.0, POSE, frame if with_frame else None, planar=scan if with_scan else None)
    feed = map_feed(cast("MapClient", mapper))
    feed(Tick(1.0, seen, None, None, Mode.HOLD, False, 1.5, 0.0, stepped=False))
    feed(Tick(1.0, None, None, None, Mode.HOLD, False, 1.5, 0.0, stepped=False))
    assert mapper.offered == ([frame] if with_frame else [])
    assert mapper.scans == ([scan] if with_scan else [])


# The table of events: what each sink makes of it, and that no text can fail in flight.


FLIGHT = Path(companion.flight.__file__).parent


class Told:
    """All three sinks, and what arrived in them."""

    def __init__(self) -> None:
        self.clock = HandClock()
        self.link = FakeLink(self.clock)
        self.status_reporter = StatusReporter(self.link, self.clock)
        self.notes = Notes()
        self.lines: list[str] = []
        self.emit = EventEmitter(
            console(self.lines.append), status_text(self.status_reporter), recording(cast("Recorder", self.notes))
        ).emit

    def on_the_link(self, name: str) -> list[dict[str, object]]:
        """The messages of this name, once all have had their turn."""
        for _ in range(20):
            self.clock.advance(1.0)
            self.status_reporter.tick()
        return self.link.sent_named(name)


def fields(texts: Texts) -> set[str]:
    """The details that an event's texts need."""
    found = (texts.console, texts.status, texts.recorded)
    return {name for text in found if text for _, name, _, _ in string.Formatter().parse(text) if name is not None}


def emitted() -> list[tuple[str, str, set[str]]]:
    """Where events are emitted: file and line, event, the details given. Both events of a choice count."""
    found = []
    for file in sorted(FLIGHT.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not ast.unparse(node.func).endswith("emit"):
                continue
            given = {str(keyword.arg) for keyword in node.keywords}
            names = [part.attr for part in ast.walk(node.args[0]) if isinstance(part, ast.Attribute)]
            events = [name for name in names if name in Event.__members__] or _chosen(file, node)
            found += [(f"{file.name}:{node.lineno}", name, given) for name in events]
    return found


def _chosen(file: Path, call: ast.Call) -> list[str]:
    """The events that a variable of the name ``event`` may be."""
    assert ast.unparse(call.args[0]) == "event", f"{file}:{call.lineno}: not understood"
    found = [node for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if isinstance(node, ast.Assign)]
    chosen = [node.value for node in found if ast.unparse(node.targets[0]) == "event"]
    parts = [part for value in chosen for part in ast.walk(value) if isinstance(part, ast.Attribute)]
    return [part.attr for part in parts if part.attr in Event.__members__]


def test_every_event_is_emitted_with_what_its_texts_need() -> None:
    """Protects a flight from a text that cannot be filled in: an error in a tick would end it."""
    places = emitted()
    wrong = [place for place in places if place[2] != fields(Event[place[1]].value)]
    assert wrong == []
    assert {name for _, name, _ in places} == set(Event.__members__), "no event that is never emitted"


@pytest.mark.parametrize("event", Event)
def test_a_text_for_the_pilot_is_not_cut(event: Event) -> None:
    """What comes from elsewhere, a problem of the map or many names, may be; the words of the table may not."""
    assert len((event.value.status or "").encode("ascii")) <= TEXT_BYTES


@pytest.mark.parametrize("why", Termination)
@pytest.mark.parametrize("then", ["landing", "holding", "hands off"])
def test_the_end_and_what_follows_fit_into_one_text(why: Termination, then: str) -> None:
    assert Event.ENDED_EARLY.value.status is not None
    assert len(Event.ENDED_EARLY.value.status.format(end=why.in_brief, then=then)) <= TEXT_BYTES


def test_the_exploring_is_marked_in_the_recording() -> None:
    """The figures of a flight are taken between these two."""
    told = Told()
    told.emit(Event.TAKING_OFF)
    told.emit(Event.EXPLORING)
    told.emit(Event.ENDED_EARLY, why="pilot took over loiter", end=Termination.PILOT.value, then="hands off")
    assert [name for name, _, _ in told.notes.events] == ["phase", ENGAGED, ENDED]
    assert told.lines[-1] == "exploring ended: pilot took over loiter"
    texts = [fields["text"] for fields in told.on_the_link("STATUSTEXT")]
    assert texts == [
        "companion: taking off",
        "companion: exploring",
        "companion: pilot took over: hands off",
    ]


def test_skipped_checks_are_on_record_and_nowhere_else() -> None:
    told = Told()
    told.emit(Event.CHECK_PASSED, name="link", found="0.1 s")
    told.emit(Event.CHECK_SKIPPED, name="battery", found="not looked at")
    assert told.notes.events == [
        ("check", "link passed: 0.1 s", logging.INFO),
        ("check", "battery skipped: not looked at", logging.WARNING),
    ]
    assert told.lines == []
    assert told.on_the_link("STATUSTEXT") == []


def test_the_heartbeat_says_whether_the_vehicle_flies_and_whether_all_is_well() -> None:
    told = Told()
    states = []
    for event, details in (
        (Event.WAITING, {}),
        (Event.TAKING_OFF, {}),
        (Event.INPUTS_LOST, {"missing": "depth"}),
        (Event.INPUTS_BACK, {}),
        (Event.ENDED_EARLY, {"why": "battery low", "end": "battery low", "then": "landing"}),
    ):
        told.emit(event, **details)
        newest = told.on_the_link("HEARTBEAT")[-1]
        states.append((newest["system_status"], newest["base_mode"]))
    assert states == [(3, 0), (4, 128), (5, 128), (4, 128), (6, 128)]


def test_what_a_driver_has_to_tell_reaches_operator_pilot_and_recording() -> None:
    """Protects the height from a rangefinder that sees something else: said once, in all three places."""
    stand = Stand()
    stand.sink.warn("rangefinders down: 1/0 0.30 m, 42/1 1.50 m contradict each other")
    for _ in range(30):
        stand.tick()
    assert [line for line in stand.said if "rangefinders" in line] == [
        "sensors: rangefinders down: 1/0 0.30 m, 42/1 1.50 m contradict each other"
    ]
    assert any(text.startswith("rangefinders down: 1/0 0.30 m, 42/1 1.50 m") for text in stand.texts())
    assert ("sensors", "rangefinders down: 1/0 0.30 m, 42/1 1.50 m contradict each other", logging.WARNING) in (
        stand.notes.events
    )
