"""The table of events: what each sink makes of it, and that no text can fail in flight."""

from __future__ import annotations

import ast
import logging
import string
from pathlib import Path
from typing import cast

import pytest

import companion.flight
from companion.autopilot.status_reporter import TEXT_BYTES, StatusReporter
from companion.flight.events import Event, EventEmitter, Texts, console, recording, status_text
from companion.flight.termination import Termination
from companion.recording import Recorder
from companion.recording.content import ENDED, ENGAGED
from tests.autopilot.fake_link import FakeLink
from tests.flight.test_reporting import Notes
from tests.shared.clocks import HandClock

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
    assert len(Event.ENDED_EARLY.value.status.format(end=why.value, then=then)) <= TEXT_BYTES


def test_the_exploring_is_marked_in_the_recording() -> None:
    """The figures of a flight are taken between these two."""
    told = Told()
    told.emit(Event.TAKING_OFF)
    told.emit(Event.EXPLORING)
    told.emit(
        Event.ENDED_EARLY, why="pilot or failsafe took over loiter", end=Termination.PILOT.value, then="hands off"
    )
    assert [name for name, _, _ in told.notes.events] == ["phase", ENGAGED, ENDED]
    assert told.lines[-1] == "exploring ended: pilot or failsafe took over loiter"
    texts = [fields["text"] for fields in told.on_the_link("STATUSTEXT")]
    assert texts == [
        "companion: taking off",
        "companion: exploring",
        "companion: pilot or failsafe took over: hands off",
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
