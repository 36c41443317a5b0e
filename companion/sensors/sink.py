"""The sink of the drivers: the newest reading of each stream and nothing older, from any thread."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from companion.clock import Clock
from companion.model import MOST_RAYS, Beam, Camera, FloatArray, RangeReading
from companion.sensors.statistics import Stream, StreamStatistics

DEPTH, PLANAR = "depth", "planar"
STREAMS = (DEPTH, *(beam.value for beam in Beam), PLANAR)
"""Names of the streams in `SensorSink.statistics`: each beam is a stream of its own."""

FUTURE_S = 0.1
"""A stamp further ahead of our clock than this is wrong: clocks that are aligned disagree by less."""

WIDEST = 20.0
"""Tangent of the angle between a camera's axis and the edge of its image: 87°."""
FARTHEST_MOUNT_M = 10.0
LONGEST_RANGE_M = 200.0
"""No depth camera sees further; maps of the ground ahead are as long."""

FROM_THE_FUTURE = "stamp from the future"
NOT_NEWER = "stamp not newer than the last"
NOT_A_TIME = "stamp is no finite number"
WRONG_SHAPE = "wrong shape"
WRONG_TYPE = "wrong type of number"
WRONG_CAMERA = "camera impossible"
WRONG_LIMIT = "range limit not positive"
WRONG_BEARINGS = "bearings not ascending in [-π, π)"
NOT_POSITIVE = "range or depth below zero, or depth of zero: missing is NaN or None"
NO_SURFACE = "shows no surface: nothing measured, too near, or all of it free"
FROZEN = "repeats an earlier one to the last bit though the vehicle has moved"

MOST_WARNINGS = 16
"""Wait to be told."""
SAMPLE_PX = 8
"""Of every eighth row every eighth pixel is looked at first: nearly always one of them shows a surface."""


@dataclass(frozen=True, slots=True)
class RawDepth:
    """A depth image before it has a pose; the fields mean what they mean in `companion.model.DepthFrame`."""

    t_s: float
    depth_m: NDArray[np.float32]
    camera: Camera


@dataclass(frozen=True, slots=True)
class RawPlanar:
    """A planar scan before it has a pose; the fields mean what they mean in `companion.model.PlanarScan`."""

    t_s: float
    bearings_rad: FloatArray
    ranges_m: FloatArray
    max_range_m: float


@dataclass(frozen=True, slots=True)
class Taken:
    """The newest of each stream since the sink was last emptied."""

    depth: RawDepth | None
    ranges: tuple[RangeReading, ...]
    planar: RawPlanar | None


