"""The recorder: complete while all is well, bounded always, and never in the way of the flight."""

from __future__ import annotations

import errno
import logging
import math
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove.messages import Log, LogLevel, RawImage, Timestamp
from hypothesis import given
from hypothesis import strategies as st

from companion.config.mission import RecordSettings
from companion.errors import InputError
from companion.model import Beam, Camera, DepthFrame, Mode, Observation, PlanarScan, Pose, RangeReading
from companion.recording import Recorder, open_recording
from companion.recording import record as record_module
from companion.recording import writing as writing_module
from companion.recording.content import Topic
from companion.recording.observation import decode, encode
from companion.recording.process import LoadMeter
from companion.recording.read import depth_image, fields, log_line
from companion.recording.writing import RecordingFile, Writing
from tests.recording.flights import SETTINGS, make_frame, make_info, make_tick
from tests.shared.beside import wait_until
from tests.shared.clocks import HandClock

anything = st.floats(width=64)
poses = st.builds(Pose, *[anything] * 11)


def recorder_of(file: Path, clock: HandClock | None = None, **settings: Any) -> Recorder:
    return Recorder(file, RecordSettings(**settings), make_info(), clock or HandClock(0.0))


def written(recorder: Recorder) -> None:
    """Wait until all that was handed over is in the file."""
    wait_until(lambda: not recorder.waiting or not recorder.recording, "written")


