"""What a planar scanner's turn puts into the map."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from companion.config.mapping import MapSettings
from companion.mapping import FREE, OCCUPIED, UNKNOWN, VoxelMap
from companion.model import FloatArray, PlanarScan, Pose
from tests.mapping.voxels.scenes import EXACT, contents, pose

FULL_TURN = np.linspace(-math.pi, math.pi, 720, endpoint=False)
AT = pose(0.013, 0.021, 0.047)


def turn(
    ranges_m: FloatArray | float, at: Pose = AT, bearings: FloatArray = FULL_TURN, max_m: float = 8.0
) -> PlanarScan:
    """One turn with these ranges, or the same range everywhere."""
    return PlanarScan(0.0, bearings, np.broadcast_to(np.asarray(ranges_m, np.float64), bearings.shape), max_m, at)


def test_a_round_room_is_free_inside_and_occupied_at_its_wall() -> None:
    """Protects the three states around a scanner: free up to the wall, occupied at it, unknown behind and above it."""
    voxels = VoxelMap(EXACT)
    report = voxels.integrate_scan(turn(3.0))
    assert (report.pixels_hit, report.pixels_clear, report.pixels_invalid) == (720, 0, 0)
    centre = np.array([AT.x_m, AT.y_m, AT.z_m])
    wall = 3.0 * np.stack([np.cos(FULL_TURN), np.sin(FULL_TURN), np.zeros(720)], axis=1) + centre
    assert (voxels.classify(wall) == OCCUPIED).all()
    inside = wall * (0.9, 0.9, 1.0)
    assert (voxels.classify(inside) == FREE).all()
    assert (voxels.classify(wall * (1.1, 1.1, 1.0)) == UNKNOWN).all()
    assert (voxels.classify(inside + np.array([0.0, 0.0, 0.15])) == UNKNOWN).all()


@settings(max_examples=60, deadline=None)
@given(st.floats(-math.pi, math.pi), st.floats(0.05, 4.9), st.floats(-3.0, 3.0), st.floats(-0.6, 0.6))
def test_a_beam_frees_what_it_passes_and_fills_where_it_ends(
    bearing: float, range_m: float, offset_m: float, tilt: float
) -> None:
    """Protects the traversal in every direction: each point of the beam lies in a voxel that is not unknown."""
    at = pose(offset_m, -offset_m / 3, 1.0 + offset_m / 7, yaw=0.3, pitch=tilt, roll=-tilt / 2)
    voxels = VoxelMap(EXACT)
    voxels.integrate_scan(turn(range_m, at, np.array([bearing])))
    direction = _turned(bearing, at)
    along = np.linspace(0.0, range_m, 400)[:, np.newaxis] * direction + (at.x_m, at.y_m, at.z_m)
    # Points within rounding of a voxel's face may lie on its other side.
    clear = np.abs(along / EXACT.voxel_m - np.round(along / EXACT.voxel_m)).min(axis=1) > 1e-9
    assume(clear[0] and clear[-1])
    assert (voxels.classify(along[clear]) != UNKNOWN).all()
    counts = voxels.counts()
    assert counts.occupied == 1
    # No voxel twice, and none beside it: as many as there are faces between the two ends.
    ends = np.floor(along[[0, -1]] / EXACT.voxel_m)
    assert counts.free == np.abs(ends[1] - ends[0]).sum()


def _turned(bearing: float, at: Pose) -> FloatArray:
    """The beam's direction by hand: about x, then y, then z."""
    x, y, z = math.cos(bearing), math.sin(bearing), 0.0
    y, z = math.cos(at.roll_rad) * y - math.sin(at.roll_rad) * z, math.sin(at.roll_rad) * y + math.cos(at.roll_rad) * z
    x, z = (
        math.cos(at.pitch_rad) * x + math.sin(at.pitch_rad) * z,
        math.cos(at.pitch_rad) * z - math.sin(at.pitch_rad) * x,
    )
    return np.array(
        [math.cos(at.yaw_rad) * x - math.sin(at.yaw_rad) * y, math.sin(at.yaw_rad) * x + math.cos(at.yaw_rad) * y, z]
    )


def test_beams_that_say_nothing_change_nothing() -> None:
    """Protects "missing is not zero": NaN, zero and negative ranges neither free nor fill a voxel."""
    voxels = VoxelMap(EXACT)
    report = voxels.integrate_scan(turn(np.resize([math.nan, 0.0, -1.0, -math.inf], 720)))
    assert contents(voxels) == {}
    assert (report.hits, report.misses, report.pixels_hit + report.pixels_clear, report.pixels_invalid) == (
        0,
        0,
        0,
        720,
    )


@pytest.mark.parametrize(("map_m", "scanner_m"), [(3.0, 8.0), (5.0, 3.0)], ids=["map's limit", "scanner's limit"])
@pytest.mark.parametrize("range_m", [3.0, 4.0, math.inf])
def test_at_the_limit_free_up_to_it_and_no_hit(map_m: float, scanner_m: float, range_m: float) -> None:
    """Protects the range limits: a range at or beyond the nearer one frees the space up to there, nothing more."""
    voxels = VoxelMap(EXACT.model_copy(update={"max_range_m": map_m}))
    report = voxels.integrate_scan(turn(range_m, pose(0.05, 0.05, 0.05), np.array([0.0]), scanner_m))
    assert (report.hits, report.pixels_clear) == (0, 1)
    assert voxels.free()[:, 0].max() == pytest.approx(2.95)
    assert voxels.classify(np.array([[2.95, 0.05, 0.05], [3.15, 0.05, 0.05]])).tolist() == [FREE, UNKNOWN]


def test_hits_win_over_misses_within_a_turn() -> None:
    """Protects walls that run along a beam: a hundred beams through a voxel do not outvote the one that ended there."""
    bearings = np.sort(np.append(np.linspace(-0.02, 0.02, 101), 0.0001))
    ranges_m = np.where(bearings == 0.0001, 2.0, 4.0)
    voxels = VoxelMap(EXACT)
    voxels.integrate_scan(turn(ranges_m, pose(0.05, 0.05, 0.05), bearings))
    assert voxels.classify(np.array([[2.05, 0.05, 0.05]])) == [OCCUPIED]


def test_a_turn_grows_the_table() -> None:
    """Protects growth in the middle of a turn: small voxels fill the first table many times over."""
    voxels = VoxelMap(MapSettings(voxel_m=0.02, max_range_m=20.0))
    report = voxels.integrate_scan(turn(18.0, max_m=30.0))
    assert report.chunks_new == voxels.counts().chunks > 1000
    assert report.misses == voxels.counts().free


@pytest.mark.parametrize(
    ("scan", "words"),
    [
        pytest.param(turn(2.0, pose(math.nan)), "pose", id="pose"),
        pytest.param(turn(2.0, bearings=np.array([0.0, math.nan])), "bearing", id="bearing"),
        pytest.param(PlanarScan(0.0, FULL_TURN, np.ones(3), 8.0, AT), "one of each", id="number"),
        pytest.param(turn(2.0, pose(900_000.0)), "outside the map", id="outside"),
    ],
)
def test_a_broken_turn_is_refused(scan: PlanarScan, words: str) -> None:
    """Protects the map from a broken estimate or driver: nothing of such a turn is taken."""
    voxels = VoxelMap(EXACT.model_copy(update={"voxel_m": 0.02}))
    with pytest.raises(ValueError, match=words):
        voxels.integrate_scan(scan)
    assert contents(voxels) == {}
