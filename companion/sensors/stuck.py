"""Sensors that stand still: fresh stamps on an old word.

Who repeats himself to the last bit while the vehicle stands may be right: simulated sensors without noise do. Who does
it while the vehicle moves shows the past as the present, and the law would fly by it into what came into view since.
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
"""A beam that measures in centimetres may well say the same a few times; not after moving this far along it, and not
for this long."""

WINDOW_S = 5.0
"""Only what moved within this time counts: the estimate of a vehicle that stands on the ground drifts."""

REMEMBERED = 4
"""Pictures that a new one is compared with: a driver may hand out the same few buffers in turn."""

STRIDE = 97
"""Of an image so much as every 97th pixel is compared first; a prime number, so that they are not all in one column."""


class _Said:
    """When and where something was said first, and whether it has been repeated elsewhere."""

    def __init__(self, pose: Pose, t_s: float) -> None:
        self.frozen = False
        self.since_s, self.pose = t_s, pose

    def again(self, pose: Pose, t_s: float, is_elsewhere: bool) -> bool:
        """It was said again: whether it is believed no more, from now on and until something else is said.

        It must not be believed again because the vehicle stopped for it.
        """
        self.frozen = self.frozen or is_elsewhere
        if not self.frozen and t_s - self.since_s > WINDOW_S:
            self.since_s, self.pose = t_s, pose
        return self.frozen


class FrozenImages:
    """Finds depth images, or scans, that repeat one of the last few although the vehicle has moved."""

    def __init__(self) -> None:
        self._seen: deque[tuple[NDArray[Any], _Said]] = deque(maxlen=REMEMBERED)

    def repeats(self, values: NDArray[np.floating], pose: Pose) -> bool:
        """Whether this picture is an old one.

        Args:
            values: of any shape; kept, so it must not be written to any more.
            pose: from where it was taken, as far as its stamp can be believed.
        """
        # As whole numbers: a NaN is equal to itself then.
        bits = values.reshape(-1).view(f"u{values.itemsize}")
        for seen, said in self._seen:
            if np.array_equal(bits[::STRIDE], seen[::STRIDE]) and np.array_equal(bits, seen):
                return said.again(pose, pose.t_s, _has_moved(said.pose, pose))
        self._seen.append((bits, _Said(pose, pose.t_s)))
        return False


class FrozenBeam:
    """Finds out that one beam repeats itself although the vehicle has moved along it."""

    def __init__(self) -> None:
        self._range_m: float | None = None
        self._said: _Said | None = None

    def repeats(self, reading: RangeReading, pose: Pose) -> bool:
        """Whether this reading is an old one. Free out to the limit is said again and again, and rightly.

        Args:
            reading: of the beam.
            pose: where the vehicle is, about when it was read.
        """
        if reading.range_m is None:
            return self._said is not None and self._said.frozen
        if self._said is None or reading.range_m != self._range_m or reading.range_m >= reading.max_range_m:
            self._range_m, self._said = reading.range_m, _Said(pose, reading.t_s)
            return False
        said = self._said
        along = rotation(pose.yaw_rad, pose.pitch_rad, pose.roll_rad) @ BEAM_AXES[reading.beam]
        moved_m = abs(float(along @ _way_m(said.pose, pose)))
        is_elsewhere = reading.t_s - said.since_s > REPEATED_S and moved_m > MOVED_ALONG_M
        return said.again(pose, reading.t_s, is_elsewhere)


def _way_m(start: Pose, end: Pose) -> NDArray[np.float64]:
    """(3,) from one to the other."""
    return np.array([end.x_m - start.x_m, end.y_m - start.y_m, end.z_m - start.z_m])


def _has_moved(start: Pose, end: Pose) -> bool:
    if float(np.linalg.norm(_way_m(start, end))) > MOVED_M:
        return True
    turned_rad = (
        wrap_rad(end.yaw_rad - start.yaw_rad),
        wrap_rad(end.pitch_rad - start.pitch_rad),
        wrap_rad(end.roll_rad - start.roll_rad),
    )
    return max(abs(angle_rad) for angle_rad in turned_rad) > TURNED_RAD
