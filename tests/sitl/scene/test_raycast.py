"""What rays and distances mean, on a box whose answers are known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from sitl.mines import World
from sitl.scene.raycast import RayCaster


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> World:
    """The surface of a box, two triangles a side."""
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [corner for a, b, c, d in sides for corner in ((a, b, c), (a, c, d))]
    return World(
        "box", corners.astype(np.float32), np.array(triangles, dtype=np.int32), None, np.empty((0, 3)), "a box"
    )


@pytest.fixture(scope="module")
def caster() -> RayCaster:
    return RayCaster(box((0.0, 0.0, 0.0), (4.0, 2.0, 3.0)))


def test_ranges_count_in_lengths_of_the_direction(caster: RayCaster) -> None:
    ranges = caster.cast(np.array([1.0, 1.0, 1.0]), np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, -0.5]]))
    np.testing.assert_allclose(ranges, [3.0, 1.5, 2.0], rtol=1e-6)


def test_each_ray_may_have_its_own_origin_or_all_one_direction(caster: RayCaster) -> None:
    origins = np.array([[1.0, 1.0, 1.0], [3.0, 1.0, 2.0]])
    np.testing.assert_allclose(caster.cast(origins, np.array([1.0, 0.0, 0.0])), [3.0, 1.0], rtol=1e-6)
    ways = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(caster.cast(origins, ways), [3.0, 1.0], rtol=1e-6)


def test_surfaces_are_hit_from_both_sides_and_nothing_gives_inf(caster: RayCaster) -> None:
    ranges = caster.cast(np.array([-1.0, 1.0, 1.0]), np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(ranges, [1.0, np.inf])


def test_a_way_is_blocked_by_what_lies_between_its_ends(caster: RayCaster) -> None:
    ends = np.array([[3.9, 1.0, 1.0], [4.1, 1.0, 1.0], [-9.0, 1.0, 1.0], [1.0, 1.0, 2.9]])
    assert caster.blocked(np.array([1.0, 1.0, 1.0]), ends).tolist() == [False, True, True, False]


def test_no_rays_give_no_ranges(caster: RayCaster) -> None:
    assert caster.cast(np.empty((0, 3)), np.empty((0, 3))).shape == (0,)
    assert caster.cast(np.empty((0, 3)), np.array([1.0, 0.0, 0.0])).shape == (0,)
    assert caster.blocked(np.empty((0, 3)), np.empty((0, 3))).shape == (0,)
    assert caster.distance(np.empty((0, 3))).shape == (0,)


def test_distance_is_to_the_nearest_surface_inside_and_outside(caster: RayCaster) -> None:
    points = np.array([[1.5, 1.0, 1.5], [0.25, 1.0, 1.5], [-3.0, 1.0, 1.5], [-3.0, -4.0, 1.5]])
    np.testing.assert_allclose(caster.distance(points), [1.0, 0.25, 3.0, 5.0], rtol=1e-6)
