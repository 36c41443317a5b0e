"""What fuzzing has found, each as the smallest case that showed it; and one short run of everything."""

from __future__ import annotations

import asyncio
import json
import logging
import math
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.autopilot.telemetry import Telemetry
from companion.autopilot.vehicle import Vehicle
from companion.errors import InputError
from companion.flight.events import EventEmitter
from companion.flight.mavlink_commands import MavlinkCommands, Refusals
from companion.flight.operator_commands import OperatorCommands
from companion.flight.phase import PhaseMachine
from companion.mavlink.ids import MavCmd
from companion.model import Camera
from companion.recording import open_recording
from companion.recording.content import METADATA
from companion.recording.flight_stats import figures
from companion.recording.replay import replay
from companion.sensors.drivers.mavlink import planar_scan
from companion.sensors.sink import DEPTH, WRONG_CAMERA, RawDepth, SensorSink
from tests.autopilot.fake_link import FakeLink
from tests.shared.beside import until
from tests.shared.clocks import HandClock
from validation.fuzz import datagrams, recordings
from validation.fuzz.flying import CAMERA, SETTINGS, flying
from validation.fuzz.targets import TARGETS, run

ARMED = {"base_mode": 128, "custom_mode": 4}


@pytest.mark.parametrize("spoiled", [{"base_mode": None}, {"base_mode": math.nan}, {"custom_mode": "4"}])
def test_a_heartbeat_that_cannot_be_read_does_not_end_the_flight(spoiled: dict[str, object]) -> None:
    """It was taken for that of a disarmed vehicle."""
    clock = HandClock()
    link = FakeLink(clock)
    telemetry = Telemetry(link, clock, SETTINGS)
    link.deliver("HEARTBEAT", ARMED)
    clock.advance(1.0)
    link.deliver("HEARTBEAT", ARMED | spoiled)
    state = telemetry.state(clock.now_s())
    assert state.armed
    assert state.heartbeat_age_s == 1.0


def test_a_mode_that_is_no_number_is_no_takeover() -> None:
    clock = HandClock()
    link = FakeLink(clock)
    vehicle = Vehicle(link, Telemetry(link, clock, SETTINGS), SETTINGS, clock)
    vehicle._modes._monitor.request(frozenset({4}))
    link.deliver("HEARTBEAT", ARMED)
    link.deliver("HEARTBEAT", ARMED | {"custom_mode": True})
    link.deliver("HEARTBEAT", ARMED | {"base_mode": False})
    assert not vehicle.taken_over
    link.deliver("HEARTBEAT", ARMED | {"custom_mode": 5})
    assert vehicle.taken_over


@pytest.mark.parametrize("text", ["\x1b[2Jcleared", "\ud800 half a letter", "two\r\nlines", "a" * 70_000])
def test_a_statustext_can_be_printed(text: str) -> None:
    """The operator's terminal obeyed it; half a surrogate pair would have ended the loop that flies."""
    clock = HandClock()
    link = FakeLink(clock)
    telemetry = Telemetry(link, clock, SETTINGS)
    link.deliver("STATUSTEXT", {"severity": 4, "text": text})
    (said,) = telemetry.texts
    assert said.text.isprintable()
    assert 0 < len(said.text) <= 200


def test_a_number_too_large_for_a_float_is_none(caplog: pytest.LogCaptureFixture) -> None:
    """It raised out of `Telemetry.state`, and so out of the loop that flies."""
    clock = HandClock()
    link = FakeLink(clock)
    telemetry = Telemetry(link, clock, SETTINGS)
    link.deliver("SYS_STATUS", {"battery_remaining": 10**400})
    link.deliver("ATTITUDE", dict.fromkeys(("time_boot_ms", "roll", "pitch", "yaw", "yawspeed"), 10**400))
    link.deliver("TIMESYNC", {"tc1": 10**400, "ts1": 1})
    assert telemetry.state(clock.now_s()).battery_percent is None
    assert telemetry.malformed == 1
    assert not caplog.records


def test_a_pose_of_long_ago_is_no_pose() -> None:
    """The buffer took it while it was empty, for one that had only just been measured in its own time."""
    clock = HandClock()
    link = FakeLink(clock)
    telemetry = Telemetry(link, clock, SETTINGS)
    attitude = dict.fromkeys(("roll", "pitch", "yaw", "yawspeed"), 0.0)
    position = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), 0.0)
    link.deliver("ATTITUDE", {"time_boot_ms": 60_000, **attitude})
    link.deliver("LOCAL_POSITION_NED", {"time_boot_ms": 10, **position})
    assert telemetry.poses.newest() is None
    assert telemetry.malformed == 1


@pytest.mark.parametrize(
    "fields", [{"param1": 10**400}, {"command": 300.0}, {"command": None}, {"target_system": True}]
)
def test_a_command_that_cannot_be_read_starts_nothing(fields: dict[str, Any], caplog: pytest.LogCaptureFixture) -> None:
    clock = HandClock()
    link = FakeLink(clock)
    operator = OperatorCommands(by_command=True, flight=PhaseMachine())
    MavlinkCommands(operator, link, Refusals(EventEmitter(), clock))
    told = {"target_system": 1, "target_component": 191, "command": MavCmd.MISSION_START, "param1": 0.0}
    link.deliver("COMMAND_LONG", told | {"command": 193} | fields if "param1" in fields else told | fields, 255, 190)
    assert not operator.start.is_set()
    assert not operator.stop.is_set()
    assert not caplog.records


def test_sectors_of_no_width_are_no_scan_of_any_length() -> None:
    """360° by such a width overflowed."""
    fields = {"max_distance": 800, "frame": 12, "distances": [500] * 72, "increment_f": 1e-320}
    scan = planar_scan(fields, 1.0)
    assert scan is not None
    assert scan.bearings_rad.size <= 72
    assert planar_scan(fields | {"max_distance": 1e300}, 1.0) is None


