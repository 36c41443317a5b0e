"""A straight ramp has no tangents: whatever sector of the image shows no ground, the slab stays on the ramp."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from companion.config.control import ControlSettings
from companion.control.edges import find_edges
from companion.model import Scan
from companion.perception.depth import Slab, look_ahead
from companion.perception.look import bin_bearings
from companion.perception.view import view_of
from tests.perception.scenes import AT_START, BINS, H_M, frame, ramp

LAW = ControlSettings()
SLAB = Slab(half_height_m=0.4, max_ground_slope=0.7)
PLACES = tuple(itertools.product((-3.0, -1.0, 1.0, 4.0), (-0.8, 0.0, 0.8), (-0.5, -0.25, 0.0, 0.25, 0.5)))
"""Before the ramp and on it, to either side of the middle, askew: x, y, yaw."""


def looks_with_edges(slope: float, half_width_m: float) -> int:
    """Of `PLACES`, where an edge is seen in a drift that is straight but for its slope."""
    rng = np.random.default_rng(1)
    found = 0
    for x_m, y_m, yaw_rad in PLACES:
        pose = replace(AT_START, x_m=x_m, y_m=y_m, z_m=slope * max(x_m, 0.0) + H_M, yaw_rad=yaw_rad, pitch_rad=0.05)
        image = frame(ramp(0.0, slope, half_width_m), pose)
        noise = rng.normal(0.0, 0.002, image.depth_m.shape) * image.depth_m**2
        image = replace(image, depth_m=(image.depth_m + noise).astype(np.float32))
        look, _ = look_ahead(view_of(image), image, H_M, SLAB, BINS)
        found += bool(find_edges(Scan(bin_bearings(BINS), look.ranges_m, look.state, look.covered), LAW))
    return found


@pytest.mark.parametrize("half_width_m", [2.0, 2.7])
@pytest.mark.parametrize("slope", [-0.15, 0.15, 0.25, -0.25, 0.35, -0.35])
def test_a_straight_ramp_shows_no_edge(slope: float, half_width_m: float) -> None:
    """Protects from a turn in the middle of a ramp: of 60 looks down one of 35 %, 18 showed a tangent.

    Down it, the foot of the wall beside lies where level ground would, and the roof ahead where a wall would. One look
    askew down the steepest, in the wider drift, still shows one.
    """
    assert looks_with_edges(slope, half_width_m) <= (slope == -0.35 and half_width_m > 2.0)
