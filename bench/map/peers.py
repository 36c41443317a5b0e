"""The map beside OctoMap and Open3D's VoxelBlockGrid: ``python -m bench.map.peers [--quick] [--world WORLD ...]``.

Time: every contender takes the same images in a process of its own, bound to one core or to two. All have OctoMap's
default sensor model and the same range. What is called, and only that is timed:

- ours: `VoxelMap.integrate`.
- octomap: ``insertPointCloud(points, origin, maxrange)`` with each pixel that says something. Pixels that see nothing
  in range are points at the range limit, and it cuts their rays. Its limit is a sphere and ours a plane that touches
  it, so it has a little less to do: the share is printed. The points are made beforehand.
- octomap thinned: the same with the first pixel only of those that end in one voxel. Thinning is not timed.
- octomap discretize: all points, ``discretize=True``: it thins them itself.
- octomap copy: as many points, all in the origin: what the binding needs to copy them. It is part of the others.
- vbg: ``compute_unique_block_coordinates`` and ``integrate``, distance and weight only, with Open3D's default blocks
  of 16 and band of 8 voxels on either side of the surface. It does not know free space. vbg narrow: 8 and 4.

The processor's clock changes within minutes, by half and more: so ours is timed again right before and right after
every other, in the same process and with the same images, and the ratio is to the mean of these two ("/ ours";
"/ clean": of ours with spoilt images to ours with exact ones).

The first frame of each map, in which things are compiled or loaded, is left out; that of the first is given apart. Of
all these only Open3D has code for two cores. "CPU" is time on the processor, all threads together: what to compare
where other work disturbs the clock. The binding's text says that OctoMap runs in parallel: its wheel does not.

"own": what each says of itself: `VoxelMap.memory_bytes`, ``memoryUsage``, the blocks in use.

Agreement with OctoMap and sizes: see `bench.map.agreement`.
"""

from __future__ import annotations

import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from argparse import SUPPRESS, ArgumentParser, Namespace
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.common import Row, Usage, parser, show, write
from bench.map import frames as map_frames
from bench.map.agreement import agreement
from bench.map.octomap import octree, voxels_of
from companion.errors import InputError
from companion.geometry import camera_to_world
from companion.mapping import VoxelMap
from companion.model import DepthFrame

Floats = NDArray[np.float64]

VOXELS_M = (0.1, 0.05)
OURS, COPY = "ours", "octomap copy"
PASSES = 5
"""The fast contenders take the images this often, each time into a new map."""

LOST_SHOWN = 20
COLUMNS = (
    *("place", "images", "voxel, m", "cores", "contender", "median, ms", "p99, ms", "CPU, ms", "first, ms"),
    *("median / ours", "CPU / ours", "CPU / clean"),
    *("RSS grew, MB", "own, MB", "frames"),
)
SIZE_COLUMNS = ("place", "images", "voxel, m", "ours, MB", "octomap, MB", "journal, MB", ".bt, MB", ".ot, MB")
CELL_COLUMNS = ("octomap", "ours", "voxels", "share, %")
REASON_COLUMNS = (
    *("octomap", "ours", "why", "voxels", "near surface, %", "hits p50", "looks p50"),
    *("octomap p50", "ours p50"),
)


class _OursContender:
    """The engine of this project."""

    def __init__(self, voxel_m: float) -> None:
        self._map = VoxelMap(map_frames.octomap_model(voxel_m))

    def prepared(self, frame: DepthFrame) -> DepthFrame:
        return frame

    def put(self, frame: DepthFrame) -> None:
        self._map.integrate(frame)

    def own_bytes(self) -> int:
        return self._map.memory_bytes


class _OctoMapContender:
    """``octomap.OcTree.insertPointCloud`` in one of the ways to call it."""

    def __init__(self, voxel_m: float, way: str = "every") -> None:
        self._tree, self._voxel_m, self._way = octree(voxel_m), voxel_m, way

    def prepared(self, frame: DepthFrame) -> tuple[Floats, Floats]:
        points, origin = map_frames.ends_m(frame)
        if self._way == "thinned":
            points = points[np.unique(voxels_of(points, self._voxel_m), axis=0, return_index=True)[1]]
        if self._way == "copy":
            points[:] = origin
        return points, origin

    def put(self, cloud: tuple[Floats, Floats]) -> None:
        self._tree.insertPointCloud(*cloud, maxrange=map_frames.RANGE_M, discretize=self._way == "discretize")

    def own_bytes(self) -> int:
        return int(self._tree.memoryUsage())


