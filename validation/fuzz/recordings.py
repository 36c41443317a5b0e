"""Recordings that are cut, spoiled, or whole files that say nonsense: refused or read in part, never more."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import random
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from companion.config.mission import RecordSettings
from companion.errors import InputError
from companion.model import Beam, DepthFrame, Observation, PlanarScan, Pose, RangeReading
from companion.pipeline import Explorer, Tick
from companion.recording import FlightInfo, Recorder, open_recording
from companion.recording.content import ENDED, ENGAGED, Topic
from companion.recording.flight_stats import figures, render
from companion.recording.replay import replay
from tests.shared.clocks import HandClock
from validation.fuzz.flying import CAMERA, SETTINGS, WALL_M
from validation.fuzz.hostile import extreme, no_number, spoiled_json, spoiled_often

TICKS = 24


@functools.cache
def whole() -> bytes:
    """A short flight along a wall, as the recorder writes it."""
    with tempfile.TemporaryDirectory() as folder:
        file, clock = Path(folder) / "flight.mcap", HandClock()
        rng = np.random.default_rng(1)
        info = FlightInfo.of(SETTINGS, rng)
        explorer = Explorer(SETTINGS, rng)
        with Recorder(file, RecordSettings(), info, clock) as recorder:
            recorder.event(ENGAGED, "exploring")
            for i in range(TICKS):
                clock.advance(0.05)
                seen = _observation(clock.time_s, i)
                steering = explorer.step(seen)
                mode = explorer.navigator.status.mode
                measurement, setpoint = steering.measurement, steering.setpoint
                recorder.tick(Tick(clock.time_s, seen, measurement, setpoint, mode, True, 1.5, 0.001, stepped=True))
                while recorder.recording and recorder.waiting > 2:
                    time.sleep(0.0005)  # much faster than real time, for which the queue is made
            recorder.event(ENDED, "complete")
        assert recorder.problem is None
        assert recorder.frames_dropped == recorder.ticks_dropped == 0
        return file.read_bytes()


def _observation(t_s: float, i: int) -> Observation:
    pose = Pose(t_s, 0.02 * i, 0.0, 1.5, 0.0)
    depth_m = np.full((CAMERA.height_px, CAMERA.width_px), WALL_M, np.float32)
    planar = PlanarScan(t_s, np.linspace(-3.0, 3.0, 30), np.full(30, WALL_M), 12.0, pose)
    reading = RangeReading(Beam.DOWN, t_s, 1.5, 8.0)
    return Observation(t_s, pose, DepthFrame(t_s, depth_m, CAMERA, pose), (reading,), planar if i % 3 == 0 else None)


@functools.cache
def records() -> tuple[Any, ...]:
    """What the flight consists of."""
    return tuple(StreamReader(io.BytesIO(whole())).records)


def bytes_spoiled(rng: random.Random) -> None:
    """Cut anywhere, damaged anywhere."""
    read_all(spoiled_often(rng, whole()))


def packed_spoiled(rng: random.Random) -> None:
    """As other writers pack: compressed, without checksums; then damaged."""
    packed = rewritten(rng, share=0.0, compression=rng.choice(list(CompressionType)))
    read_all(spoiled_often(rng, packed))


def content_spoiled(rng: random.Random) -> None:
    """A file in order, whose messages are not."""
    read_all(rewritten(rng, share=rng.choice((0.01, 0.1)), compression=CompressionType.NONE))


def rewritten(rng: random.Random, share: float, compression: CompressionType) -> bytes:
    """The flight written again, with a share of its messages spoiled, and then also its description."""
    out = io.BytesIO()
    checked = rng.random() < 0.5
    writer = Writer(out, chunk_size=20_000, compression=compression, enable_crcs=checked, enable_data_crcs=checked)
    writer.start()
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    topics: dict[int, str] = {}
    for record in records():
        if isinstance(record, Metadata):
            spoil = share and rng.random() < 0.3
            writer.add_metadata(record.name, _metadata(rng, record.metadata) if spoil else record.metadata)
        elif isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in channels:
            topics[record.id] = record.topic
            channels[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schemas[record.schema_id]
            )
        elif isinstance(record, Message):
            data = record.data
            if rng.random() < share:
                data = _message(rng, topics[record.channel_id], data)
            for _ in range(rng.choice((0, 2)) if rng.random() < 0.1 * share else 1):
                writer.add_message(channels[record.channel_id], record.log_time, data, record.publish_time)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def _metadata(rng: random.Random, metadata: dict[str, str]) -> dict[str, str]:
    spoiled = dict(metadata)
    name = rng.choice(list(spoiled))
    way = rng.randrange(4)
    if way == 0:
        del spoiled[name]
    elif way == 1:
        spoiled[name] = rng.choice(("", "nan", "inf", "-1", "[]", "3", "null", "{}", "9" * 400, "[" * 5000, '{"a": 1}'))
    elif name in ("navigator_rng", "versions"):
        spoiled[name] = json.dumps(spoiled_json(rng, json.loads(spoiled[name])))
    else:
        spoiled[name] = spoiled_often(rng, spoiled[name].encode()).decode("utf-8", "replace")
    return spoiled


def _message(rng: random.Random, topic: str, data: bytes) -> bytes:
    if topic not in (Topic.TICK, Topic.OBSERVATION, Topic.PROCESS) or rng.random() < 0.1:
        return spoiled_often(rng, data)
    found = spoiled_json(rng, json.loads(data))
    if isinstance(found, dict) and found and rng.random() < 0.3:
        key = rng.choice(list(found))
        found[key] = extreme(rng, 1.0) if rng.random() < 0.5 else no_number(rng)
    return json.dumps(found, default=str).encode()


def read_all(data: bytes) -> None:
    """Everything that reads recordings, on this file."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "flight.mcap"
        file.write_bytes(data)
        for use in (_figures, replay, _observations):
            with contextlib.suppress(InputError):
                use(file)


def _figures(file: Path) -> None:
    found = figures(file)
    json.dumps(asdict(found)).encode()
    render(found).encode()


def _observations(file: Path) -> None:
    for _ in open_recording(file).observations():
        pass
