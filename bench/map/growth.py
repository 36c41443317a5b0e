"""Whether a frame and the map cost the same after 10 km as after 100 m: ``python -m bench.map.growth [--paged MB]``.

A tunnel with bends and rough walls, 4 m wide and 3 m high, that repeats itself every 50 m, is flown through once, an
image every 0.5 m; so all ground is new, and the images of one period serve for all. Images of 160 x 120 fill the map.
At each station those of the next period are 640 x 480 and timed ("new"), and then the first 50 m of the flight are
looked at once more ("return"). With ``--paged`` the map keeps only so much in memory and the rest in a journal, to
which it is written after each fifth image; that is timed apart ("flush").
"""

from __future__ import annotations

import contextlib
import gc
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.common import Row, Usage, parser, quantiles, show, write
from bench.map import frames as map_frames
from companion.mapping import VoxelMap
from companion.mapping.journal import Header, Journal
from companion.mapping.journal.paging import PagedMap
from companion.model import Camera, DepthFrame, Pose
from sitl.mines import World
from sitl.scene.render import DepthRenderer

PERIOD_M, STEP_M, BEND_M = 50.0, 0.5, 3.0
WIDTH_M, HEIGHT_M, ROUGH_M = 4.0, 3.0, 0.08
STATIONS_KM = (0.1, 1.0, 10.0)
FILL_PX, TIMED_PX = (160, 120), (640, 480)
COLUMNS = (
    *("km", "new p50, ms", "new p99, ms", "new CPU, ms", "return p50, ms", "return p99, ms", "return CPU, ms"),
    *("map, MB", "map, MB/km", "RSS, MB", "journal, MB", "flush p50, ms", "flush p99, ms"),
)
FRAMES_A_FLUSH = 5
"""At ten images a second that is each half second."""


def tunnel() -> World:
    """One period of the tunnel and as much before and after it as a camera in it sees."""
    around = 40
    x_m = np.arange(-15.0, PERIOD_M + 15.0, 0.25)
    turn = 2.0 * np.pi * np.arange(around) / around
    # From a circle to a box with rounded edges.
    side = np.sign(np.cos(turn)) * np.abs(np.cos(turn)) ** 0.4
    rise = np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** 0.4
    phase = 2.0 * np.pi * x_m[:, np.newaxis] / PERIOD_M
    rough_m = ROUGH_M * (np.sin(31.0 * phase + 3.0 * turn) + np.sin(47.0 * phase - 5.0 * turn))
    y_m = BEND_M * np.sin(phase) + (0.5 * WIDTH_M + rough_m) * side
    z_m = 0.5 * HEIGHT_M + (0.5 * HEIGHT_M + rough_m) * rise
    vertices_m = np.stack(np.broadcast_arrays(x_m[:, np.newaxis], y_m, z_m), axis=-1).reshape(-1, 3)

    here = np.arange((len(x_m) - 1) * around)
    beside = here - here % around + (here + 1) % around
    quads = np.stack([here, beside, here + around, beside, beside + around, here + around], axis=-1)
    return World(
        name="long tunnel",
        vertices_m=vertices_m.astype(np.float32),
        triangles=quads.reshape(-1, 3).astype(np.int32),
        start=None,
        start_area_m=np.empty((0, 3)),
        description="A tunnel that repeats itself.",
    )


def period(camera: Camera, world: World) -> list[DepthFrame]:
    """The images of the first period."""
    renderer = DepthRenderer(world, camera)
    frames: list[DepthFrame] = []
    for x_m in np.arange(0.0, PERIOD_M, STEP_M).tolist():
        phase = 2.0 * math.pi * x_m / PERIOD_M
        heading_rad = math.atan(2.0 * math.pi * BEND_M / PERIOD_M * math.cos(phase))
        looks_rad = 0.5 * math.sin(4.0 * phase)
        pose = Pose(x_m, x_m, BEND_M * math.sin(phase), 0.5 * HEIGHT_M, heading_rad + looks_rad)
        frames.append(DepthFrame(pose.t_s, renderer.render(pose), camera, pose))
    return frames


def moved(frames: list[DepthFrame], number: int) -> Iterator[DepthFrame]:
    """The same images, ``number`` periods further on."""
    for frame in frames:
        way_m = number * PERIOD_M
        pose = replace(frame.pose, x_m=frame.pose.x_m + way_m, t_s=frame.pose.t_s + way_m)
        yield replace(frame, pose=pose, t_s=pose.t_s)


