"""What pilot, operator and recording are told."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
import pytest

from companion.autopilot.status_reporter import StatusReporter
from companion.autopilot.telemetry import Telemetry
from companion.config.settings import Settings
from companion.flight.events import EventEmitter, console, recording, status_text
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.flight.reporting import MapFeed, TickReporter
from companion.mapping.process.client import MapClient
from companion.mapping.process.messages import MapStatus
from companion.model import DepthFrame, Input, Mode, Observation, PlanarScan, Pose, Setpoint
from companion.pipeline import Tick
from companion.recording import Recorder
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
    complete=False,
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
        self.reporter = TickReporter(
            self.events, self.status_reporter, self.telemetry, cast("MapClient", self.mapper), self.flight
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
    feed = MapFeed(cast("MapClient", mapper))
    feed(Tick(1.0, seen, None, None, Mode.HOLD, False, 1.5, 0.0, stepped=False))
    feed(Tick(1.0, None, None, None, Mode.HOLD, False, 1.5, 0.0, stepped=False))
    assert mapper.offered == ([frame] if with_frame else [])
    assert mapper.scans == ([scan] if with_scan else [])
