"""The other vehicles as one of them sees them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.config.sensors import CameraSettings
from companion.geometry import camera_to_world
from companion.model import Pose
from sitl.mines import load_world
from sitl.scene.fellows import Body, Fellows
from sitl.scene.live import LiveWorld
from sitl.scene.raycast import RayCaster

BODY = Body(0.35, 0.3)
CAMERA = CameraSettings().model()
NEAR_M = 3.0 - 0.35 - CAMERA.mount_x_m
"""From the camera to the side of a body 3 m ahead of the vehicle."""
HERE = Pose(0.0, 1.0, -2.0, 1.5, 0.6)


def at(distance_m: float, up_m: float = 0.0) -> Pose:
    """A vehicle straight ahead of `HERE`, so much higher."""
    yaw_rad = HERE.yaw_rad
    x_m, y_m = HERE.x_m + distance_m * math.cos(yaw_rad), HERE.y_m + distance_m * math.sin(yaw_rad)
    return Pose(0.0, x_m, y_m, HERE.z_m + up_m, 0.0)


def meeting(*others: Pose) -> Fellows:
    """1 at `HERE`, the others from 2 on."""
    fellows = Fellows(BODY, CAMERA)
    for number, pose in enumerate((HERE, *others), start=1):
        fellows.look(number, pose)
    return fellows


def seen(fellows: Fellows) -> np.ndarray:
    """The image of 1, where there is no rock."""
    return fellows.image(1, HERE, np.full((CAMERA.height_px, CAMERA.width_px), np.inf, np.float32))


def test_a_body_ahead_is_as_far_as_its_side_and_as_large_as_it_is() -> None:
    """A cylinder of 0.35 m radius and 0.3 m height, 3 m ahead."""
    depth_m = seen(meeting(at(3.0)))
    found = np.isfinite(depth_m)
    # The sides of the prism are up to 2 % nearer to its axis than its corners.
    assert NEAR_M - 0.01 <= depth_m[found].min() <= NEAR_M + 0.02
    rows, columns = np.flatnonzero(found.any(axis=1)), np.flatnonzero(found.any(axis=0))
    assert len(rows) == pytest.approx(CAMERA.fy_px * 0.3 / NEAR_M, abs=2)
    assert len(columns) == pytest.approx(CAMERA.fx_px * 0.7 / (3.0 - CAMERA.mount_x_m), rel=0.1)


def test_the_image_is_that_of_the_rays() -> None:
    """Depth and beams tell of one body: every pixel that sees it agrees with a ray cast along it."""
    fellows = meeting(at(2.0, 0.2))
    depth_m = seen(fellows)
    v, u = np.nonzero(np.isfinite(depth_m))
    axes, place_m = camera_to_world(CAMERA, HERE)
    rays = np.stack([np.ones(len(u)), -(u - CAMERA.cx_px) / CAMERA.fx_px, -(v - CAMERA.cy_px) / CAMERA.fy_px], axis=1)
    ranges_m = fellows.ranges(1, HERE, np.broadcast_to(place_m, rays.shape), rays @ axes.T, np.full(len(u), np.inf))
    hit = np.isfinite(ranges_m)
    assert hit.mean() > 0.95  # rim pixels may go past by rounding
    assert np.abs(ranges_m[hit] - depth_m[v, u][hit]).max() < 0.01


def test_nobody_sees_itself() -> None:
    """A vehicle is not in its own way."""
    assert not np.isfinite(seen(meeting())).any()


def test_what_is_nearer_is_seen() -> None:
    """Rock before a vehicle hides it, a vehicle before rock is in the way."""
    fellows = meeting(at(3.0))
    for rock_m, least_m in ((1.0, 1.0), (5.0, NEAR_M)):
        rock = np.full((CAMERA.height_px, CAMERA.width_px), rock_m, np.float32)
        assert fellows.image(1, HERE, rock).min() == pytest.approx(least_m, abs=0.03)


def test_one_above_is_met_by_the_beam_upward_and_after_restart_is_gone() -> None:
    """Its underside is half of its height nearer than its middle."""
    fellows = meeting(at(0.0, 0.75))
    # Beside the axis, where the triangles of the prism have their common corner.
    origin_m, up = np.array([[HERE.x_m + 0.02, HERE.y_m + 0.05, HERE.z_m]]), np.array([[0.0, 0.0, 1.0]])
    assert fellows.ranges(1, HERE, origin_m, up, np.array([2.0]))[0] == pytest.approx(0.6, abs=1e-3)
    above_m = origin_m + np.array([0.0, 0.0, 0.75])
    assert fellows.ranges(2, at(0.0, 0.75), above_m, up, np.array([2.0]))[0] == 2.0
    fellows.restart()
    assert fellows.ranges(1, HERE, origin_m, up, np.array([2.0]))[0] == 2.0


@pytest.mark.parametrize(
    ("beside_m", "up_m", "touches"), [(0.69, 0.29, True), (0.71, 0.0, False), (0.0, 0.31, False), (0.0, 0.0, True)]
)
def test_bodies_touch_where_they_are_in_each_other(beside_m: float, up_m: float, touches: bool) -> None:
    """Upright cylinders: twice the radius in the plane and the height."""
    assert BODY.touches(HERE, at(beside_m, up_m)) is touches


def test_vehicles_of_one_world_see_each_other_and_one_alone_sees_the_rock() -> None:
    """The whole way through `LiveWorld`: with bodies the other one is in the image, without there is none."""
    world = load_world("room", 1)
    caster = RayCaster(world)
    rng = np.random.default_rng(1)
    rock = np.full((CAMERA.height_px, CAMERA.width_px), 5.0, np.float32)
    for body, least_m in ((BODY, NEAR_M), (None, 5.0)):
        live = LiveWorld(world, caster, CAMERA, body)
        live.look(HERE, 1)
        live.look(at(3.0), 2)
        assert live.image(HERE, rock.copy(), rng, 1).min() == pytest.approx(least_m, abs=0.03)
