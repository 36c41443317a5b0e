"""What `bench.map.truth` compares."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.map.truth import CASES, DRIFT_SHARE, Scene, measured, nearest
from companion.config.load import load_settings

EXACT, TRUE, NOISY, _, ONE_WAY = CASES
FLOWN_S = 20.0


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return Scene.of("room", load_settings(None, None), 1, FLOWN_S, tmp_path_factory.mktemp("flights"))


def test_only_the_pose_differs_between_the_rows(scene: Scene) -> None:
    """Protects the comparison: what is called an effect of the pose must not be one of other images."""
    for case in (NOISY, ONE_WAY):
        for (one, true), (other, also_true) in zip(scene.frames(TRUE), scene.frames(case), strict=True):
            assert true == also_true
            assert np.array_equal(one.depth_m, other.depth_m, equal_nan=True)
            assert one.pose == true
            assert other.pose != true or scene.path_m[0] == true.t_s == 0.0


def test_drift_grows_with_the_way_flown(scene: Scene) -> None:
    """Protects the meaning of 1 %: the last pose is off by that share of the way, the first by nothing."""
    told = [(frame.pose, true) for frame, true in scene.frames(ONE_WAY)]
    off_m = [np.linalg.norm([a.x_m - b.x_m, a.y_m - b.y_m, a.z_m - b.z_m]) for a, b in told]
    assert off_m[0] == 0.0
    assert off_m[-1] == pytest.approx(DRIFT_SHARE * scene.path_m[-1], rel=0.02)


def test_a_map_of_exact_images_is_right(scene: Scene) -> None:
    """Protects the measures: without noise every voxel is true, and all that was imaged is there, or the bench errs."""
    row, voxels = measured(scene, EXACT)
    assert row["precision"] == 1.0
    assert float(str(row["of imaged"])) > 0.99
    assert row["occupied"] == len(voxels.occupied()) > 1000
    assert 0 < np.count_nonzero(scene.imaged) < len(scene.imaged)


def test_a_flight_is_kept(tmp_path: Path, scene: Scene) -> None:
    """Protects that rows of another day compare: the same work folder gives the same flight without flying."""
    again = Scene.of("room", scene.settings, 1, FLOWN_S, tmp_path)
    (kept,) = tmp_path.iterdir()
    flown_ns = kept.stat().st_mtime_ns
    once_more = Scene.of("room", scene.settings, 1, FLOWN_S, tmp_path)
    assert kept.stat().st_mtime_ns == flown_ns
    assert once_more.poses == again.poses == scene.poses


def test_nearest_is_the_nearest() -> None:
    """Protects the local measures from a place that is not next to the flight."""
    rng = np.random.default_rng(2)
    points, places = rng.normal(size=(500, 3)), rng.normal(size=(40, 3))
    apart_m = np.linalg.norm(points[:, None] - places, axis=2)
    assert np.array_equal(nearest(points, places), np.argmin(apart_m, axis=1))
