"""How true the map is: the same flight and the same images in each world, put in with better and worse poses.

python -m bench.map.truth                                      # the generated worlds
python -m bench.map.truth path/to/mine.ply path/to/cave.ply    # meshes, each with its start pose in a JSON beside it
BENCH_WORLDS=path/to/meshes python -m bench.map.truth          # the generated worlds and every mesh in that folder
python -m bench.map.truth --quick                              # one small world, one minute of flight

The walls of some generated worlds stand at round coordinates, on the very border of two rows of voxels, which no real
wall does: all generated worlds are turned and shifted a little.

The flight of a world is simulated once and kept in ``--work``. Its images are drawn from where the camera truly was;
only the pose that the map is told differs from row to row:

- ``exact depth``: true poses and depth without any noise. All other rows have depth noise of 0.002 z² and 2 % of the
  pixels missing.
- ``true``: true poses.
- ``noisy``: 1 cm on each axis and 0.2° on each angle, white: each image has its own error.
- ``1 %, turning``: the error grows by 1 % of the way flown in a direction that is forgotten after 20 m, as the
  simulator's does. It partly averages out: see the column ``drift``.
- ``1 %, one way``: the same, always in one direction. There is no error of the heading in either.

``completeness`` is the share, by area, of the surface visible from the way flown out to ``mapping.max_range_m``, in any
direction, that lies within one voxel of an occupied one. ``of imaged`` is the same over the surface that truly stood in
an image within that range, which leaves out what the camera never looked at. ``in free`` is the share of that surface
in a voxel that the map calls free. ``precision`` is the share of the occupied voxels within one voxel of true surface,
``accuracy`` their mean distance. With drift these compare the map as the user gets it, all in one frame, with the
truth. The ``local`` columns say what is left when every place is moved back by the error of the pose at the point of
the flight next to it: what somebody sees who stands in the mine with this map. A place that was passed twice stands
twice in a drifted map, and only one of both fits.
"""

from __future__ import annotations

import os
import sys
import time
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.common import Row, camera_rate, parser, say, show, with_camera, write
from bench.flight.missions import WORLDS
from companion.config.load import load_settings
from companion.config.settings import Settings
from companion.config.sim import NoiseSettings
from companion.errors import CompanionError
from companion.geometry import camera_to_world
from companion.mapping import FREE, VoxelMap
from companion.model import DepthFrame, Pose
from sitl.mines import World, load_world
from sitl.mines.files import SUFFIXES
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer
from sitl.scene.sensors import SensorRig
from sitl.scene.surface import Array, Points, Surroundings, surface_samples
from sitl.scene.visibility import accuracy_m, precision, visible_samples
from sitl.sim.flight import Flight
from sitl.sim.start import start_poses

WORLDS_VARIABLE = "BENCH_WORLDS"
QUICK_WORLD, QUICK_S = "room", 60.0
DRIFT_SHARE = 0.01
TURN_RAD, SHIFT_M = 0.3, (0.037, 0.021, 0.043)
PLACE_STEP_M = 0.25
"""The way flown is looked at in points this far apart."""
HIDDEN_M = 0.02
"""What lies this far behind the depth of its own pixel is hidden."""
BATCH = 4096
COLUMNS = (
    *("world", "pose", "path, m", "frames", "drift, m", "completeness", "of imaged", "in free", "precision"),
    *("accuracy, cm", "p95, cm", "occupied", "ms a frame", "local compl.", "local prec.", "local acc., cm"),
)


@dataclass(frozen=True, slots=True)
class Case:
    """What is wrong with the poses and the images.

    Attributes:
        name: in the table.
        noise: of depth and pose, as the simulator makes it.
        one_way_share: drift in one fixed direction, as a share of the way flown.
    """

    name: str
    noise: NoiseSettings
    one_way_share: float = 0.0