class Flight:
    """A map that is being made, in memory or with a journal behind it, and what that costs."""

    def __init__(self, voxels: VoxelMap | PagedMap, journal: Journal | None) -> None:
        self.voxels, self.journal = voxels, journal
        self.flushes_ms: list[float] = []
        self._frames = 0

    def put(self, frame: DepthFrame) -> tuple[float, float]:
        """Put one image into the map; how long that took by the clock and on the processor, in ms."""
        start, start_cpu = time.perf_counter(), time.thread_time()
        self.voxels.integrate(frame)
        took = 1e3 * (time.perf_counter() - start), 1e3 * (time.thread_time() - start_cpu)
        self._frames += 1
        if isinstance(self.voxels, PagedMap) and self._frames % FRAMES_A_FLUSH == 0:
            start = time.perf_counter()
            self.voxels.flush()
            self.flushes_ms.append(1e3 * (time.perf_counter() - start))
        return took

    def timed(self, frames: Iterator[DepthFrame], name: str) -> Row:
        """Put images into the map; median and p99 in ms."""
        clock_ms, cpu_ms = np.array([self.put(frame) for frame in frames]).T
        return quantiles(name, clock_ms) | {f"{name} CPU, ms": float(np.median(cpu_ms))}

    def sizes(self) -> Row:
        """What the map takes, and how long it took since the last time to write it."""
        row: Row = {"map, MB": self.voxels.memory_bytes / 1e6}
        if self.journal is not None:
            row["journal, MB"] = self.journal.bytes_on_disk / 1e6
            row |= quantiles("flush", self.flushes_ms)
        self.flushes_ms.clear()
        return row


def flown(flight: Flight, stations_km: list[float], compiled: Callable[[DepthFrame], object]) -> Iterator[Row]:
    """Fly from station to station and measure at each; ``compiled`` sees an image of each size before."""
    world = tunnel()
    fill, large = (period(map_frames.camera_of(*size_px), world) for size_px in (FILL_PX, TIMED_PX))
    for frame in (fill[0], large[0]):
        compiled(frame)
    before_mb = Usage.of(os.getpid()).rss_mb
    done = 0
    for station_km in stations_km:
        last = round(1e3 * station_km / PERIOD_M)
        for number in range(done, last):
            for frame in moved(fill, number):
                flight.put(frame)
            if sys.stderr.isatty():
                print(f"\r{(number + 1) * PERIOD_M / 1e3:.2f} km ", end="", file=sys.stderr, flush=True)
        row: Row = {"km": station_km}
        row |= flight.timed(moved(large, last), "new")
        row |= flight.timed(moved(large, 0), "return")
        done = last + 1
        gc.collect()
        row |= flight.sizes() | {"RSS, MB": Usage.of(os.getpid()).rss_mb - before_mb}
        row["map, MB/km"] = float(str(row["map, MB"])) / (done * PERIOD_M / 1e3)
        yield row


def main() -> None:
    """Fly, print the table, and write it if asked."""
    options = parser(__doc__)
    options.add_argument("--km", type=float, nargs="+", default=list(STATIONS_KM), help="stations, ascending")
    options.add_argument("--voxel", type=float, default=0.1, metavar="M", help="edge of a voxel")
    options.add_argument("--paged", type=int, metavar="MB", help="keep this much in memory, the rest in a journal")
    options.add_argument("--folder", type=Path, help="where the journal is made; by default where temporary files are")
    arguments = options.parse_args()
    settings = map_frames.octomap_model(arguments.voxel)
    with contextlib.ExitStack() as stack:
        journal = None
        if arguments.paged is not None:
            folder = stack.enter_context(tempfile.TemporaryDirectory(dir=arguments.folder))
            journal = stack.enter_context(Journal.open(Path(folder) / "map.journal", Header.of(settings, "world")))
        voxels = VoxelMap(settings) if journal is None else PagedMap(settings, journal, arguments.paged << 20)
        print(f"voxels of {arguments.voxel} m; of the memory that of the images is taken off", flush=True)
        rows: list[Row] = []
        for row in flown(Flight(voxels, journal), arguments.km, VoxelMap(settings).integrate):
            rows.append(row)
            print(f"{row['km']} km done", flush=True)
            if arguments.json:
                write(rows, arguments.json)
    show(rows, COLUMNS)


if __name__ == "__main__":
    main()
