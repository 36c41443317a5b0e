"""What was seen while the vehicle turned on the spot: the camera looks at a quarter of the turn at a time. Pure."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.model import HIT, UNKNOWN, Pose, Scan


class Panorama:
    """The newest look at every direction, from one place."""

    def __init__(self) -> None:
        self._ranges_m = np.zeros(0)
        self._state = np.zeros(0, np.uint8)

    def begin(self) -> None:
        """Forget the last turn: the next look is the first from another place."""
        self._ranges_m, self._state = np.zeros(0), np.zeros(0, np.uint8)

    def see(self, scan: Scan, pose: Pose) -> None:
        """Keep what a sensor looks at just now."""
        bins = scan.bearings_rad.size
        if self._state.size != bins:
            self._ranges_m, self._state = np.zeros(bins), np.full(bins, UNKNOWN, np.uint8)
        ahead = _turned(np.arange(bins), pose.yaw_rad)
        looked = scan.fresh & (scan.state != UNKNOWN)
        self._ranges_m[ahead[looked]], self._state[ahead[looked]] = scan.ranges_m[looked], scan.state[looked]

    def scan(self, now: Scan, pose: Pose) -> Scan:
        """All of it about the present heading; rock that ``now`` remembers nearer stays."""
        if self._state.size != now.bearings_rad.size:
            return now
        ahead = _turned(np.arange(self._state.size), pose.yaw_rad)
        ranges_m, state = self._ranges_m[ahead].copy(), self._state[ahead].copy()
        nearer = (now.state == HIT) & ((state != HIT) | (now.ranges_m < ranges_m))
        taken = nearer | (state == UNKNOWN)
        ranges_m[taken], state[taken] = now.ranges_m[taken], now.state[taken]
        return Scan(now.bearings_rad, ranges_m, state, now.fresh)


def _turned(bins: NDArray[np.int64], yaw_rad: float) -> NDArray[np.int64]:
    """The bin of the world's bearings for each bin of the body's."""
    return (bins + round(yaw_rad / (2.0 * math.pi) * bins.size)) % bins.size
