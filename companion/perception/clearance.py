"""Free distance ahead within the width of the body, which the safety gate is sent with each setpoint."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.model import CLEAR, HIT, FloatArray, Scan

AHEAD_MARGIN_M = 0.1
"""Added to the body's radius on either side: less beside the propellers is no room to fly through."""

LOOK_M = 5.0
"""A bearing looks along the way when it is still within the width this far out: the bearings beside leave it sooner."""


def ahead_m(scan: Scan, half_width_m: float) -> float:
    """Least distance to an obstacle ahead, along the heading, from the centre of the body.

    Args:
        scan: N(t), remembered points included.
        half_width_m: obstacles further beside the heading than this are not in the way.

    Returns:
        The least x of the HIT bearings in the way, in m; infinite when what is known there is CLEAR; NaN when nothing
        is known there.
    """
    return float(_ahead(scan.bearings_rad, scan.ranges_m, scan.state, half_width_m))


@compiled
def _ahead(bearings: FloatArray, ranges: FloatArray, state: NDArray[np.uint8], half_width_m: float) -> float:
    least = math.nan
    for i in range(bearings.size):
        if abs(bearings[i]) >= np.pi / 2.0:
            continue
        beside = abs(np.sin(bearings[i]))
        # Written so that no range that is no number gets in.
        if state[i] == HIT and ranges[i] >= 0.0 and ranges[i] * beside < half_width_m:
            x = ranges[i] * np.cos(bearings[i])
            if not x >= least:
                least = x
        elif state[i] == CLEAR and min(ranges[i], LOOK_M) * beside < half_width_m and not least < np.inf:
            least = np.inf
    return least