_DEPTH_ONLY = NoiseSettings(
    depth_latency_s=0.0, frame_loss_share=0.0, pose_noise_m=0.0, pose_noise_rad=0.0, velocity_noise_mps=0.0
)
CASES = (
    Case("exact depth", _DEPTH_ONLY.model_copy(update={"enabled": False})),
    Case("true", _DEPTH_ONLY),
    Case("noisy", _DEPTH_ONLY.model_copy(update={"pose_noise_m": 0.01, "pose_noise_rad": float(np.deg2rad(0.2))})),
    Case("1 %, turning", _DEPTH_ONLY.model_copy(update={"pose_drift_share": DRIFT_SHARE})),
    Case("1 %, one way", _DEPTH_ONLY, one_way_share=DRIFT_SHARE),
)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A world, a flight through it, and what a perfect map of that flight would hold.

    Attributes:
        poses: the true ones, one each tick.
        path_m: (ticks,) way flown until each of them.
        samples_m: (n, 3) points of the surface visible from the way, one for each voxel that holds some.
        areas_m2: (n,) how much surface each stands for.
        imaged: (n,) whether it stood in an image within the range of the map.
    """

    world: World
    caster: RayCaster
    renderer: DepthRenderer
    settings: Settings
    seed: int
    poses: Sequence[Pose]
    path_m: Array
    samples_m: Points
    areas_m2: Array
    imaged: NDArray[np.bool_]

    @classmethod
    def of(cls, spec: str, settings: Settings, seed: int, limit_s: float, work: Path) -> Scene:
        """Fly, or read the flight that is kept, and look at what there was to be seen."""
        world = load_world(spec, seed)
        # A mesh has its own start, and stays where it is.
        world = turned(world) if world.start is None else world
        caster, renderer = RayCaster(world), DepthRenderer(world, settings.sensors.camera.model())
        kept = work / f"{world.name.replace(':', '-')}-seed{seed}-{limit_s:g}s.npy"
        if not kept.is_file():
            work.mkdir(parents=True, exist_ok=True)
            np.save(kept, np.array([astuple(pose) for pose in flown(world, caster, settings, seed, limit_s)]))
        poses = [Pose(*numbers) for numbers in np.load(kept).tolist()]
        places = positions(poses)
        steps_m = np.linalg.norm(np.diff(places, axis=0, prepend=places[:1]), axis=1)
        path_m = np.cumsum(steps_m)
        range_m, voxel_m = settings.mapping.max_range_m, settings.mapping.voxel_m
        points = places[apart(path_m)]
        samples, areas = surface_samples(world, voxel_m, Surroundings.of(points, range_m))
        seen = visible_samples(caster, samples, points, range_m)
        none = np.zeros(int(seen.sum()), np.bool_)
        scene = cls(
            *(world, caster, renderer, settings, seed, poses, path_m),
            *(samples[seen], areas[seen].astype(np.float64), none),
        )
        for frame, true in scene.frames(CASES[0]):
            scene.imaged[:] |= scene._in_image(frame, true)
        return scene

    def frames(self, case: Case) -> Iterator[tuple[DepthFrame, Pose]]:
        """Each image as the map gets it, and the true pose at its exposure. The images are the same in every case."""
        rng = np.random.default_rng(self.seed)
        rig = SensorRig(self.settings.sensors, case.noise, self.caster, self.renderer, rng)
        direction = np.random.default_rng(self.seed + 1).standard_normal(3)
        direction *= case.one_way_share / np.linalg.norm(direction)
        for true, flown_m in zip(self.poses, self.path_m.tolist(), strict=True):
            frame = rig.observe(true).frame
            if frame is None:
                continue
            x, y, z = (flown_m * direction).tolist()
            told = frame.pose
            yield (replace(frame, pose=replace(told, x_m=told.x_m + x, y_m=told.y_m + y, z_m=told.z_m + z)), true)

    def share(self, found: NDArray[np.bool_], among: NDArray[np.bool_] | None = None) -> float:
        """The share by area of the samples (n,), or of some of them, that are ``found``."""
        areas = self.areas_m2 if among is None else self.areas_m2 * among
        return float(np.sum(areas * found) / np.sum(areas))

    def _in_image(self, frame: DepthFrame, true: Pose) -> NDArray[np.bool_]:
        """(n,) which samples stand in an image of exact depths, within the range of the map."""
        camera, range_m = frame.camera, self.settings.mapping.max_range_m
        axes, origin = camera_to_world(camera, true)
        found = np.zeros(len(self.samples_m), np.bool_)
        reach_m = range_m * np.linalg.norm(
            [1.0, camera.width_px / 2 / camera.fx_px, camera.height_px / 2 / camera.fy_px]
        )
        near = np.flatnonzero(~self.imaged & (np.abs(self.samples_m - origin).max(axis=1) <= reach_m))
        forward, left, up = ((self.samples_m[near] - origin) @ axes).T
        ahead = (forward >= camera.min_range_m) & (forward <= range_m)
        near, forward, left, up = near[ahead], forward[ahead], left[ahead], up[ahead]
        u = np.rint(camera.cx_px - camera.fx_px * left / forward).astype(np.int64)
        v = np.rint(camera.cy_px - camera.fy_px * up / forward).astype(np.int64)
        inside = (u >= 0) & (u < camera.width_px) & (v >= 0) & (v < camera.height_px)
        # A comparison with a pixel that saw nothing is false: NaN.
        seen = forward[inside] <= frame.depth_m[v[inside], u[inside]] + HIDDEN_M
        found[near[inside][seen]] = True
        return found


def turned(world: World) -> World:
    """A generated world that no longer stands on the grid of the voxels."""
    c, s = np.cos(TURN_RAD), np.sin(TURN_RAD)
    turn, shift = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), np.array(SHIFT_M)
    vertices = (world.vertices_m @ turn + shift).astype(np.float32)
    return replace(world, vertices_m=vertices, start_area_m=world.start_area_m @ turn + shift)


def flown(world: World, caster: RayCaster, settings: Settings, seed: int, limit_s: float) -> list[Pose]:
    """The true poses of one mission, tick by tick, until the time is up, a wall is touched or inputs are missing."""
    to_start, to_flight = np.random.SeedSequence(seed).spawn(2)
    start = start_poses(world, caster, settings, 1, np.random.default_rng(to_start))[0]
    flight = Flight(1, world, caster, settings, start, to_flight)
    poses = [start]
    while poses[-1].t_s < limit_s and not flight.touched and flight.blind_s <= settings.mission.input_timeout_s:
        flight.tick(settings.control.period_s, fleet=False)
        poses.append(flight.vehicle.pose)
    return poses


def measured(scene: Scene, case: Case) -> tuple[Row, VoxelMap]:
    """One row of the table, and the map that it speaks of."""
    voxels = VoxelMap(scene.settings.mapping)
    took_s: list[float] = []
    true_m, told_m = [], []
    for frame, true in scene.frames(case):
        began_s = time.perf_counter()
        voxels.integrate(frame)
        took_s.append(time.perf_counter() - began_s)
        true_m.append((true.x_m, true.y_m, true.z_m))
        told_m.append((frame.pose.x_m, frame.pose.y_m, frame.pose.z_m))
    occupied = voxels.occupied()
    near = voxels.occupied_near(scene.samples_m)
    off_m = scene.caster.distance(occupied) if len(occupied) else np.zeros(0)
    row: Row = {
        "world": scene.world.name,
        "pose": case.name,
        "voxel, m": voxels.voxel_m,
        "path, m": float(scene.path_m[-1]),
        "frames": len(took_s),
        "completeness": scene.share(near),
        "of imaged": scene.share(near, scene.imaged),
        "in free": scene.share(voxels.classify(scene.samples_m) == FREE, scene.imaged),
        "precision": precision(off_m, voxels.voxel_m),
        "accuracy, cm": 100.0 * accuracy_m(off_m),
        "p95, cm": 100.0 * float(np.percentile(off_m, 95)) if len(off_m) else None,
        "occupied": len(occupied),
        "MB": voxels.memory_bytes / 1e6,
        # The first one compiles.
        "ms a frame": 1e3 * float(np.median(took_s[1:])),
    }
    drifts = case.one_way_share > 0.0 or case.noise.pose_drift_share > 0.0
    return (row | local(scene, voxels, np.array(true_m), np.array(told_m)) if drifts else row), voxels


def local(scene: Scene, voxels: VoxelMap, true_m: Array, told_m: Array) -> Row:
    """The same measures after each place is moved by the error of the pose at the point of the flight next to it.

    Args:
        scene: the truth.
        voxels: the map.
        true_m: (k, 3) where each image was taken.
        told_m: (k, 3) where the map was told that it was taken.
    """
    error_m = told_m - true_m
    steps_m = np.linalg.norm(np.diff(true_m, axis=0, prepend=true_m[:1]), axis=1)
    chosen = apart(np.cumsum(steps_m))
    true_m, told_m, error_m = true_m[chosen], told_m[chosen], error_m[chosen]
    moved = scene.samples_m + error_m[nearest(scene.samples_m, true_m)]
    near = voxels.occupied_near(moved)
    occupied = voxels.occupied()
    back = occupied - error_m[nearest(occupied, told_m)]
    off_m = scene.caster.distance(back) if len(back) else np.zeros(0)
    return {
        "drift, m": float(np.linalg.norm(error_m[-1])),
        "local compl.": scene.share(near),
        "local of imaged": scene.share(near, scene.imaged),
        "local prec.": precision(off_m, voxels.voxel_m),
        "local acc., cm": 100.0 * accuracy_m(off_m),
    }


def positions(poses: Sequence[Pose]) -> Array:
    """(n, 3)."""
    return np.array([(pose.x_m, pose.y_m, pose.z_m) for pose in poses])


def apart(path_m: Array) -> NDArray[np.int64]:
    """Indices of points of a way that are `PLACE_STEP_M` apart; ``path_m`` (n,) is the way until each."""
    chosen: NDArray[np.int64] = np.unique(np.floor(path_m / PLACE_STEP_M), return_index=True)[1]
    return chosen


def nearest(points: NDArray[np.floating], places: Array) -> NDArray[np.int64]:
    """(n,) for each of ``points`` (n, 3) the index of the nearest of ``places`` (k, 3)."""
    found = np.empty(len(points), np.int64)
    squares = np.sum(places**2, axis=1)
    for first in range(0, len(points), BATCH):
        batch = points[first : first + BATCH].astype(np.float64)
        found[first : first + BATCH] = np.argmin(squares - 2.0 * batch @ places.T, axis=1)
    return found


def specs(given: Sequence[str]) -> list[str]:
    """What was asked for; else the generated worlds, and the meshes of the folder that the environment names."""
    folder = os.environ.get(WORLDS_VARIABLE)
    meshes = [] if folder is None else sorted(str(path) for path in Path(folder).iterdir() if path.suffix in SUFFIXES)
    return list(given) or [*WORLDS, *meshes]


def settings_of(arguments: Namespace) -> Settings:
    """The preset, the file, and the camera and voxel of the command line above them."""
    settings = load_settings(arguments.config, arguments.preset)
    width_px, height_px, rate_hz = arguments.camera
    settings = with_camera(settings, width_px=width_px, height_px=height_px, rate_hz=rate_hz)
    voxel = {} if arguments.voxel is None else {"voxel_m": arguments.voxel}
    return settings.model_copy(update={"mapping": settings.mapping.model_copy(update=voxel)})


def main() -> None:
    """Fly, map, compare, print the table."""
    made = parser(__doc__)
    made.add_argument("worlds", nargs="*", metavar="WORLD", help="names or mesh files; by default all")
    made.add_argument("--config", type=Path, metavar="FILE", help="YAML file with settings, of the map for instance")
    made.add_argument("--preset", metavar="NAME", help="preset below the file")
    made.add_argument("--voxel", type=float, metavar="M", help="edge of a voxel, instead of mapping.voxel_m")
    made.add_argument(
        "--camera", type=camera_rate, default=(160, 120, 5.0), metavar="WxH@HZ", help="by default 160x120@5"
    )
    made.add_argument("--time-limit", type=float, default=300.0, metavar="S", help="simulated, of each flight")
    made.add_argument("--seed", type=int, default=1, help="draws start, choices and noise")
    made.add_argument(
        "--work", type=Path, default=Path("runs/map_truth"), metavar="DIR", help="flights are kept here; delete it "
        "after a change of how the vehicle flies"
    )  # fmt: skip
    made.add_argument("--quick", action="store_true", help=f"only {QUICK_WORLD}, {QUICK_S:g} s")
    arguments = made.parse_args()
    limit_s = QUICK_S if arguments.quick else arguments.time_limit
    rows: list[Row] = []
    try:
        settings = settings_of(arguments)
        for spec in [QUICK_WORLD] if arguments.quick else specs(arguments.worlds):
            say(f"{spec}: flying")
            scene = Scene.of(spec, settings, arguments.seed, limit_s, arguments.work)
            for case in CASES:
                say(f"{spec}: {case.name}")
                rows.append(measured(scene, case)[0])
                if arguments.json is not None:
                    write(rows, arguments.json)
    except CompanionError as error:
        sys.exit(str(error))
    camera, mapping = settings.sensors.camera, settings.mapping
    print(
        f"camera {camera.width_px} x {camera.height_px} at {camera.rate_hz:g} Hz, voxels of {mapping.voxel_m:g} m, "
        f"range {mapping.max_range_m:g} m, at most {limit_s:g} s of flight, seed {arguments.seed}"
    )
    show(rows, COLUMNS, arguments.json)


if __name__ == "__main__":
    main()
