"""The messages of the sensor stream, and how each is read from its header and payload."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.model import MOST_RAYS, Beam, Camera, RangeReading
from companion.sensors.sink import RawPlanar

MOST_READINGS = 64
"""Readings in one message."""


class Kind(enum.IntEnum):
    """The kinds of messages, as numbered on the wire."""

    CAMERA = 1
    DEPTH = 2
    RANGES = 3
    PLANAR = 4
    PING = 5
    PONG = 6


@dataclass(frozen=True, slots=True)
class DepthImage:
    """A depth image of the camera that was announced last: (height, width) float32, stamped by the sender's clock."""

    t_s: float
    depth_m: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Ranges:
    """Readings of single beams, stamped by the sender's clock."""

    readings: tuple[RangeReading, ...]


@dataclass(frozen=True, slots=True)
class Ping:
    """Asks the other end for its time; ``sent_s`` is that of the asking one."""

    sent_s: float


@dataclass(frozen=True, slots=True)
class Pong:
    """Answers a ping: the asker's time as it came, and the time of the answering end."""

    sent_s: float
    remote_s: float


Message = Camera | DepthImage | Ranges | RawPlanar | Ping | Pong

Bytes = NDArray[np.uint8]
Pending = tuple[int, Callable[[Bytes], Message]]
"""The payload bytes that belong to a header, and the function that makes the message of them."""


def _number(header: Mapping[str, Any], name: str) -> float:
    value = header[name]
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{name} is no finite number")
    return float(value)


def _count(header: Mapping[str, Any], name: str, most: int) -> int:
    value = header[name]
    if isinstance(value, bool) or not isinstance(value, int) or not 0 < value <= most:
        raise ValueError(f"{name} is no whole number from 1 to {most}")
    return value


def _read_camera(header: Mapping[str, Any]) -> Pending:
    values: dict[str, Any] = {
        field.name: _count(header, field.name, 65535) if field.type == "int" else _number(header, field.name)
        for field in fields(Camera)
    }
    camera = Camera(**values)
    return 0, lambda _: camera


def _read_depth(header: Mapping[str, Any]) -> Pending:
    t_s, width, height = _number(header, "t_s"), _count(header, "width_px", 65535), _count(header, "height_px", 65535)
    return 4 * width * height, lambda raw: DepthImage(t_s, raw.view("<f4").reshape(height, width))


def _read_ranges(header: Mapping[str, Any]) -> Pending:
    readings = header["readings"]
    if not isinstance(readings, list) or len(readings) > MOST_READINGS:
        raise ValueError(f"readings is no list of at most {MOST_READINGS}")
    ranges = Ranges(tuple(_read_reading(reading) for reading in readings))
    return 0, lambda _: ranges


def _read_reading(reading: Mapping[str, Any]) -> RangeReading:
    range_m = None if reading["range_m"] is None else _number(reading, "range_m")
    return RangeReading(Beam(reading["beam"]), _number(reading, "t_s"), range_m, _number(reading, "max_range_m"))


def _read_planar(header: Mapping[str, Any]) -> Pending:
    t_s, rays, max_range_m = _number(header, "t_s"), _count(header, "rays", MOST_RAYS), _number(header, "max_range_m")

    def finish(raw: Bytes) -> Message:
        numbers = raw.view("<f8")
        return RawPlanar(t_s, numbers[:rays], numbers[rays:], max_range_m)

    return 16 * rays, finish


def _read_ping(header: Mapping[str, Any]) -> Pending:
    ping = Ping(_number(header, "sent_s"))
    return 0, lambda _: ping


def _read_pong(header: Mapping[str, Any]) -> Pending:
    pong = Pong(_number(header, "sent_s"), _number(header, "remote_s"))
    return 0, lambda _: pong


READERS: Mapping[int, Callable[[Mapping[str, Any]], Pending]] = {
    Kind.CAMERA: _read_camera,
    Kind.DEPTH: _read_depth,
    Kind.RANGES: _read_ranges,
    Kind.PLANAR: _read_planar,
    Kind.PING: _read_ping,
    Kind.PONG: _read_pong,
}
"""The reader of each kind of header; raises ValueError, TypeError, KeyError or OverflowError for a wrong one."""