def record(file: Path, seconds: float, *, frames: bool = True) -> Recorder:
    clock = HandClock(100.0)
    with recorder_of(file, clock) as recorder:
        recorder.event("engaged", "exploring")
        for n in range(round(seconds * 20)):
            clock.time_s = 100.0 + n / 20.0
            recorder.tick(make_tick(clock.time_s, frame=make_frame(clock.time_s) if frames and n % 4 == 0 else None))
            if n % 20 == 0:
                written(recorder)
    return recorder


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five seconds with depth images."""
    path = tmp_path_factory.mktemp("record") / "flights" / "flight.mcap"
    recorder = record(path, 5.0)
    assert recorder.problem is None
    return path


def topics(path: Path) -> Counter[str]:
    return Counter(entry.topic for entry in open_recording(path).entries())


def same(one: object, other: object) -> bool:
    """Equal, NaN to NaN."""
    return repr(one) == repr(other)


# What is in the file.


def test_everything_is_recorded(flight: Path) -> None:
    """Every tick, every image, the scan at 2 Hz, events, the process; each where programs look for it."""
    found = topics(flight)
    assert found[Topic.TICK] == found[Topic.OBSERVATION] == found[Topic.POSE] == 100
    assert found[Topic.DEPTH] == found[Topic.CALIBRATION] == 25
    assert found[Topic.SCAN] == 10
    assert found[Topic.PROCESS] >= 1
    lines = [log_line(entry) for entry in open_recording(flight).entries() if entry.topic == Topic.LOG]
    assert [(line.name, line.text) for line in lines] == [("engaged", "exploring"), ("mode", "the start -> R3")]


def test_schemas_are_those_that_foxglove_and_rerun_know(flight: Path) -> None:
    """A recording opens in other programs only under these names and encodings."""
    from mcap.reader import make_reader

    with flight.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    found = {
        channel.topic: (summary.schemas[channel.schema_id].name, channel.message_encoding)
        for channel in summary.channels.values()
    }
    assert found[Topic.POSE] == ("foxglove.PoseInFrame", "protobuf")
    assert found[Topic.DEPTH] == ("foxglove.RawImage", "protobuf")
    assert found[Topic.CALIBRATION] == ("foxglove.CameraCalibration", "protobuf")
    assert found[Topic.TRANSFORMS] == ("foxglove.FrameTransforms", "protobuf")
    assert found[Topic.SCAN] == ("foxglove.LaserScan", "protobuf")
    assert found[Topic.LOG] == ("foxglove.Log", "protobuf")
    assert found[Topic.TICK] == ("companion.Tick", "json")


def test_a_tick_says_how_old_its_inputs_were(flight: Path) -> None:
    """Ages count until the setpoint went out: 2 ms after the start of the tick."""
    tick, observation = next(open_recording(flight).observations())
    assert tick["depth_age_s"] == pytest.approx(0.102)
    assert tick["ranges_age_s"] == pytest.approx(0.052)
    assert tick["pose_age_s"] == pytest.approx(0.022)
    assert tick["ahead_m"] == 2.0
    assert (tick["speed_mps"], tick["climb_mps"], tick["yaw_rate_radps"]) == (0.4, 0.01, -0.2)
    assert (tick["mode"], tick["sent"], tick["d_m"], tick["h_m"], tick["missing"]) == ("R3", True, 1.0, 1.5, [])
    assert observation is not None
    assert observation.frame is not None
    np.testing.assert_array_equal(observation.frame.depth_m, make_frame(100.0).depth_m)


def test_info_comes_back(flight: Path) -> None:
    """Settings, seed and versions: without them nothing can be flown again or explained."""
    info = open_recording(flight).info
    assert (info.settings_yaml, info.rng_state) == (make_info().settings_yaml, make_info().rng_state)
    assert "mine-companion" in info.versions


def test_generator_of_another_kind_is_refused() -> None:
    """Its state could not be restored: better said before the flight than after."""
    from companion.recording import FlightInfo

    with pytest.raises(ValueError, match="MT19937"):
        FlightInfo.of(SETTINGS, np.random.Generator(np.random.MT19937(1)))


@given(
    t_s=anything,
    pose=poses,
    readings=st.lists(st.builds(RangeReading, st.sampled_from(Beam), anything, st.none() | anything, anything)),
    ranges_m=st.none() | st.lists(st.floats(0.0, width=64) | st.just(math.nan), min_size=2, max_size=5),
    framed=st.booleans(),
)
def test_observations_come_back_to_the_last_bit(
    t_s: float, pose: Pose, readings: list[RangeReading], ranges_m: list[float] | None, framed: bool
) -> None:
    """NaN, infinities, denormals and -0.0 too: replay is exact only if this is."""
    import json

    camera = Camera(3, 2, 1.0 / 3.0, 2.0, 1.0, 0.5, 0.25, 10.0, mount_pitch_rad=-0.1)
    depth = np.ones((2, 3), np.float32)
    scan = None
    if ranges_m is not None:
        scan = PlanarScan(100.0 / 3.0, np.linspace(-1.0, 1.0 / 3.0, len(ranges_m)), np.array(ranges_m), 9.1, pose)
    frame = DepthFrame(t_s, depth, camera, pose) if framed else None
    observation = Observation(t_s, pose, frame, tuple(readings), scan)
    text = json.dumps(encode(observation, framed), allow_nan=False)
    back = decode(json.loads(text), depth)
    assert same(replace(back, planar=None), replace(observation, planar=None))
    if scan is not None:
        assert back.planar is not None
        np.testing.assert_array_equal(back.planar.bearings_rad, scan.bearings_rad)
        np.testing.assert_array_equal(back.planar.ranges_m, scan.ranges_m)


@given(text=st.text(max_size=200), name=st.text(max_size=20))
def test_wire_format_against_the_writer(text: str, name: str) -> None:
    """Our few lines read what the other side's library writes."""
    found = fields(Log(timestamp=Timestamp(5, 6), level=LogLevel.Warning, message=text, name=name).encode())
    assert (found.get(3, b""), found.get(4, b""), found[2]) == (text.encode(), name.encode(), 3)


@given(data=st.binary(max_size=60))
def test_wire_format_refuses_garbage(data: bytes) -> None:
    """Damage inside an image is a ValueError or a missing field, nothing else."""
    try:
        depth_image(data)
    except (ValueError, KeyError):
        return
    raise AssertionError("garbage was taken for an image")


