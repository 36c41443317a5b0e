"""The depth renderer against ray casting: ``python -m bench.flight.render [--json FILE] [MESH ...]``.

Both draw the same images in the same worlds, single-threaded. The disagreement is given over the pixels that both saw
within the camera's range; pixels where only one of them saw something are counted apart.
"""

from __future__ import annotations

import time

import numpy as np

from bench.common import Row, parser, show
from companion.geometry import camera_to_world
from companion.model import Camera, Pose
from sitl.mines import World, load_world
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer

WORLDS = ("complex", "slope", "room", "random:1")
SIZES_PX = ((160, 120), (640, 480))
POSES = 40


def main() -> None:
    """Measures, prints a table, and writes it as JSON if asked to."""
    made = parser(__doc__)
    made.add_argument("meshes", nargs="*", metavar="MESH", help="mesh files to measure in too")
    arguments = made.parse_args()
    rows = []
    for spec in (*WORLDS, *arguments.meshes):
        world = load_world(spec, seed=0)
        caster = RayCaster(world)
        rows += [measured(world, caster, size_px) for size_px in SIZES_PX]
    show(rows, list(rows[0]), arguments.json)


def measured(world: World, caster: RayCaster, size_px: tuple[int, int]) -> Row:
    """One row of the table: medians over random poses."""
    width_px, height_px = size_px
    focal_px = width_px / 2.0 / np.tan(np.deg2rad(86.0) / 2.0)
    camera = Camera(
        *(width_px, height_px, focal_px, focal_px, (width_px - 1) / 2.0, (height_px - 1) / 2.0),
        min_range_m=0.3,
        max_range_m=10.0,
    )
    renderer = DepthRenderer(world, camera)
    rng = np.random.default_rng(0)
    poses = [_pose(world, rng) for _ in range(POSES)]
    renderer.render(poses[0])  # compiles

    u, v = np.meshgrid(np.arange(width_px), np.arange(height_px))
    rays = np.stack([np.ones(u.shape), (camera.cx_px - u) / focal_px, (camera.cy_px - v) / focal_px], axis=-1)
    render_s, cast_s, worst_m, lone = [], [], 0.0, 0
    for pose in poses:
        begin = time.perf_counter()
        rendered = renderer.render(pose)
        render_s.append(time.perf_counter() - begin)
        axes, place = camera_to_world(camera, pose)
        begin = time.perf_counter()
        cast = caster.cast(place, rays.reshape(-1, 3) @ axes.T).reshape(rendered.shape)
        cast_s.append(time.perf_counter() - begin)
        near = (rendered < camera.max_range_m) & (cast < camera.max_range_m)
        worst_m = max(worst_m, float(np.abs(rendered[near] - cast[near]).max(initial=0.0)))
        lone += int(np.sum((rendered < camera.max_range_m) ^ (cast < camera.max_range_m)))
    render_ms, cast_ms = 1e3 * float(np.median(render_s)), 1e3 * float(np.median(cast_s))
    return {
        "world": world.name,
        "triangles": len(world.triangles),
        "pixels": f"{width_px}x{height_px}",
        "render_ms": render_ms,
        "cast_ms": cast_ms,
        "ratio": cast_ms / render_ms,
        "worst_m": worst_m,
        "lone_pixels": lone,
    }


def _pose(world: World, rng: np.random.Generator) -> Pose:
    """Somewhere on the way through a generated world, or about the start of a mesh, tilted as in flight."""
    if world.start is None:
        x_m, y_m, floor_m = rng.choice(world.start_area_m)
        z_m = floor_m + 1.5
    else:
        x_m, y_m, z_m = rng.normal([world.start.x_m, world.start.y_m, world.start.z_m], 0.2)
    yaw_rad, roll_rad, pitch_rad = rng.uniform([-np.pi, -0.2, -0.2], [np.pi, 0.2, 0.2])
    return Pose(0.0, x_m, y_m, z_m, yaw_rad, roll_rad, pitch_rad)


if __name__ == "__main__":
    main()