class _BlockGridContender:
    """``open3d.t.geometry.VoxelBlockGrid`` on the processor."""

    def __init__(self, voxel_m: float, block: int = 16, band: float = 8.0) -> None:
        import open3d  # takes 3 s: the others need not wait

        core, self._block = open3d.core, block
        self._image, self._tensor, self._band = open3d.t.geometry.Image, core.Tensor.from_numpy, band
        self._grid = open3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"),
            (core.float32, core.float32),
            [core.SizeVector([1])] * 2,
            voxel_m,
            block,
            10000,
            core.Device("CPU:0"),
        )

    def prepared(self, frame: DepthFrame) -> tuple[Any, Any, Any]:
        camera = frame.camera
        axes, origin_m = camera_to_world(camera, frame.pose)
        to_camera = np.eye(4)
        to_camera[:3, :3] = np.stack([-axes[:, 1], -axes[:, 2], axes[:, 0]])
        to_camera[:3, 3] = -to_camera[:3, :3] @ origin_m
        lens = np.array([[camera.fx_px, 0.0, camera.cx_px], [0.0, camera.fy_px, camera.cy_px], [0.0, 0.0, 1.0]])
        depth_m = np.nan_to_num(frame.depth_m, nan=0.0, posinf=0.0)
        return self._image(self._tensor(depth_m)), self._tensor(lens), self._tensor(to_camera)

    def put(self, view: tuple[Any, Any, Any]) -> None:
        limits = (1.0, map_frames.RANGE_M, self._band)
        blocks = self._grid.compute_unique_block_coordinates(*view, *limits)
        self._grid.integrate(blocks, *view, *limits)

    def own_bytes(self) -> int:
        return int(self._grid.hashmap().size()) * self._block**3 * 2 * 4


Contender = _OursContender | _OctoMapContender | _BlockGridContender
CONTENDERS: dict[str, Callable[[float], Contender]] = {
    OURS: _OursContender,
    "octomap": _OctoMapContender,
    "octomap thinned": partial(_OctoMapContender, way="thinned"),
    "octomap discretize": partial(_OctoMapContender, way="discretize"),
    COPY: partial(_OctoMapContender, way="copy"),
    "vbg": _BlockGridContender,
    "vbg narrow": partial(_BlockGridContender, block=8, band=4.0),
}
ON_TWO_CORES = (OURS, "octomap", "vbg", "vbg narrow")
SLOW = tuple(name for name in CONTENDERS if name.startswith("octomap"))


@dataclass(frozen=True, slots=True)
class Job:
    """What one process does: time a contender, or compare ours with OctoMap where no contender is named.

    Attributes:
        contender: its name.
        frames_file: its images.
        beside_file: those with which ours is timed before and after it.
        voxel_m: edge of a voxel.
        passes: how often the images are taken.
    """

    contender: str
    frames_file: str
    beside_file: str
    voxel_m: float
    passes: int


@dataclass(frozen=True, slots=True)
class Times:
    """What one contender took for each frame but the first ones, by the clock and on the processor; and its memory."""

    clock_ms: list[float]
    cpu_ms: list[float]
    first_ms: float
    grew_mb: float
    own_bytes: int


def timed(job: Job) -> Row:
    """Run one contender in this process, with ours before and after it."""
    frames, beside = map_frames.load(Path(job.frames_file)), map_frames.load(Path(job.beside_file))
    before = _times_of(OURS, beside, job.voxel_m, PASSES)
    its = _times_of(job.contender, frames, job.voxel_m, job.passes)
    after = _times_of(OURS, beside, job.voxel_m, PASSES)
    return {
        "median, ms": float(np.median(its.clock_ms)),
        "p99, ms": float(np.percentile(its.clock_ms, 99)),
        "CPU, ms": float(np.median(its.cpu_ms)),
        "first, ms": its.first_ms,
        "beside, ms": float(np.mean([np.median(times.clock_ms) for times in (before, after)])),
        "beside, CPU ms": float(np.mean([np.median(times.cpu_ms) for times in (before, after)])),
        "RSS grew, MB": its.grew_mb,
        "own, MB": its.own_bytes / 1e6,
        "frames": len(its.clock_ms),
        "peak RSS, MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6,
        "every frame, ms": its.clock_ms,
    }


