"""The wire format of the sensor stream, used by both ends.

A message is a prefix of 16 bytes (magic, version, kind, length of header and payload, CRC-32), a header in JSON and,
for depth and planar scans, raw little-endian numbers. Everything has a largest size. Streams come over TCP or Unix
sockets, which neither lose nor swap bytes: what does not parse is another program or another version, and the
connection is of no more use. So there is no looking for the next magic, which may well occur inside a depth image.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.errors import CompanionError
from companion.model import MOST_RAYS, Camera, FloatArray, RangeReading
from companion.sensors.drivers.messages import MOST_READINGS, READERS, Bytes, Kind, Message, Ping, Pong

MAGIC = b"\x8eCSS"
VERSION = 1
LARGEST_PAYLOAD_BYTES = 64_000_000
LARGEST_HEADER_BYTES = 16_384

_PREFIX = struct.Struct("<4sBBHI")
_CRC = struct.Struct("<I")
PREFIX_BYTES = _PREFIX.size + _CRC.size


class FramingError(CompanionError):
    """The bytes of the stream are not of this format; the connection has to be closed."""


def encode_camera(camera: Camera) -> bytes:
    """The camera that takes the depth images which follow."""
    return _encode(Kind.CAMERA, asdict(camera))


def encode_depth(t_s: float, depth_m: NDArray[np.float32]) -> bytes:
    """A depth image of shape (height, width), in m along the optical axis.

    Raises:
        ValueError: not two-dimensional float32, larger than 64 MB, or a stamp that is no number.
    """
    if depth_m.ndim != 2 or depth_m.dtype != np.float32:
        raise ValueError(f"a depth image is a 2D array of float32, not {depth_m.ndim}D of {depth_m.dtype}")
    height, width = depth_m.shape
    payload = np.ascontiguousarray(depth_m, "<f4")
    return _encode(Kind.DEPTH, {"t_s": t_s, "width_px": width, "height_px": height}, payload.data)


def encode_ranges(readings: Sequence[RangeReading]) -> bytes:
    """Up to 64 readings of single beams. JSON knows no NaN and no infinity: missing, and free out to the limit.

    Raises:
        ValueError: too many of them, or a stamp or limit that is no number.
    """
    if len(readings) > MOST_READINGS:
        raise ValueError(f"{len(readings)} readings in one message; at most {MOST_READINGS}")
    return _encode(
        Kind.RANGES,
        {
            "readings": [
                {"beam": r.beam.value, "t_s": r.t_s, "range_m": _plain(r), "max_range_m": r.max_range_m}
                for r in readings
            ]
        },
    )


def encode_planar(t_s: float, bearings_rad: FloatArray, ranges_m: FloatArray, max_range_m: float) -> bytes:
    """One turn of a planar scanner.

    Raises:
        ValueError: bearings and ranges differ in shape, or a stamp or limit that is no number.
    """
    if bearings_rad.ndim != 1 or bearings_rad.shape != ranges_m.shape or bearings_rad.size > MOST_RAYS:
        raise ValueError(f"bearings {bearings_rad.shape} and ranges {ranges_m.shape} must be 1D and of one length")
    payload = np.concatenate([bearings_rad, ranges_m]).astype("<f8", copy=False)
    return _encode(Kind.PLANAR, {"t_s": t_s, "rays": bearings_rad.size, "max_range_m": max_range_m}, payload.data)


def encode_ping(ping: Ping) -> bytes:
    """A question for the other end's time."""
    return _encode(Kind.PING, asdict(ping))


def encode_pong(pong: Pong) -> bytes:
    """The answer to a ping."""
    return _encode(Kind.PONG, asdict(pong))


def _plain(reading: RangeReading) -> float | None:
    if reading.range_m is None or math.isnan(reading.range_m):
        return None
    return reading.max_range_m if reading.range_m == math.inf else reading.range_m


def _encode(kind: Kind, header: Mapping[str, Any], payload: memoryview | bytes = b"") -> bytes:
    size = memoryview(payload).nbytes
    if size > LARGEST_PAYLOAD_BYTES:
        raise ValueError(f"a payload of {size} bytes; at most {LARGEST_PAYLOAD_BYTES}")
    text = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
    prefix = _PREFIX.pack(MAGIC, VERSION, kind, len(text), size)
    return b"".join((prefix, _CRC.pack(zlib.crc32(text, zlib.crc32(prefix))), text, payload))