@pytest.mark.parametrize(
    "change",
    [
        lambda camera: replace(camera, max_range_m=1e5),
        lambda camera: replace(camera, max_range_m=1e300),
        lambda camera: replace(camera, fx_px=1e-300),
        lambda camera: replace(camera, cx_px=1e9),
        lambda camera: replace(camera, mount_z_m=1e300),
        lambda camera: replace(camera, mount_pitch_rad=1e9),
    ],
)
def test_a_camera_that_cannot_be_is_refused(change: Callable[[Camera], Camera]) -> None:
    """Its range became the length of an array: the loop that flies ended for lack of memory."""
    clock = HandClock()
    sink = SensorSink(clock)
    depth_m = np.full((CAMERA.height_px, CAMERA.width_px), 4.0, np.float32)
    sink.depth(RawDepth(1.0, depth_m, change(CAMERA)))
    assert sink.take().depth is None
    assert sink.statistics(clock.now_s())[DEPTH].reasons == {WRONG_CAMERA: 1}
    sink.depth(RawDepth(1.0, depth_m, CAMERA))
    assert sink.take().depth is not None


async def test_mavsdk_prints_nothing_of_what_strangers_say(
    capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    """A STATUSTEXT of another system that is no UTF-8 was printed as it came, with whatever it does to a terminal."""
    with caplog.at_level(logging.DEBUG):
        async with datagrams.line() as here:
            rng = random.Random(1)  # noqa: S311 - a fixed seed
            frame = datagrams.packed(rng, "STATUSTEXT", b"\x04\x1b[2J\xff\xfe stranger", 77, 1)
            for _ in range(5):
                here.autopilot.raw(frame)
            heartbeat = here.autopilot._out.heartbeat_encode(2, 12, 81, 0, 3).pack(
                mavlink.MAVLink(None, srcSystem=77, srcComponent=1)
            )
            here.autopilot.raw(bytes(heartbeat))
            await asyncio.sleep(0.1)
            here.autopilot.raw(frame)
            await until(lambda: "stranger" in caplog.text)
    out, err = capfd.readouterr()
    assert "stranger" not in out + err
    assert "log callback" not in out + err
    assert "\x1b[2J" not in "".join(record.getMessage() for record in caplog.records)


TICK: dict[str, object] = {"t_s": 1.0, "sent": True, "mode": "hold", "d_m": [1], "duration_s": "long"}
TICK |= dict.fromkeys(("depth_age_s", "ranges_age_s", "pose_age_s"), 10**400)


def written(file: Path, metadata: dict[str, str], compression: CompressionType = CompressionType.NONE) -> Path:
    """A recording with nothing in it but its description and one tick of another writer."""
    known = next(r.metadata for r in recordings.records() if getattr(r, "name", "") == METADATA)
    with file.open("wb") as stream:
        writer = Writer(stream, compression=compression, enable_crcs=False, enable_data_crcs=False)
        writer.start()
        writer.add_metadata(METADATA, known | metadata)
        channel = writer.register_channel("/tick", "json", 0)
        writer.add_message(channel, 1, json.dumps(TICK).encode(), 1)
        writer.finish()  # type: ignore[no-untyped-call]
    return file


@pytest.mark.parametrize(
    "metadata",
    [{"versions": "[]"}, {"versions": "[" * 5000}, {"clock_s_at_start": "nan"}, {"wall_ns_at_start": "9" * 400}],
)
def test_a_damaged_description_is_said_to_be_one(metadata: dict[str, str], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="description"):
        open_recording(written(tmp_path / "flight.mcap", metadata))


@pytest.mark.parametrize("number", [10**400, -(10**30), "1", None])
def test_a_generator_without_its_state_is_not_flown_again(number: object, tmp_path: Path) -> None:
    state = np.random.PCG64(1).state | {"has_uint32": number}
    with pytest.raises(InputError, match="generator"):
        replay(written(tmp_path / "flight.mcap", {"navigator_rng": json.dumps(state)}))


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_chunk_that_cannot_be_unpacked_is_damage(compression: CompressionType, tmp_path: Path) -> None:
    file = written(tmp_path / "flight.mcap", {}, compression)
    content = bytearray(file.read_bytes())
    name = compression.name.lower().encode()
    at = content.index(name) + len(name) + 8
    content[at + 4 : at + 24] = b"\xff" * 20
    file.write_bytes(content)
    assert figures(file).damage is not None


def test_a_tick_whose_numbers_are_none_is_damage(tmp_path: Path) -> None:
    """It passed, and broke the sums at the end."""
    assert figures(written(tmp_path / "flight.mcap", {})).damage is not None


async def test_what_flies_is_what_is_fuzzed() -> None:
    """The vehicle of these tests does fly: without that, silence would prove nothing."""
    async with flying() as bench:
        moving = 0
        for _ in range(40):
            bench.step()
            bench.step()
            record = bench.tick()
            moving += record.sent and bench.moves(record.setpoint)
        assert moving > 30


# Garbage, old and foreign messages, bytes and files: nothing crashes, nothing moves. Longer: `__main__`.


@pytest.mark.parametrize("name", TARGETS)
def test_it_survives(name: str) -> None:
    """The same cases every time; one that fails names its seed: `python -m validation.fuzz --only NAME --seed SEED`."""
    for seed in range(TARGETS[name].count):
        try:
            run(name, seed)
        except Exception as error:
            error.add_note(f"python -m validation.fuzz --only {name} --seed {seed} --seconds 0")
            raise
