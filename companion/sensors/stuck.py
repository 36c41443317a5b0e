"""Frozen sensors: fresh stamps on old data.

A sensor that repeats itself to the last bit while the vehicle stands may be right: simulated ones without noise do. One
that does so while the vehicle moves shows the past as the present, and the law would fly by it into what has come into
view since.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.geometry import rotation
from companion.model import BEAM_AXES, Pose, RangeReading, wrap_rad

MOVED_M, TURNED_RAD = 0.05, math.radians(2.0)
"""No camera sees the same to the last bit after this: 5 cm ahead are 5 cm of every depth, 5 cm aside are 3 pixels of
640 at 5 m, 2° are 12."""

MOVED_ALONG_M, REPEATED_S = 0.3, 1.0
"""A beam that measures in centimetres may well repeat a reading a few times; not after moving this far along it, and
not for this long."""

WINDOW_S = 5.0
"""Only what moved within this time counts: the estimate of a vehicle that stands on the ground drifts."""

REMEMBERED = 4
"""Images that a new one is compared with: a driver may hand out the same few buffers in turn."""

STRIDE = 97
"""Of an image so much as every 97th pixel is compared first; a prime number, so that they are not all in one column."""


class _FirstSeen:
    """When and where a value was first seen, and whether it has been repeated elsewhere since: then it is frozen."""

    def __init__(self, pose: Pose, t_s: float) -> None:
        self.frozen = False
        self.since_s, self.pose = t_s, pose

    def repeated(self, pose: Pose, t_s: float, is_elsewhere: bool) -> bool:
        """Whether it is frozen, now that it came again; it stays so until another value comes.

        Otherwise it would be believed again because the vehicle stopped for it.
        """
        self.frozen = self.frozen or is_elsewhere
        if not self.frozen and t_s - self.since_s > WINDOW_S:
            self.since_s, self.pose = t_s, pose
        return self.frozen


class FrozenImages:
    """Detects depth images, or scans, that repeat one of the last few although the vehicle has moved."""

    def __init__(self) -> None:
        self._seen: deque[tuple[NDArray[Any], _FirstSeen]] = deque(maxlen=REMEMBERED)

    def repeats(self, values: NDArray[np.floating], pose: Pose) -> bool:
        """Whether this image is an old one.

        Args:
            values: of any shape; kept, so it must not be written to any more.
            pose: from where it was taken, as far as its stamp can be believed.
        """
        if np.isnan(values).all():
            # Nothing measured is nothing old: a lens before black rock sees the same wherever it turns.
            return False
        # As whole numbers: a NaN is equal to itself then.
        bits = values.reshape(-1).view(f"u{values.itemsize}")
        for seen, first in self._seen:
            if np.array_equal(bits[::STRIDE], seen[::STRIDE]) and np.array_equal(bits, seen):
                return first.repeated(pose, pose.t_s, _has_moved(first.pose, pose))
        self._seen.append((bits, _FirstSeen(pose, pose.t_s)))
        return False


class FrozenBeam:
    """Detects that one beam repeats itself although the vehicle has moved along it."""

    def __init__(self) -> None:
        self._range_m: float | None = None
        self._first: _FirstSeen | None = None

    def repeats(self, reading: RangeReading, pose: Pose) -> bool:
        """Whether this reading is an old one. Free out to the limit may rightly come again and again.

        Args:
            reading: of the beam.
            pose: where the vehicle is, about when it was read.
        """
        if reading.range_m is None:
            return self._first is not None and self._first.frozen
        if self._first is None or reading.range_m != self._range_m or reading.range_m >= reading.max_range_m:
            self._range_m, self._first = reading.range_m, _FirstSeen(pose, reading.t_s)
            return False
        first = self._first
        along = rotation(pose.yaw_rad, pose.pitch_rad, pose.roll_rad) @ BEAM_AXES[reading.beam]
        moved_m = abs(float(along @ _offset_m(first.pose, pose)))
        is_elsewhere = reading.t_s - first.since_s > REPEATED_S and moved_m > MOVED_ALONG_M
        return first.repeated(pose, reading.t_s, is_elsewhere)


def _offset_m(start: Pose, end: Pose) -> NDArray[np.float64]:
    """(3,) from one to the other."""
    return np.array([end.x_m - start.x_m, end.y_m - start.y_m, end.z_m - start.z_m])


def _has_moved(start: Pose, end: Pose) -> bool:
    if float(np.linalg.norm(_offset_m(start, end))) > MOVED_M:
        return True
    turned_rad = (
        wrap_rad(end.yaw_rad - start.yaw_rad),
        wrap_rad(end.pitch_rad - start.pitch_rad),
        wrap_rad(end.roll_rad - start.roll_rad),
    )
    return max(abs(angle_rad) for angle_rad in turned_rad) > TURNED_RAD