class Decoder:
    """Turns bytes, in pieces of any length, into messages.

    Made for `asyncio.BufferedProtocol`: the socket writes where the message will stay (`get_buffer`), so a depth image
    is never copied once it has left the kernel. `feed` does the same with bytes that are there already.

    Args:
        largest_payload_bytes: messages with more are refused before anything is reserved for them.
    """

    def __init__(self, largest_payload_bytes: int = LARGEST_PAYLOAD_BYTES) -> None:
        self._largest_payload_bytes = largest_payload_bytes
        self._error: FramingError | None = None
        self._bytes: Bytes
        self._view: memoryview
        self._done: Callable[[Bytes], Message | None]
        self._expect(PREFIX_BYTES, self._prefix)

    def get_buffer(self) -> memoryview:
        """Where the next bytes belong: at least one, never beyond the end of a message."""
        return self._view

    def received(self, count: int) -> Message | None:
        """Take note of bytes written to the buffer.

        Args:
            count: how many, at most the buffer's length.

        Returns:
            The message which they complete, or None.

        Raises:
            FramingError: this is not the stream's format. It stays so: every further call raises it again.
        """
        if self._error is not None:
            raise self._error
        self._view = self._view[count:]
        try:
            return None if self._view.nbytes else self._done(self._bytes)
        except FramingError as error:
            self._error = error
            raise

    def feed(self, data: bytes) -> Iterator[Message]:
        """The messages completed by ``data``, as they are asked for; raises FramingError as `received` does."""
        rest = memoryview(data)
        while rest.nbytes:
            count = min(rest.nbytes, self._view.nbytes)
            self._view[:count] = rest[:count]
            rest = rest[count:]
            message = self.received(count)
            if message is not None:
                yield message

    def _expect(self, size: int, done: Callable[[Bytes], Message | None]) -> None:
        # Empty, not zeroed: clearing 64 MB would hold the event loop up.
        self._bytes = np.empty(size, np.uint8)
        self._view = self._bytes.data
        self._done = done

    def _prefix(self, raw: Bytes) -> None:
        prefix = raw.tobytes()
        magic, version, kind, header_bytes, payload_bytes = _PREFIX.unpack_from(prefix)
        if magic != MAGIC:
            raise FramingError("the other end does not speak the sensor stream's format")
        if version != VERSION:
            raise FramingError(
                f"the other end speaks version {version} of the sensor stream, this one version {VERSION}: "
                "install the same release at both ends"
            )
        if kind not in READERS:
            raise FramingError(f"a message of unknown kind {kind}")
        if not 0 < header_bytes <= LARGEST_HEADER_BYTES or payload_bytes > self._largest_payload_bytes:
            raise FramingError(
                f"a message with {header_bytes} bytes of header and {payload_bytes} of payload; at most "
                f"{LARGEST_HEADER_BYTES} and {self._largest_payload_bytes} are taken"
            )

        def header(text: Bytes) -> Message | None:
            return self._header(Kind(kind), prefix, text.tobytes(), payload_bytes)

        self._expect(header_bytes, header)

    def _header(self, kind: Kind, prefix: bytes, text: bytes, payload_bytes: int) -> Message | None:
        (crc,) = _CRC.unpack_from(prefix, _PREFIX.size)
        if zlib.crc32(text, zlib.crc32(prefix[: _PREFIX.size])) != crc:
            raise FramingError("a message that was damaged on the way")
        try:
            header = json.loads(text)
            needed, finish = READERS[kind](header)
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
            raise FramingError(f"a {kind.name.lower()} message with a wrong header: {error!r:.120}") from error
        if needed != payload_bytes:
            raise FramingError(f"a {kind.name.lower()} message with {payload_bytes} bytes of payload, not {needed}")

        def payload(raw: Bytes) -> Message:
            self._expect(PREFIX_BYTES, self._prefix)
            return finish(raw)

        if not needed:
            return payload(np.empty(0, np.uint8))
        self._expect(needed, payload)
        return None