def test_image_of_another_encoding_is_refused() -> None:
    """Millimetres taken for metres would be a wall a kilometre away."""
    image = RawImage(width=2, height=2, encoding="16UC1", step=4, data=bytes(8))
    with pytest.raises(ValueError, match="32-bit"):
        depth_image(image.encode())


def test_times_follow_the_application_not_the_wall_clock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the order of the file: NTP sets the clock back an hour in flight, and the record says so."""
    file, clock = tmp_path / "flight.mcap", HandClock(50.0)
    began_ns = time.time_ns()
    with recorder_of(file, clock) as recorder:
        for n in range(60):
            clock.time_s = 50.0 + n / 20.0
            recorder.tick(make_tick(clock.time_s))
            written(recorder)
            if n == 30:
                monkeypatch.setattr(time, "time_ns", lambda: began_ns - 3_600_000_000_000)
            time.sleep(0.025)
    recording = open_recording(file)
    times = [entry.t_ns for entry in recording.entries() if entry.topic == Topic.TICK]
    assert np.diff(times).tolist() == pytest.approx([50_000_000] * 59, abs=2)
    steps = [entry.json()["wall_clock_steps_s"] for entry in recording.entries() if entry.topic == Topic.PROCESS]
    assert steps[-1] == pytest.approx(-3600.0, abs=10.0)


def test_a_tick_without_a_pose_leaves_a_gap(tmp_path: Path) -> None:
    """There is nothing in it that could be flown again, and the numbers of the ticks must not say that one is lost."""
    file = tmp_path / "flight.mcap"
    with recorder_of(file) as recorder:
        for tick in (make_tick(1.0), replace(make_tick(1.05), observation=None, measurement=None), make_tick(1.1)):
            recorder.tick(tick)
    assert recorder.problem is None
    numbers = [entry.json()["number"] for entry in open_recording(file).entries() if entry.topic == Topic.TICK]
    assert numbers == [0, 1]


@pytest.mark.parametrize("t_s", [math.nan, math.inf, -math.inf, 1e300])
def test_a_stamp_that_is_no_time_ends_nothing(tmp_path: Path, t_s: float) -> None:
    """A wrong stamp from outside must not overflow the file's times and with that end the recording."""
    file = tmp_path / "flight.mcap"
    seen, _ = make_tick(1.0, frame=make_frame(1.0)).known()
    seen = replace(seen, pose=replace(seen.pose, t_s=t_s, yaw_rad=math.nan))
    bad = replace(make_tick(1.0), observation=seen)
    with recorder_of(file) as recorder:
        recorder.tick(bad)
        recorder.tick(replace(bad, observation=replace(seen, t_s=t_s)))
        recorder.tick(make_tick(2.0))
    assert recorder.problem is None
    assert topics(file)[Topic.TICK] == 3


# Never in the way.


