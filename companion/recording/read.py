"""Reading a recording, also one that ends in the middle: what is whole is given, the rest is left."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from mcap.records import Attachment, Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray

from companion.errors import InputError
from companion.mapping.files.ground_file import GROUND_NAME
from companion.model import Observation
from companion.recording import observation as observations
from companion.recording.content import FORMAT, METADATA, FlightInfo, Topic

LARGEST_RECORD = 1 << 28
"""Longer records are damage, and must not take all memory."""

_DAMAGE = (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError)
"""What comes of the content of a file that is cut or damaged: none of these comes from a whole one."""


_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_LONGEST_VARINT = 10


class DamageError(ValueError):
    """The file cannot be read any further."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One message of a recording.

    Attributes:
        topic: its channel.
        t_ns: its time in the file, in ns since 1970.
        data: its bytes.
    """

    topic: str
    t_ns: int
    data: bytes

    def json(self) -> dict[str, Any]:
        """The message of a JSON channel.

        Raises:
            ValueError: it is none.
        """
        found = json.loads(self.data)
        if not isinstance(found, dict):
            raise ValueError(f"{self.topic}: not a JSON object")
        return found


@dataclass(frozen=True, slots=True)
class LogLine:
    """An event of the flight."""

    t_ns: int
    name: str
    text: str


class Recording:
    """A recording on the disk. Read it as often as needed; nothing of it is kept in memory.

    Attributes:
        path: the file.
        info: what is known of the flight.
        wall_ns, start_s: wall clock and the application's clock at the start.
        share_read: how much of the file was read, 0 to 1.
        damage: why the file could not be read to its end; ``None`` before it was, and when it ends as it should.
    """

    def __init__(self, path: Path, metadata: dict[str, str], known_ground: bytes) -> None:
        self.path = path
        self.info = FlightInfo(
            settings_yaml=metadata["settings"],
            rng_state=metadata["navigator_rng"],
            vehicle_id=int(metadata["vehicle_id"]),
            versions={str(name): str(text) for name, text in json.loads(metadata["versions"]).items()},
            known_ground=known_ground,
        )
        self.wall_ns = int(metadata["wall_ns_at_start"])
        self.start_s = float(metadata["clock_s_at_start"])
        if not abs(self.wall_ns) < 1 << 63 or not math.isfinite(self.start_s):
            raise ValueError("the start is at no possible time")
        self.share_read = 0.0
        self.damage: str | None = None

    def entries(self) -> Iterator[Entry]:
        """Every message in the order in which it was written, up to the end or the damage."""
        channels: dict[int, str] = {}
        self.damage = None
        with self.path.open("rb") as stream:
            size_bytes = max(os.fstat(stream.fileno()).st_size, 1)
            records = _records(stream)
            while True:
                # Only the reading is guarded: what the caller does with an entry keeps its own errors.
                try:
                    record = next(records, None)
                    if isinstance(record, Channel):
                        channels[record.id] = record.topic
                    topic = channels[record.channel_id] if isinstance(record, Message) else ""
                except DamageError as error:
                    self.damage = str(error)
                    return
                except KeyError as error:
                    self.damage = f"a message of channel {error}, which is not there"
                    return
                if record is None:
                    return
                if isinstance(record, Message):
                    self.share_read = stream.tell() / size_bytes
                    yield Entry(topic, record.log_time, record.data)

    def observations(self) -> Iterator[tuple[dict[str, Any], Observation | None]]:
        """Each tick as recorded, with the observation that it had.

        The observation is ``None`` where a depth image was seen but is not in the file.
        """
        depth_m: NDArray[np.float32] | None = None
        observation: Observation | None = None
        for entry in self.entries():
            try:
                if entry.topic == Topic.DEPTH:
                    depth_m = depth_image(entry.data)
                elif entry.topic == Topic.OBSERVATION:
                    data = entry.json()
                    frame = data["frame"]
                    lost = frame is not None and not frame["recorded"]
                    observation = None if lost else observations.decode(data, depth_m)
                    depth_m = None
                elif entry.topic == Topic.TICK:
                    tick = entry.json()
                else:
                    continue
            except _DAMAGE as error:
                self.damage = f"{entry.topic}: {error}"
                return
            if entry.topic == Topic.TICK:
                yield tick, observation


def open_recording(path: Path) -> Recording:
    """A recording of ours.

    Raises:
        InputError: the file cannot be read, is none of ours, or of a format that this version does not know.
    """
    metadata: dict[str, str] | None = None
    known_ground = b""
    try:
        with path.open("rb") as stream:
            metadata, known_ground = _front(stream)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; check the path") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; give the .mcap file in it") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if metadata is None:
        raise InputError(
            f"{path}: is no recording of a flight, or was cut at its very beginning; give an .mcap file that "
            "`companion run` wrote"
        )
    try:
        known = int(metadata["format"]) <= FORMAT
        recording = Recording(path, metadata, known_ground)
    except _DAMAGE:
        raise InputError(f"{path}: its description of the flight is damaged; nothing can be made of it") from None
    if not known:
        raise InputError(
            f"{path}: format {metadata['format']} of a newer version; this one reads up to {FORMAT}: update it"
        )
    return recording


def _front(stream: IO[bytes]) -> tuple[dict[str, str] | None, bytes]:
    """What stands before every message: our metadata, None where there is none, and the ground that was gone on from.

    Raises:
        OSError: the file cannot be read.
    """
    metadata: dict[str, str] | None = None
    known_ground = b""
    try:
        for record in _records(stream):
            if isinstance(record, Message):
                break
            if isinstance(record, Metadata) and record.name == METADATA:
                metadata = record.metadata
            elif isinstance(record, Attachment) and record.name == GROUND_NAME:
                known_ground = record.data
    except DamageError:
        # A flight that was cut so early may still be named.
        pass
    return metadata, known_ground


def depth_image(data: bytes) -> NDArray[np.float32]:
    """The (height, width) depth in m of a recorded RawImage.

    Raises:
        ValueError, KeyError: it is none, or not of 32-bit floats.
    """
    image = fields(data)
    width, height, encoding, pixels = image[2], image[3], image[4], image[6]
    if encoding != b"32FC1" or not isinstance(pixels, bytes) or isinstance(width, bytes) or isinstance(height, bytes):
        raise ValueError("not a depth image of 32-bit floats")
    return np.frombuffer(pixels, np.dtype("<f4")).reshape(height, width).astype(np.float32)


def log_line(entry: Entry) -> LogLine:
    """An entry of the log.

    Raises:
        ValueError: it is none.
    """
    found = fields(entry.data)
    text, name = found.get(3, b""), found.get(4, b"")
    if not isinstance(text, bytes) or not isinstance(name, bytes):
        raise ValueError("not a line of the log")
    return LogLine(entry.t_ns, name.decode(), text.decode())


def fields(message: bytes) -> dict[int, int | bytes]:
    """The fields of a Protocol Buffers message, by number.

    Integers are as they are, fixed 32 and 64 bit unsigned, the rest bytes; of a repeated field only the last is kept.

    Raises:
        ValueError: this is no such message, or it is cut.
    """
    found: dict[int, int | bytes] = {}
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        kind = tag & 7
        if kind == _VARINT:
            found[tag >> 3], at = _varint(message, at)
            continue
        if kind == _BYTES:
            length, at = _varint(message, at)
        elif kind in (_FIXED32, _FIXED64):
            length = 4 if kind == _FIXED32 else 8
        else:
            raise ValueError(f"wire type {kind} at byte {at}")
        if at + length > len(message):
            raise ValueError(f"field {tag >> 3} is cut")
        part = message[at : at + length]
        found[tag >> 3] = part if kind == _BYTES else int.from_bytes(part, "little")
        at += length
    return found


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = 0
    for n, byte in enumerate(message[at : at + _LONGEST_VARINT]):
        value |= (byte & 0x7F) << (7 * n)
        if byte < 0x80:
            return value, at + n + 1
    raise ValueError(f"number at byte {at} is cut")


def _records(stream: IO[bytes]) -> Iterator[Any]:
    """The records up to the end, or a DamageError."""
    records = iter(StreamReader(stream, validate_crcs=True, record_size_limit=LARGEST_RECORD).records)
    while True:
        try:
            record = next(records, None)
        except Exception as error:
            raise DamageError(f"{type(error).__name__} {error}".strip()) from error
        if record is None:
            return
        yield record
