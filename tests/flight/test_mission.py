"""A whole flight in virtual time: the real application between a scripted autopilot, a fake gate and a fake map."""

from __future__ import annotations

import errno
import json
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import datetime, tzinfo
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest

from companion.autopilot.telemetry import Telemetry
from companion.config.load import load_settings
from companion.config.settings import Settings
from companion.control.completion import SUSTAINED_S, MapWord
from companion.control.left_out import LeftOut, Why
from companion.control.navigator import Navigator
from companion.flight import mission
from companion.flight.gate_client import GateClient
from companion.flight.lookout import DONE_PERIOD_S
from companion.flight.navigation_files import Navigation
from companion.flight.phase import PhaseMachine
from companion.flight.preflight import check_names
from companion.flight.request import FlightRequest
from companion.flight.session import Session
from companion.flight.tasks import background
from companion.gate.protocol import Beat, Phase
from companion.mapping.files.graph_file import read_graph
from companion.mapping.files.ground_file import read_known_ground
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd
from companion.model import Beam, RangeReading
from companion.recording import open_recording
from companion.recording.flight_stats import figures
from companion.sensors.sink import RawDepth, SensorSink
from companion.sensors.synchronizer import Synchronizer
from tests.autopilot.scripted import ScriptedAutopilot, ScriptedLink
from tests.flight.fake_gate import FakeGate
from tests.flight.test_reporting import STATUS
from tests.shared.clocks import HandClock

NOTHING_LEFT = MapWord(frontier_m=0.0, seen_share=1.0, surfaces_seen=1000, has_room=True)
SOMETHING_LEFT = NOTHING_LEFT._replace(frontier_m=3.0)
EXPLORED_S = 12.0
"""When the map has nothing left."""
ENDED_S = EXPLORED_S + SUSTAINED_S
WALL_M = 4.0


class Map:
    """In the place of the process of the map: complete after a while."""

    def __init__(self, clock: HandClock) -> None:
        self.status = replace(STATUS, word=SOMETHING_LEFT)
        self.offered = 0
        self.left_out = (LeftOut(3.0, 4.0, 1.5, 1.2, Why.TOO_LOW),)
        self._clock = clock

    def __call__(self, *_: object, **__: object) -> Self:
        """As if it were the class of the map."""
        return self

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        return

    def offer(self, _: object) -> bool:
        self.offered += 1
        return True

    def offer_scan(self, _: object) -> bool:
        return True

    async def save(self) -> list[Path]:
        # The gate must go on hearing that all is well meanwhile.
        await self._clock.sleep(5.0)
        return [Path("map.ply")]


class Mine(ScriptedAutopilot):
    """The scripted autopilot, what the vehicle's own sensors see where it flies, walls all around, and the gate."""

    def __init__(self, link: ScriptedLink, clock: HandClock, settings: Settings, gate: FakeGate) -> None:
        super().__init__(link, clock)
        self.beats: list[Beat] = []
        self._gate = gate
        self.sink = SensorSink(clock)
        self._camera = settings.sensors.camera.model()
        self._count = 0
        self.heartbeat()

    def _step(self, dt_s: float) -> None:
        super()._step(dt_s)
        self.beats += self._gate.beats()
        now_s = self.clock.now_s()
        self._count += 1
        stamp = {"time_boot_ms": int(1000.0 * now_s) - 900_000}
        self.link.deliver("ATTITUDE", stamp | dict.fromkeys(("roll", "pitch", "yaw", "yawspeed"), 0.0))
        place = dict.fromkeys(("x", "y", "vx", "vy", "vz"), 0.0)
        self.link.deliver("LOCAL_POSITION_NED", stamp | place | {"z": -self.height_m})
        self.link.deliver("ESTIMATOR_STATUS", {"flags": 0x3F})
        # No two readings of a sensor are alike to the last bit: a frozen one is not believed.
        wall_m = WALL_M + 0.001 * (self._count % 50)
        beams = [RangeReading(beam, now_s, wall_m, 8.0) for beam in Beam if beam is not Beam.DOWN]
        self.sink.ranges([RangeReading(Beam.DOWN, now_s, self.height_m + 0.1, 8.0), *beams])
        shape = (self._camera.height_px, self._camera.width_px)
        self.sink.depth(RawDepth(now_s, np.full(shape, wall_m, np.float32), self._camera))