class SensorSink:
    """Newest-only store between the drivers and the tick.

    No reading raises: one that cannot be right is refused and counted with its reason.
    Stamps are in seconds of ``clock``; each stream's stamps must rise. Arrays are handed over, not copied: a driver
    must not write to one that it has given away.

    Args:
        clock: the application's clock.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._streams = {name: Stream() for name in STREAMS}
        self._depth: RawDepth | None = None
        self._ranges: dict[Beam, RangeReading] = {}
        self._planar: RawPlanar | None = None
        self._warnings: deque[str] = deque(maxlen=MOST_WARNINGS)

    def depth(self, frame: RawDepth) -> None:
        """Offer a depth image: (height, width) of its camera, float32, all positive; NaN is missing, infinity free."""
        reason = _depth_problem(frame)
        with self._lock:
            if self._accepts(DEPTH, frame.t_s, reason):
                self._depth = frame

    def ranges(self, readings: Sequence[RangeReading]) -> None:
        """Offer readings of single beams. NaN counts as missing, infinity as free out to the range limit."""
        for reading in readings:
            reason = _range_problem(reading)
            with self._lock:
                if self._accepts(reading.beam.value, reading.t_s, reason):
                    self._ranges[reading.beam] = _normalized(reading)

    def planar(self, scan: RawPlanar) -> None:
        """Offer one turn of a planar scanner: bearings ascending in [-π, π); NaN is missing, infinity free."""
        reason = planar_problem(scan)
        if reason is None and not np.any((scan.ranges_m > 0.0) & (scan.ranges_m < scan.max_range_m)):
            reason = NO_SURFACE
        with self._lock:
            if self._accepts(PLANAR, scan.t_s, reason):
                bearings_rad = np.asarray(scan.bearings_rad, np.float64)
                ranges_m = np.minimum(scan.ranges_m, scan.max_range_m, dtype=np.float64)
                self._planar = replace(scan, bearings_rad=bearings_rad, ranges_m=ranges_m)

    def drop(self, stream: str, reason: str) -> None:
        """Count a reading that was refused elsewhere: by its driver, or for the pose at its time.

        Args:
            stream: one of `STREAMS`.
            reason: why, in a few fixed words: only the first 16 different ones of a stream are told apart.
        """
        with self._lock:
            self._streams[stream].refuse(reason)

    def warn(self, text: str) -> None:
        """Have operator and pilot told something of the sensors; the pilot reads 50 characters of it."""
        with self._lock:
            self._warnings.append(text)

    def warnings(self) -> list[str]:
        """What there is to tell since the last call."""
        with self._lock:
            taken = list(self._warnings)
            self._warnings.clear()
        return taken

    def take(self) -> Taken:
        """The newest of each stream since the last call, each handed out once."""
        with self._lock:
            taken = Taken(self._depth, tuple(self._ranges.values()), self._planar)
            self._depth, self._ranges, self._planar = None, {}, None
        return taken

    def statistics(self, now_s: float) -> dict[str, StreamStatistics]:
        """Rate, age and refusals of each of `STREAMS` at ``now_s``."""
        with self._lock:
            return {name: stream.statistics(now_s) for name, stream in self._streams.items()}

    def _accepts(self, name: str, t_s: float, reason: str | None) -> bool:
        """Whether to keep it, and the count of it either way; called under the lock."""
        stream, now_s = self._streams[name], self._clock.now_s()
        if reason is None and t_s > now_s + FUTURE_S:
            reason = FROM_THE_FUTURE
        if reason is None and t_s <= stream.newest_s:
            reason = NOT_NEWER
        if reason is not None:
            stream.refuse(reason)
            return False
        stream.accept(t_s, now_s)
        return True


def _is_number(value: object) -> bool:
    # A float of 32 bits is none: as a stamp it would be off by milliseconds after some hours.
    return isinstance(value, float | int) and not isinstance(value, bool)


def _is_finite(value: object) -> bool:
    return isinstance(value, float | int) and _is_number(value) and math.isfinite(value)


def _is_limit(value: object) -> bool:
    return isinstance(value, float | int) and _is_finite(value) and value > 0.0


def _is_image(value: object, shape: tuple[int, int]) -> bool:
    return isinstance(value, np.ndarray) and value.shape == shape


def _is_line(value: object) -> bool:
    return isinstance(value, np.ndarray) and value.ndim == 1 and 0 < value.size <= MOST_RAYS


def _depth_problem(frame: RawDepth) -> str | None:
    depth, camera = frame.depth_m, frame.camera
    if not _is_finite(frame.t_s):
        return NOT_A_TIME
    if not is_possible(camera):
        return WRONG_CAMERA
    if not _is_image(depth, (camera.height_px, camera.width_px)):
        return WRONG_SHAPE
    if depth.dtype != np.float32:
        return WRONG_TYPE
    # fmin passes NaN over: an image without a single measurement has a NaN for its least, which compares false.
    if np.fmin.reduce(depth, axis=None) <= 0.0:
        return NOT_POSITIVE
    return None if _shows_surface(depth, camera) else NO_SURFACE


def _shows_surface(depth_m: NDArray[np.float32], camera: Camera) -> bool:
    """Whether one pixel at least has measured something.

    Underground something is always in view, the floor if nothing else. A camera that shows nothing is covered, blinded
    or broken, and one cannot tell from its images that there is free space ahead: they are no look at all. Where it is
    so wide that it is the truth, there is no wall to follow either.
    """

    def shows(part_m: NDArray[np.float32]) -> bool:
        return bool(np.any((part_m >= camera.min_range_m) & (part_m < camera.max_range_m)))

    return shows(depth_m[::SAMPLE_PX, ::SAMPLE_PX]) or shows(depth_m)


def is_possible(camera: Camera) -> bool:
    """Whether there is such a camera: one that is not would make the ground ahead, cut into cells, of any size."""
    if not all(_is_finite(value) for value in astuple(camera)):
        return False
    if camera.width_px <= 0 or camera.height_px <= 0 or camera.fx_px <= 0.0 or camera.fy_px <= 0.0:
        return False
    edges = (
        camera.cx_px / camera.fx_px,
        (camera.width_px - camera.cx_px) / camera.fx_px,
        camera.cy_px / camera.fy_px,
        (camera.height_px - camera.cy_px) / camera.fy_px,
    )
    mount_m = (camera.mount_x_m, camera.mount_y_m, camera.mount_z_m)
    return (
        all(abs(tangent) <= WIDEST for tangent in edges)
        and all(abs(along_m) <= FARTHEST_MOUNT_M for along_m in mount_m)
        and max(abs(camera.mount_yaw_rad), abs(camera.mount_pitch_rad)) <= 2.0 * math.pi
        and 0.0 <= camera.min_range_m < camera.max_range_m <= LONGEST_RANGE_M
    )


def _range_problem(reading: RangeReading) -> str | None:
    range_m = reading.range_m
    if not _is_finite(reading.t_s):
        return NOT_A_TIME
    if not _is_limit(reading.max_range_m):
        return WRONG_LIMIT
    if range_m is None:
        return None
    if not _is_number(range_m):
        return WRONG_TYPE
    return NOT_POSITIVE if range_m < 0.0 else None


def _normalized(reading: RangeReading) -> RangeReading:
    if reading.range_m is None or math.isfinite(reading.range_m):
        return reading
    return replace(reading, range_m=None if math.isnan(reading.range_m) else reading.max_range_m)


def planar_problem(scan: RawPlanar) -> str | None:
    """Why a scan cannot be right; None when it can."""
    bearings, ranges = scan.bearings_rad, scan.ranges_m
    if not _is_finite(scan.t_s):
        return NOT_A_TIME
    if not _is_limit(scan.max_range_m):
        return WRONG_LIMIT
    if not _is_line(bearings) or not _is_line(ranges) or bearings.size != ranges.size:
        return WRONG_SHAPE
    if bearings.dtype.kind != "f" or ranges.dtype.kind != "f":
        return WRONG_TYPE
    # Written so that a NaN among the bearings fails.
    if not (bearings[0] >= -math.pi and bearings[-1] < math.pi and bool(np.all(np.diff(bearings) > 0.0))):
        return WRONG_BEARINGS
    return NOT_POSITIVE if np.fmin.reduce(ranges) < 0.0 else None