def _times_of(name: str, frames: Sequence[DepthFrame], voxel_m: float, passes: int) -> Times:
    make = CONTENDERS[name]
    first_ms, clock_ms, cpu_ms = 0.0, [], []
    contender = make(voxel_m)
    contender.prepared(frames[0])
    before_mb = Usage.of(os.getpid()).rss_mb
    grew_mb, own_bytes = 0.0, 0
    for number in range(passes):
        contender = make(voxel_m)
        for place, frame in enumerate(frames):
            prepared: Any = contender.prepared(frame)
            start, start_cpu = time.perf_counter(), time.process_time()
            contender.put(prepared)
            took_ms, took_cpu_ms = 1e3 * (time.perf_counter() - start), 1e3 * (time.process_time() - start_cpu)
            if place > 0:
                clock_ms.append(took_ms)
                cpu_ms.append(took_cpu_ms)
            elif number == 0:
                first_ms = took_ms
        if number == 0:
            grew_mb, own_bytes = Usage.of(os.getpid()).rss_mb - before_mb, contender.own_bytes()
    return Times(clock_ms, cpu_ms, first_ms, grew_mb, own_bytes)


def in_own_process(job: Job, cores: int) -> Row:
    """The result of a job in a fresh process bound to the first ``cores`` of those that we may use.

    Where it fails the row says so, and what the process said is on the terminal: the others are measured all the same.
    """
    chosen = sorted(os.sched_getaffinity(0))[:cores]
    threads = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(cores))
    command = ["taskset", "-c", ",".join(map(str, chosen)), sys.executable, "-m", "bench.map.peers", "--job"]
    ran = subprocess.run(  # noqa: S603 - nothing in it comes from outside
        [*command, json.dumps(asdict(job))], check=False, stdout=subprocess.PIPE, env=os.environ | threads
    )
    if ran.returncode != 0:
        return {"failed": ran.returncode}
    result: Row = json.loads(ran.stdout.splitlines()[-1])
    return result


def measured(arguments: Namespace, folder: Path) -> Iterator[Row]:
    """Every row of the table of times, as each is there; and one row a comparison of what the maps say."""
    width_px, height_px = arguments.size
    camera = map_frames.camera_of(width_px, height_px)
    for place in arguments.world or [map_frames.TUNNEL]:
        name = Path(place).stem
        try:
            exact = map_frames.flight(place, arguments.frames, camera)
        except InputError as error:
            print(f"{place} is left out: {error}", flush=True)
            continue
        print(f"\n{name}: {_sphere_share(exact[0]):.1f} % less to do for octomap, which has a sphere for a limit")
        clean_file = folder / f"{name}-{map_frames.CLEAN}.npz"
        map_frames.save(exact, clean_file)
        for variant, voxel_m in product(map_frames.VARIANTS, arguments.voxel):
            file = folder / f"{name}-{variant}.npz"
            if not file.exists():
                map_frames.save(map_frames.spoilt(exact, variant), file)
            base: Row = {"place": name, "images": variant, "voxel, m": voxel_m}
            for cores in (1, 2) if variant == map_frames.CLEAN else (1,):
                yield from _times(base | {"cores": cores}, str(file), str(clean_file), variant)
            if variant in (map_frames.CLEAN, map_frames.ROUGH):
                yield base | in_own_process(Job("", str(file), "", voxel_m, 1), 1)