class Scene:
    """A flight whose every second is virtual."""

    def __init__(self, gate: FakeGate, folder: Path, start: str, monkeypatch: pytest.MonkeyPatch) -> None:
        self.settings = Settings.model_validate({"record": {"folder": str(folder)}, "mission": {"start": start}})
        self.gate = gate
        self.clock = HandClock()
        self.link = ScriptedLink(self.clock, AutopilotKind.PX4)
        self.mine = Mine(self.link, self.clock, self.settings, gate)
        self.map = Map(self.clock)
        self.lines: list[str] = []
        monkeypatch.setattr(mission, "warm_up", lambda _: None)
        monkeypatch.setattr(mission, "MonotonicClock", lambda: self.clock)
        monkeypatch.setattr(mission, "MapClient", self.map)
        monkeypatch.setattr(mission, "open_session", self._session)

    @asynccontextmanager
    async def _session(
        self, settings: Settings, clock: HandClock, gate: GateClient, flight: PhaseMachine
    ) -> AsyncIterator[Session]:
        telemetry, sink = Telemetry(self.link, clock, settings), self.mine.sink
        async with background(gate.run(), telemetry.run()):
            inputs = Synchronizer(sink, telemetry.poses)
            yield Session(settings, clock, self.link, telemetry, sink, inputs, gate, flight)

    async def fly(self) -> dict[str, Any]:
        """The flight; its checks, which have tests of their own, are skipped."""
        skip = check_names(self.settings)
        return await mission.fly(
            FlightRequest("run", self.settings, "flight", 1, skip=skip), self.gate.link, self._show
        )

    def _show(self, line: str) -> None:
        self.lines.append(line)
        if line == "exploring":
            self.mine.at(EXPLORED_S, self._complete)
        elif line.startswith("ready:"):
            self.mine.at(1.0, self._start)

    def _complete(self) -> None:
        self.map.status = replace(STATUS, word=NOTHING_LEFT)

    def _start(self) -> None:
        ours = {"target_system": 1, "target_component": 191, "command": MavCmd.MISSION_START, "param1": 0.0}
        self.link.deliver("COMMAND_LONG", ours, system_id=255, component_id=190)


@pytest.fixture
def gate() -> Iterator[FakeGate]:
    with FakeGate() as fake:
        yield fake