def test_recording_blocks_for_less_than_5_ms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the loop that flies, with 640 x 480 images: the handing over, and the interpreter's lock.

    The native writer holds that lock while it works, so its work on one tick, in processor time of all its threads,
    bounds how long the loop may wait for it. The clock on the wall would measure who else uses this machine.
    """
    camera = replace(SETTINGS.sensors.camera.model(), width_px=640, height_px=480)
    frame = make_frame(1.0, camera)
    handed, held = [], []

    def timed(method: Callable[..., None]) -> Callable[..., None]:
        def call(*arguments: object) -> None:
            began = time.process_time()
            method(*arguments)
            held.append(time.process_time() - began)

        return call

    for name in ("tick", "now_and_then"):
        monkeypatch.setattr(Writing, name, timed(getattr(Writing, name)))
    monkeypatch.setattr(writing_module, "FLUSH_S", 0.0)  # every chunk is finished at once, as seldom happens
    with recorder_of(tmp_path / "flight.mcap") as recorder:
        for n in range(40):
            began = time.thread_time()
            recorder.tick(make_tick(n / 20.0, frame=frame))
            handed.append(time.thread_time() - began)
            written(recorder)
    assert recorder.problem is None
    assert recorder.frames_dropped == 0
    assert len(held) >= 80
    assert np.percentile(handed, 90) < 0.001
    assert np.percentile(held, 90) < 0.005


def test_a_slow_disk_costs_images_first_then_ticks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is unbounded and nothing waits: what finds no room is counted."""
    import threading

    go = threading.Event()
    write = RecordingFile.write

    def slow(self: RecordingFile, data: bytes) -> int:
        go.wait(20.0)
        return write(self, data)

    monkeypatch.setattr(RecordingFile, "write", slow)
    with recorder_of(tmp_path / "flight.mcap") as recorder:
        began = time.perf_counter()
        for n in range(record_module.WAITING + 100):
            recorder.tick(make_tick(n / 20.0, frame=make_frame(n / 20.0) if n < 20 else None))
        took_s = time.perf_counter() - began
        # One item at most has been taken out of the queue.
        assert 99 <= recorder.ticks_dropped <= 100
        assert 20 - record_module.FRAMES_WAITING - 1 <= recorder.frames_dropped <= 20 - record_module.FRAMES_WAITING
        go.set()
    assert took_s < 2.0
    assert recorder.problem is None
    recording = open_recording(tmp_path / "flight.mcap")
    assert sum(entry.topic == Topic.TICK for entry in recording.entries()) >= record_module.WAITING
    assert recording.damage is None


def test_a_disk_that_hangs_does_not_hold_the_end_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process must end though the disk does not answer."""
    import threading

    go = threading.Event()
    write = RecordingFile.write
    monkeypatch.setattr(RecordingFile, "write", lambda self, data: (go.wait(20.0), write(self, data))[1])
    monkeypatch.setattr(record_module, "CLOSE_S", 0.2)
    began = time.perf_counter()
    recorder = recorder_of(tmp_path / "flight.mcap")
    with recorder:
        thread = recorder._thread
    assert time.perf_counter() - began < 2.0
    assert "longer than 0.2 s" in (recorder.problem or "")
    go.set()
    assert thread is not None
    thread.join(10.0)
    assert not thread.is_alive()


def test_full_disk_stops_the_recording_with_one_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The flight goes on; what is on the disk by then is readable."""

    class Full:
        """A file on a disk with room for 300 kB."""

        def __init__(self, path: Path) -> None:
            self.file = path.open("xb", buffering=0)
            self.left = 300_000

        def write(self, data: memoryview) -> int:
            if self.left == 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            part = min(len(data), self.left)
            self.left -= part
            return self.file.write(data[:part]) or 0

        def fileno(self) -> int:
            return self.file.fileno()

        def close(self) -> None:
            self.file.close()

    def full(self: RecordingFile, path: Path, largest_bytes: float) -> None:
        self._file, self.problem, self.size, self.limit = Full(path), None, 0, largest_bytes  # type: ignore[assignment]

    monkeypatch.setattr(RecordingFile, "__init__", full)
    path = tmp_path / "flight.mcap"
    with caplog.at_level(logging.WARNING):
        recorder = record(path, 20.0)
    warnings = [r.getMessage() for r in caplog.records if r.name.startswith("companion")]
    assert warnings == [recorder.problem]
    assert "No space left on device" in warnings[0]
    recording = open_recording(path)
    assert 10 < sum(entry.topic == Topic.TICK for entry in recording.entries()) < 400
    assert recording.damage is not None


@pytest.mark.parametrize("where", ["a file/flight.mcap", "there.mcap"])
def test_unwritable_place_does_not_end_the_flight(tmp_path: Path, where: str, caplog: pytest.LogCaptureFixture) -> None:
    """A folder that cannot be made, a file that is there already and must not be overwritten."""
    (tmp_path / "a file").write_text("x")
    (tmp_path / "there.mcap").write_text("x")
    with caplog.at_level(logging.WARNING), recorder_of(tmp_path / where) as recorder:
        recorder.tick(make_tick(0.0))
        recorder.event("x", "y")
        assert not recorder.recording
    assert recorder.problem is not None
    assert [r.getMessage() for r in caplog.records] == [recorder.problem]
    assert (tmp_path / "there.mcap").read_text() == "x"


