"""Pictures in which nothing has an echo: the lamp has failed, or a dark wall stands so near that it fills them."""

from __future__ import annotations

import math

import numpy as np

from companion.model import HIT, UNKNOWN, DepthFrame, Scan
from companion.perception.look import Look
from companion.perception.view import View

DARK_S = 10.0
"""A dark wall fills the picture for no longer than it takes to turn away: half a turn takes 5 s at the usual yaw rate.
Then it is not known any more whether the camera works at all."""

FOOT_SHARE = 1.1
"""A wall is so near that its foot is out of the picture up to so much of that distance: the last rows that show
something are too few to be a look, and the wall was taken to stand before the last of the floor that was seen."""

COVERS_M = 0.25
"""A remembered point covers so much to either side: no body of ours fits between two that are twice as far apart."""


def is_filled_by_wall(view: View, scan: Scan, h_m: float) -> bool:
    """Whether a wall that is remembered stands so near before the camera, and so wide, that it fills the picture.

    Where this is so a dark picture is what had to be expected of a wall without echo; a lamp that fails leaves the
    drift ahead open, and nothing explains the picture.

    Args:
        view: the picture, levelled; what it shows does not matter.
        scan: what is remembered about the place from which it was taken.
        h_m: height above ground there.
    """
    middle = view.left.size // 2
    lowest = view.to_level @ np.array([1.0, view.left[middle], view.up[-1]])
    falls = -float(lowest[2]) / math.hypot(lowest[0], lowest[1])
    if falls <= 0.0:
        return False
    foot_m = FOOT_SHARE * (h_m + float(view.offset_m[2])) / falls
    axis, leftmost, rightmost = (
        math.atan2(ray[1], ray[0])
        for ray in (view.to_level @ np.array([1.0, view.left[at], 0.0]) for at in (middle, 0, -1))
    )
    aside_rad = np.mod(scan.bearings_rad - axis + np.pi, 2.0 * np.pi) - np.pi
    in_view = aside_rad[(aside_rad <= _off(leftmost, axis)) & (aside_rad >= _off(rightmost, axis))]
    near = (scan.state == HIT) & (np.abs(aside_rad) < np.pi / 2.0) & (scan.ranges_m * np.cos(aside_rad) <= foot_m)
    covers_rad = np.arctan2(COVERS_M, scan.ranges_m[near])
    covered = np.abs(in_view[:, None] - aside_rad[near][None, :]) <= covers_rad[None, :]
    return bool(covered.any(axis=1).all())


def dark_look(frame: DepthFrame, bins: int) -> Look:
    """The look of a picture that shows nothing: it was made, and covers no bearing."""
    pose, nowhere = frame.pose, np.zeros(bins, np.bool_)
    unknown = np.full(bins, UNKNOWN, np.uint8)
    limit_m = frame.camera.max_range_m
    return Look(frame.t_s, pose.x_m, pose.y_m, pose.yaw_rad, np.zeros(bins), unknown, nowhere, limit_m, nowhere)


def _off(bearing_rad: float, axis_rad: float) -> float:
    return math.remainder(bearing_rad - axis_rad, 2.0 * math.pi)
