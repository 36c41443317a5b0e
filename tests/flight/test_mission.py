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
from companion.control.ground_grid import FREE
from companion.control.known_ground import KnownGround, Place
from companion.control.left_out import LeftOut, Why
from companion.control.navigator import Navigator
from companion.flight import mission
from companion.flight.gate_client import GateClient
from companion.flight.lookout import DONE_PERIOD_S
from companion.flight.navigation_files import EarlierGround, Navigation
from companion.flight.phase import PhaseMachine
from companion.flight.preflight import check_names
from companion.flight.request import FlightRequest
from companion.flight.session import Session
from companion.flight.tasks import background
from companion.gate.protocol import Beat, Phase
from companion.mapping.files.graph_file import read_graph
from companion.mapping.files.ground_file import ground_content, read_known_ground, write_known_ground
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd
from companion.model import Beam, Pose, RangeReading
from companion.recording import open_recording, record
from companion.recording.flight_stats import figures
from companion.recording.replay import replay
from companion.sensors.sink import RawDepth, SensorSink
from companion.sensors.synchronizer import Synchronizer
from tests.autopilot.scripted import ScriptedAutopilot, ScriptedLink
from tests.control.scene import measurement, scan_of
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
        self.left_out: tuple[LeftOut, ...] = (LeftOut(3.0, 4.0, 1.5, 1.2, Why.TOO_LOW),)
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
        self.resume_map: Path | None = None
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
            yield Session(settings, clock, self.link, telemetry, sink, inputs, gate, flight, None)

    def ends_after(self, time_limit_s: float) -> None:
        """The flight has so much time."""
        mission_settings = self.settings.mission.model_copy(update={"time_limit_s": time_limit_s})
        self.settings = self.settings.model_copy(update={"mission": mission_settings})

    async def fly(self) -> dict[str, Any]:
        """The flight; its checks, which have tests of their own, are skipped."""
        skip = check_names(self.settings)
        request = FlightRequest("run", self.settings, "flight", 1, skip=skip, resume_map=self.resume_map)
        return await mission.fly(request, self.gate.link, self._show)

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
    assert scene.lines[-1].startswith("complete: "), "it does not say to fly again"
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


@pytest.mark.parametrize(
    ("resumed", "goes_on", "of_second"),
    [
        (False, False, {"20000101-010000/graph.json", "20000101-010000/known_ground.npz"}),
        (
            True,
            False,
            {"20000101-000000/graph-20000101-010000.json", "20000101-000000/known_ground-20000101-010000.npz"},
        ),
        (True, True, {"20000101-000000/graph-20000101-010000.json"}),
    ],
)
def test_the_graph_of_a_flight_that_resumes_a_map_leaves_that_of_the_other(
    tmp_path: Path, resumed: bool, goes_on: bool, of_second: set[str]
) -> None:
    """Protects the first flight's: both lie beside the map, but for ground that the second one's holds as well."""
    navigation = Navigation.of(Navigator(load_settings().control, np.random.default_rng(0)))
    first, second = tmp_path / "20000101-000000", tmp_path / "20000101-010000"
    for folder in (first, second):
        folder.mkdir()
        navigation.write(first if resumed else folder, folder, goes_on)
    names = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*")}
    assert names == of_second | {"20000101-000000/graph.json", "20000101-000000/known_ground.npz"}


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


def earlier_flight(folder: Path) -> Path:
    """The folder of a flight with a map, and what it knew of the ground: a place 50 m away."""
    (folder / "map.journal").mkdir(parents=True)
    ground = KnownGround(cell_m=Navigator(load_settings().control, np.random.default_rng(0)).known_ground.cell_m)
    ground.see(measurement(scan_of(lambda _: 6.0), h_m=1.5), Pose(0.0, 50.0, 0.0, 1.5, 0.0))
    write_known_ground(ground.seen(), folder / "known_ground.npz")
    return folder