def test_an_error_of_our_own_does_not_end_the_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bug in an encoder ends the recording, says so, and leaves a readable file."""

    def broken(*_: object) -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr("companion.recording.channels.Channels.scan", broken)
    recorder = record(tmp_path / "flight.mcap", 1.0)
    assert "a bug" in (recorder.problem or "")
    assert topics(tmp_path / "flight.mcap")[Topic.TICK] == 1


def test_switched_off_it_makes_no_file(tmp_path: Path) -> None:
    """``record.enabled: false`` is no error."""
    with recorder_of(tmp_path / "x" / "f.mcap", enabled=False) as recorder:
        recorder.tick(make_tick(0.0))
    assert recorder.problem is None
    assert list(tmp_path.iterdir()) == []


def test_size_is_limited_and_images_go_first(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Protects the disk, on which the map still has to be written."""
    path, clock = tmp_path / "flight.mcap", HandClock(0.0)
    camera = replace(SETTINGS.sensors.camera.model(), width_px=320, height_px=240)
    frame = make_frame(0.0, camera)
    with caplog.at_level(logging.WARNING), recorder_of(path, clock, largest_mb=10.0) as recorder:
        for n in range(2000):
            clock.time_s = n / 20.0
            # Images fill the first 8 MB, a long log the rest.
            recorder.tick(make_tick(clock.time_s, frame=frame if n < 60 else None))
            if n >= 60:
                recorder.event("long", "x" * 9000)
            written(recorder)
    assert "limit of 10 MB" in (recorder.problem or "")
    assert 9.0e6 < path.stat().st_size <= 10.0e6
    recording = open_recording(path)
    entries = [(entry.topic, entry) for entry in recording.entries()]
    assert recording.damage is None
    images = sum(topic == Topic.DEPTH for topic, _ in entries)
    assert images + recorder.frames_dropped == 60
    assert 20 <= images < 40  # 8 MB of 307 kB
    last = log_line([entry for topic, entry in entries if topic == Topic.LOG][-1])
    assert last.name == "recording"
    assert last.text.startswith("stopped")
    texts = [log_line(entry).text for topic, entry in entries if topic == Topic.LOG]
    assert sum("no depth images from here on" in text for text in texts) == 1
    assert len(caplog.records) == 2


def test_disk_with_little_room_lowers_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The map comes first: 200 MB of the disk are not ours."""
    usage = shutil.disk_usage(tmp_path)._replace(free=250_000_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    file = RecordingFile(tmp_path / "f.mcap", 4e9)
    file.close()
    assert file.limit == 50e6


# Files that end in the middle.

KILLED = """
import sys, time
from pathlib import Path
from companion.clock import MonotonicClock
from companion.config.mission import RecordSettings
from companion.recording import Recorder
from tests.recording.flights import make_frame, make_info, make_tick
clock = MonotonicClock()
with Recorder(Path(sys.argv[1]), RecordSettings(), make_info(), clock) as recorder:
    recorder.event("engaged", "exploring")
    n = 0
    while True:
        t_s = clock.now_s()
        recorder.tick(make_tick(t_s, frame=make_frame(t_s) if n % 4 == 0 else None))
        sys.stdout.write(f"{t_s!r}\\n")
        sys.stdout.flush()
        n += 1
        time.sleep(0.05)