def _times(base: Row, file: str, clean_file: str, variant: str) -> Iterator[Row]:
    """Every contender on one core or two; only ours where the images are spoilt in one way alone."""
    cores, voxel_m = int(str(base["cores"])), float(str(base["voxel, m"]))
    if cores > len(os.sched_getaffinity(0)):
        print(f"{cores} cores are left out: this process may use {len(os.sched_getaffinity(0))}")
        return
    everyone = tuple(CONTENDERS) if variant in (map_frames.CLEAN, map_frames.ROUGH) else (OURS,)
    for name in everyone if cores == 1 else ON_TWO_CORES:
        passes = 1 if name in SLOW else PASSES
        row = in_own_process(Job(name, file, clean_file if name == OURS else file, voxel_m, passes), cores)
        to = "clean" if name == OURS else "ours"
        ratios = {
            f"median / {to}": _ratio(row, "median, ms", "beside, ms"),
            f"CPU / {to}": _ratio(row, "CPU, ms", "beside, CPU ms"),
        }
        yield base | {"contender": name} | row | ratios


def _ratio(row: Row, column: str, beside: str) -> float | None:
    return None if "failed" in row else float(str(row[column])) / float(str(row[beside]))


def _sphere_share(frame: DepthFrame) -> float:
    """Per cent of the length of all rays that lies between OctoMap's range limit and ours."""
    ends, origin = map_frames.ends_m(frame)
    lengths_m = np.linalg.norm(ends - origin, axis=1)
    return 100.0 * float(1.0 - np.minimum(lengths_m, map_frames.RANGE_M).sum() / lengths_m.sum())


def _size(text: str) -> tuple[int, int]:
    width_px, _, height_px = text.partition("x")
    return int(width_px), int(height_px)


def _parser() -> ArgumentParser:
    made = parser(__doc__)
    made.add_argument("--frames", type=int, default=15, help="images of a flight, the first of which is not counted")
    made.add_argument(
        "--world", action="append", metavar="WORLD", help="world or mesh instead of the tunnel; repeatable"
    )
    made.add_argument("--voxel", type=float, action="append", metavar="M", help="edge of a voxel; may be repeated")
    made.add_argument("--size", type=_size, default=(640, 480), metavar="WxH", help="of the images, in px")
    made.add_argument("--quick", action="store_true", help="four images of 160x120 and one size of voxel: does it run?")
    made.add_argument("--job", help=SUPPRESS)
    return made


def main() -> None:
    """Measure, print the tables, and write all figures if asked."""
    arguments = _parser().parse_args()
    if arguments.job:
        job = Job(**json.loads(arguments.job))
        print(
            json.dumps(timed(job) if job.contender else agreement(map_frames.load(Path(job.frames_file)), job.voxel_m))
        )
        return
    arguments.voxel = arguments.voxel or list(VOXELS_M)
    if arguments.quick:
        arguments.frames, arguments.size, arguments.voxel = 4, (160, 120), arguments.voxel[:1]
    print(f"{platform.machine()}, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f} at the start")
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for row in measured(arguments, Path(folder)):
            rows.append(row)
            print(".", end="", flush=True)
            if arguments.json:
                write(rows, arguments.json)
    if not rows:
        raise SystemExit("nothing was measured")
    print("\n\nTime of a frame")
    show([row for row in rows if "contender" in row], COLUMNS)
    for row in rows:
        if "cells" in row:
            _show_agreement(row)
    if any("failed" in row for row in rows):
        raise SystemExit("some processes failed: their rows are empty or missing, and the file says which")


def _show_agreement(row: Any) -> None:
    """The tables of one comparison."""
    print(f"\nAgreement: {row['place']}, {row['images']}, {row['voxel, m']} m")
    show(row["cells"], CELL_COLUMNS)
    lost = row["lost"]
    print(
        f"\n{lost['lost']} of {lost['occupied']} voxels that are occupied in OctoMap are not in ours; "
        f"{lost['lost by rounding']} of them because single precision puts the end of the ray into the next voxel"
    )
    for voxel in lost["each"][:LOST_SHOWN]:
        print("  " + ", ".join(f"{name} {value}" for name, value in voxel.items()))
    print("\nEach difference by what the frames saw of the voxel; log-odds in thousandths")
    if row["reasons"]:
        show(row["reasons"], REASON_COLUMNS)
    print(
        "Free in OctoMap and occupied in ours: beams that touch a corner wear it away there, looks at the centre here."
    )
    print()
    show([row | row["sizes"]], SIZE_COLUMNS)


if __name__ == "__main__":
    main()