async def test_a_second_sortie_goes_on_from_the_ground_of_the_first(
    gate: FakeGate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was seen counts as seen, one file knows both afterwards, and the recording can be flown again."""
    # Whether it can be flown again is asked, and not how many images a busy computer has no room for meanwhile.
    monkeypatch.setattr(record, "FRAMES_WAITING", record.WAITING)
    first = earlier_flight(tmp_path / "first")
    before = read_known_ground(first / "known_ground.npz")
    scene = Scene(gate, tmp_path / "flights", "now", monkeypatch)
    scene.ends_after(4.0)
    scene.resume_map = first
    summary = await scene.fly()
    assert summary["known_before_m2"] == pytest.approx(before.free_m2, abs=0.1)
    assert any(line.startswith("known ground goes on: ") for line in scene.lines)
    both = read_known_ground(first / "known_ground.npz")
    row, column = both.cell(Place(54.0, 0.2, 0.0))
    assert both.grid.cells[0, row, column] == FREE, "what the first has seen"
    assert both.free_m2 > before.free_m2 + 1.0, "and what the second has"
    assert not list(first.glob("known_ground-*"))
    assert len(list(first.glob("graph-*.json"))) == 1
    flown = replay(next((tmp_path / "flights").iterdir()) / "flight.mcap")
    assert (flown.stopped, flown.differing) == (None, 0)
    assert flown.compared > 50


async def test_ground_that_cannot_be_gone_on_from_costs_the_ground_alone(
    gate: FakeGate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It flies, says why it begins anew, and its last line is for whoever changes the battery."""
    first = earlier_flight(tmp_path / "first")
    (first / "known_ground.npz").write_bytes(DAMAGED)
    scene = Scene(gate, tmp_path / "flights", "now", monkeypatch)
    scene.ends_after(2.0)
    scene.resume_map = first
    scene.map.left_out += (LeftOut(9.0, 9.0, 0.0, 3.0, Why.NOT_REACHED),)
    summary = await scene.fly()
    assert (summary["ended_because"], summary["known_before_m2"]) == ("time limit", None)
    told = "known ground is not gone on from: "
    assert [line for line in scene.lines if line.startswith(told) and "is no known ground, or damaged" in line]
    left = sum(place["why"] == "not reached" for place in summary["left_out"])
    places = "1 place" if left == 1 else f"{left} places"
    assert scene.lines[-1] == f"{places} left to explore: fly again from the same place with --resume-map {first}"
    texts = [fields["text"] for fields in scene.link.sent_named("STATUSTEXT")]
    assert "companion: known ground was not taken up" in texts
    assert texts[-1] == f"companion: {places} left to explore"


DAMAGED = b"PK\x03\x04"


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (None, "No such file"),
        (DAMAGED, "is no known ground, or damaged"),
        (ground_content(KnownGround(cell_m=3.0).seen()), "its cells are 3 m wide, those of this flight 0.5 m"),
    ],
)
def test_ground_that_was_not_gone_on_from_stays(content: bytes | None, why: str, tmp_path: Path) -> None:
    """Whatever is wrong with it: the flight says so in words, and writes its own beside it, or in the place of none."""
    first, second = tmp_path / "first", tmp_path / "second"
    file = earlier_flight(first) / "known_ground.npz"
    file.unlink()
    if content is not None:
        file.write_bytes(content)
    navigator = Navigator(load_settings().control, np.random.default_rng(0))
    earlier = EarlierGround.taken_up(navigator.known_ground, first)
    assert earlier.problem is not None
    assert str(file) in earlier.problem
    assert why in earlier.problem
    assert (earlier.content, earlier.free_m2) == (b"", None)
    Navigation.of(navigator).write(first, second, earlier.window is not None)
    beside = {path.name for path in first.glob("*.npz")} - {file.name}
    assert beside == (set() if content is None else {"known_ground-second.npz"})
    assert content is None or file.read_bytes() == content


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