"""


def test_killed_process_leaves_a_file_readable_to_the_last_second(tmp_path: Path) -> None:
    """The recording of a crash is the one that is needed most."""
    file = tmp_path / "flight.mcap"
    root = Path(__file__).parents[2]
    process = subprocess.Popen([sys.executable, "-c", KILLED, str(file)], stdout=subprocess.PIPE, text=True, cwd=root)
    try:
        assert process.stdout is not None
        for _ in range(60):
            last_s = float(process.stdout.readline())
    finally:
        process.send_signal(signal.SIGKILL)
        rest, _ = process.communicate()
    said = [float(line) for line in rest.splitlines()]
    last_s = max([last_s, *said])
    recording = open_recording(file)
    seen = [tick["t_s"] for tick, observation in recording.observations() if observation is not None]
    assert recording.damage is not None
    assert seen == sorted(seen)
    # Half a second to the next flush, and what the machine needs for it.
    assert last_s - seen[-1] < 1.5


def test_any_cut_and_any_damage_is_survived(flight: Path, tmp_path: Path) -> None:
    """A reader of crash recordings must not crash: it gives what is whole, or says that the file is none of ours."""
    content = flight.read_bytes()
    whole = sum(1 for _ in open_recording(flight).observations())
    chance = random.Random(1)  # noqa: S311 - damage, not a secret
    file = tmp_path / "cut.mcap"
    read = 0
    for n in range(60):
        damaged = bytearray(content)
        if n % 2:
            for _ in range(chance.randint(1, 5)):
                damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        else:
            del damaged[chance.randrange(len(damaged)) :]
        file.write_bytes(damaged)
        try:
            recording = open_recording(file)
        except InputError:
            continue
        got = sum(1 for _ in recording.observations())
        assert got <= whole
        assert got == whole or recording.damage is not None
        read += 1
    assert read > 30


@pytest.mark.parametrize("content", [b"", b"not a recording", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + bytes(50)])
def test_files_that_are_none_of_ours(tmp_path: Path, content: bytes) -> None:
    """Says which file, and what to give instead."""
    file = tmp_path / "other.mcap"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"other\.mcap: is no recording of a flight"):
        open_recording(file)


def test_missing_file_folder_and_newer_format(tmp_path: Path, flight: Path) -> None:
    """Each with its own reason."""
    with pytest.raises(InputError, match="no such file"):
        open_recording(tmp_path / "nothing.mcap")
    with pytest.raises(InputError, match="is a folder"):
        open_recording(tmp_path)
    content = flight.read_bytes()
    at = content.index(b"format\x01\x00\x00\x001") + len(b"format\x01\x00\x00\x00")
    (tmp_path / "newer.mcap").write_bytes(content[:at] + b"9" + content[at + 1 :])
    with pytest.raises(InputError, match="format 9 of a newer version"):
        open_recording(tmp_path / "newer.mcap")


# Processor and memory.


def test_load_of_this_process_and_its_children() -> None:
    """A second of work is a second of processor time, and a child's memory and time count as the child's."""
    meter = LoadMeter()
    assert meter.sample(0.0) == {}
    code = "x = bytearray(50_000_000)\nprint('ready', flush=True)\nwhile True: pass"
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None
        child.stdout.readline()
        began, used = time.monotonic(), time.process_time()
        meter.sample(began)
        while time.process_time() - used < 0.5:
            pass
        now = time.monotonic()
        load = meter.sample(now)
    finally:
        child.kill()
        child.communicate()
    # Counted in hundredths of a second.
    assert load["cpu_share"] == pytest.approx(0.5 / (now - began), abs=0.05 / (now - began))
    assert load["children_cpu_share"] > 0.1
    assert load["children_memory_mb"] > 50.0
    assert load["memory_mb"] > 10.0


def test_mode_changes_are_events(tmp_path: Path) -> None:
    """Who reads the log must not search the curves for them."""
    file = tmp_path / "flight.mcap"
    with recorder_of(file) as recorder:
        for n, mode in enumerate((Mode.CIRCLE, Mode.CIRCLE, Mode.TANGENT, Mode.HOLD)):
            recorder.tick(make_tick(n / 20.0, mode=mode))
    lines = [log_line(entry).text for entry in open_recording(file).entries() if entry.topic == Topic.LOG]
    assert lines == ["the start -> R1", "R1 -> R2", "R2 -> hold"]