@pytest.mark.parametrize("start", ["now", "command"])
async def test_a_flight_from_the_checks_to_the_summary(
    start: str, gate: FakeGate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects the wiring: what every room does is tested there, that they are joined is tested here."""
    scene = Scene(gate, tmp_path, start, monkeypatch)
    summary = await scene.fly()
    folder = next(tmp_path.iterdir())  # noqa: ASYNC240 - nothing else runs any more
    assert json.loads((folder / "summary.json").read_text()) == summary
    assert (summary["ended_because"], summary["as_it_should"], summary["interrupted"]) == ("complete", True, False)
    assert summary["explored_s"] == pytest.approx(ENDED_S, abs=DONE_PERIOD_S + 0.5)
    assert summary["done_at_s"] == pytest.approx(summary["explored_s"], abs=0.2)
    assert summary["estimated_completeness"] == STATUS.completeness
    low = {"x_m": 3.0, "y_m": 4.0, "z_m": 1.5, "extent_m": 1.2, "why": "too low"}
    assert low in summary["left_out"]
    assert any(line.startswith("map 40% (estimate); seen and left out: 1 too low") for line in scene.lines)
    assert not scene.mine.armed
    assert ("waiting for the start" in scene.lines) is (start == "command")
    said = ["taking off", "exploring", "the way home ended: home; landing", "writing the map"]
    assert [line for line in scene.lines if line in said] == said
    assert any(line.startswith("exploring ended: complete; coming home, ") for line in scene.lines)
    texts = [fields["text"] for fields in scene.link.sent_named("STATUSTEXT")]
    assert any(text.startswith("coming home: complete, ") for text in texts)
    assert [text for text in texts if "home" in text][1] == "companion: home: landing"
    assert texts[-1].startswith("companion: landed 0."), "after the landing"
    end = summary["end"]
    assert (end["arrived"], end["ended_because"]) == (True, "home")
    assert end["off_home_m"] < 0.25, "all of its images are the same: it takes itself to be a little elsewhere"
    assert end["homing_s"] < 5.0, "it never left, and settles for two seconds"
    flown = figures(folder / "flight.mcap")
    lasted_s = ENDED_S + end["homing_s"]
    assert flown.engaged_s == pytest.approx(lasted_s, abs=DONE_PERIOD_S + 0.5)
    assert flown.ended == "complete; the way home: home"
    assert flown.setpoints == pytest.approx(20 * lasted_s, abs=20 * DONE_PERIOD_S + 10)
    assert len(list(open_recording(folder / "flight.mcap").observations())) > 20 * ENDED_S
    assert scene.map.offered > 100
    assert list(dict.fromkeys(beat.phase for beat in scene.mine.beats)) == list(Phase)
    times_s = [beat.t_s for beat in scene.mine.beats if beat.phase is not Phase.GROUND]
    assert max(after - before for before, after in pairwise(times_s)) < 0.11, "also while the map is written"
    assert summary["beats_unsent"] == 0
    assert summary["graph"] == read_graph(folder / "graph.json").counts()._asdict()
    assert summary["graph"]["vertices"] > 0
    assert read_known_ground(folder / "known_ground.npz").cell_m > 0.0


@pytest.mark.parametrize("resumed", [True, False])
def test_the_graph_of_a_flight_that_resumes_a_map_leaves_that_of_the_other(tmp_path: Path, resumed: bool) -> None:
    """Protects the first flight's: both lie beside the map, and both are drawn there."""
    navigation = Navigation.of(Navigator(load_settings().control, np.random.default_rng(0)))
    first, second = tmp_path / "20000101-000000", tmp_path / "20000101-010000"
    for folder in (first, second):
        folder.mkdir()
        navigation.write(first if resumed else folder, folder)
    names = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*")}
    of_second = "20000101-000000/{}-20000101-010000.{}" if resumed else "20000101-010000/{}.{}"
    expected = {of_second.format("graph", "json"), of_second.format("known_ground", "npz")}
    assert names == expected | {"20000101-000000/graph.json", "20000101-000000/known_ground.npz"}


async def test_a_graph_that_cannot_be_written_costs_the_graph_alone(
    gate: FakeGate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects the map and the summary of a flight from a full disk."""

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Navigation, "write", full)
    scene = Scene(gate, tmp_path, "now", monkeypatch)
    summary = await scene.fly()
    assert summary["ended_because"] == "complete"
    assert [line for line in scene.lines if line.startswith("the navigation graph was not written: ")]


class StoppedClock(datetime):
    """A clock without a battery."""

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> StoppedClock:
        return cls(2000, 1, 1, tzinfo=tz)


async def test_a_flight_of_the_same_second_is_flown(
    gate: FakeGate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects whoever stands in a mine with a computer that does not know the time: before, it refused to fly."""
    monkeypatch.setattr(mission, "datetime", StoppedClock)
    before = tmp_path / "20000101-000000"
    (before / "map.journal").mkdir(parents=True)
    scene = Scene(gate, tmp_path, "now", monkeypatch)
    await scene.fly()
    after = tmp_path / "20000101-000000-2"
    assert [path.name for path in before.iterdir()] == ["map.journal"]
    assert (after / "flight.mcap").exists()
    assert any(f"{before} is there already" in line and str(after) in line for line in scene.lines)


async def test_a_disk_that_is_full_at_the_end_makes_no_failure_of_a_flight(
    gate: FakeGate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects the end of a flight: before, a traceback and no last word to the gate."""

    def full(_: Path) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(mission, "whole_file", full)
    scene = Scene(gate, tmp_path, "now", monkeypatch)
    assert (await scene.fly())["ended_because"] == "complete"
    assert any("No space left on device" in line and '"ended_because": "complete"' in line for line in scene.lines)
