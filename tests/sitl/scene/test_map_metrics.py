"""Completeness, precision and accuracy as METHOD defines them, and what the default sensor model reaches."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.mapping import VoxelMap
from sitl.scene.visibility import accuracy_m, precision
from tests.mapping.voxels.scenes import camera, frame, pose, room_depth


def completeness(voxels: VoxelMap, points_m: NDArray[np.float64]) -> float:
    """The share of points (n, 3) within one voxel of an occupied voxel."""
    return float(np.mean(voxels.occupied_near(points_m)))


def test_precision_counts_up_to_one_voxel() -> None:
    """Protects the definition: exactly one voxel away still counts."""
    assert precision(np.array([0.0, 0.05, 0.1, 0.11]), 0.1) == 0.75


def test_accuracy_is_the_mean() -> None:
    """Protects the definition, in m."""
    assert accuracy_m(np.array([0.0, 0.1, 0.2])) == pytest.approx(0.1)


def test_nothing_has_no_measure() -> None:
    """Protects reports of an empty map: not known is NaN, neither 0 % nor 100 %."""
    empty = np.zeros(0)
    assert math.isnan(precision(empty, 0.1))
    assert math.isnan(accuracy_m(empty))
    assert completeness(VoxelMap(MapSettings()), np.zeros((5, 3))) == 0.0


def test_completeness_is_within_one_voxel() -> None:
    """Protects the definition: points one voxel beside an occupied one count, points two beside it do not."""
    voxels = VoxelMap(MapSettings())
    wall = frame(camera(), pose(), 2.05)
    voxels.integrate(wall)
    voxels.integrate(wall)
    points = np.array([[x, 0.05, 0.05] for x in (1.85, 1.95, 2.05, 2.15, 2.25)])
    assert completeness(voxels, points) == pytest.approx(3 / 5)


def test_the_defaults_see_a_noisy_tunnel() -> None:
    """Protects the choice of the sensor model: noise of 0.002 z², 2 % dropouts, pose noise of 1 cm and 0.2°.

    Completeness must pass 99 %, which ends a flight (METHOD, t_f), of what is seen well: at 3 m and nearer. Precision
    must stay above 95 %: at 6 m 17 % of the readings are more than a voxel off (7.2 cm standard deviation), and with
    OctoMap's probabilities it drops to 90 % (see `MapSettings`).
    """
    low, high = np.array([-1.53, -2.04, -0.02]), np.array([12.07, 2.06, 3.03])
    cam = camera(160, 120)
    random = np.random.default_rng(3)
    voxels = VoxelMap(MapSettings())
    for x in np.arange(0.0, 8.0, 0.05):
        at = pose(x, 0.2 * math.sin(x), 1.5, yaw=0.5 * math.sin(2.0 * x))
        depth = room_depth(cam, at, low, high)
        depth += random.normal(size=depth.shape) * 0.002 * depth**2
        depth[random.random(depth.shape) < 0.02] = np.nan
        off, turn = random.normal(0.0, 0.01, 3), random.normal(0.0, math.radians(0.2), 3)
        estimated = pose(
            at.x_m + off[0], at.y_m + off[1], at.z_m + off[2], yaw=at.yaw_rad + turn[0], pitch=turn[1], roll=turn[2]
        )
        voxels.integrate(frame(cam, estimated, depth))

    # The walls, floor and roof that the camera passes at less than 3 m, with 45° to either side.
    along = random.uniform(3.0, 10.0, 40_000)
    sides = np.stack([along, np.where(along > 6.5, low[1], high[1]), random.uniform(low[2], high[2], 40_000)], axis=1)
    flat = np.stack([along, random.uniform(low[1], high[1], 40_000), np.where(along > 6.5, low[2], high[2])], axis=1)
    assert completeness(voxels, np.concatenate([sides, flat])) >= 0.99

    occupied = voxels.occupied()
    inwards = np.minimum(occupied - low, high - occupied).min(axis=1)
    outwards = np.linalg.norm(np.maximum(np.maximum(low - occupied, occupied - high), 0.0), axis=1)
    off_m = np.where(inwards >= 0.0, inwards, outwards)
    assert precision(off_m, voxels.voxel_m) >= 0.95
    # The centre of a voxel that a plane crosses is on average a quarter of a voxel off it: 2.5 cm. Noise adds to it.
    assert 0.02 < accuracy_m(off_m) < 0.05
