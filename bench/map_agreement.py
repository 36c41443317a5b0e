"""How long one depth image takes to get into the map: ``python -m bench.map_frame [--json FILE]``.

The images are those of a straight box tunnel, 4 m wide and 3 m high, from a vehicle that flies through it at 0.5 m/s
with 10 images a second and looks to the left and right, with depth noise of 0.002 z² and 2 % of the pixels missing.
Frames are integrated into a growing map, as in flight; the first one, which compiles, is left out. Processor time of
the one thread is given beside the time on the clock: they differ when something else wants the processor.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import time
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path

import numpy as np

from companion.config.mapping import MapSettings
from companion.geometry import camera_to_world, pixel_tangents
from companion.mapping import VoxelMap
from companion.model import Camera, DepthFrame, Pose

SIZES_PX = ((160, 120), (640, 480))
VOXELS_M = (0.1, 0.05)
RANGES_M = (6.0, 10.0)
FRAMES = 100

LOW_M, HIGH_M = np.array([-5.0, -2.0, 0.0]), np.array([60.0, 2.0, 3.0])


@dataclass(frozen=True, slots=True)
class Row:
    """The times of one combination of image, voxel and range."""

    width_px: int
    height_px: int
    voxel_m: float
    range_m: float
    median_ms: float
    p99_ms: float
    median_cpu_ms: float
    voxels_per_frame: int
    memory_mb: float


def tunnel_frames(width_px: int, height_px: int) -> list[DepthFrame]:
    """The images of one flight, from a camera with 86° x 57°."""
    camera = Camera(
        width_px=width_px,
        height_px=height_px,
        fx_px=width_px / 2.0 / math.tan(math.radians(43.0)),
        fy_px=height_px / 2.0 / math.tan(math.radians(28.5)),
        cx_px=(width_px - 1) / 2.0,
        cy_px=(height_px - 1) / 2.0,
        min_range_m=0.3,
        max_range_m=10.0,
    )
    random = np.random.default_rng(0)
    left, up = pixel_tangents(camera)
    rays = np.stack(np.broadcast_arrays(1.0, left[np.newaxis, :], up[:, np.newaxis]), axis=-1)
    frames: list[DepthFrame] = []
    for number in range(FRAMES + 1):
        t_s = 0.1 * number
        pose = Pose(t_s, 0.5 * t_s, 0.5 * math.sin(0.5 * t_s), 1.5, 0.7 * math.sin(0.4 * t_s))
        axes, origin_m = camera_to_world(camera, pose)
        directions = rays @ axes.T
        with np.errstate(divide="ignore"):
            depth_m = np.where(directions > 0.0, (HIGH_M - origin_m) / directions, (LOW_M - origin_m) / directions)
        depth_m = depth_m.min(axis=-1)
        depth_m += random.normal(size=depth_m.shape) * 0.002 * depth_m**2
        depth_m[random.random(depth_m.shape) < 0.02] = np.nan
        frames.append(DepthFrame(t_s, depth_m.astype(np.float32), camera, pose))
    return frames


def measured(frames: list[DepthFrame], voxel_m: float, range_m: float) -> Row:
    """The times of these frames on one map."""
    voxels = VoxelMap(MapSettings(voxel_m=voxel_m, max_range_m=range_m))
    voxels.integrate(frames[0])
    clock_ms, cpu_ms, touched = [], [], []
    for frame in frames[1:]:
        start, start_cpu = time.perf_counter(), time.thread_time()
        report = voxels.integrate(frame)
        clock_ms.append(1000.0 * (time.perf_counter() - start))
        cpu_ms.append(1000.0 * (time.thread_time() - start_cpu))
        touched.append(report.hits + report.misses)
    return Row(
        width_px=frames[0].camera.width_px,
        height_px=frames[0].camera.height_px,
        voxel_m=voxel_m,
        range_m=range_m,
        median_ms=float(np.median(clock_ms)),
        p99_ms=float(np.percentile(clock_ms, 99)),
        median_cpu_ms=float(np.median(cpu_ms)),
        voxels_per_frame=int(np.median(touched)),
        memory_mb=voxels.memory_bytes / 1e6,
    )


def main() -> None:
    """Measure every combination, print a table, and write it down if asked."""
    parser = argparse.ArgumentParser(description="How long one depth image takes to get into the map.")
    parser.add_argument("--json", type=Path, help="write the numbers to this file too")
    arguments = parser.parse_args()

    load = os.getloadavg()[0]
    print(f"{platform.machine()}, {os.cpu_count()} processors, load {load:.1f} at the start; {FRAMES} frames each")
    print("    image  voxel m  range m  median ms   p99 ms   cpu ms    voxels     MB")
    rows: list[Row] = []
    for width_px, height_px in SIZES_PX:
        frames = tunnel_frames(width_px, height_px)
        for voxel_m, range_m in product(VOXELS_M, RANGES_M):
            row = measured(frames, voxel_m, range_m)
            rows.append(row)
            print(
                f"{f'{width_px}x{height_px}':>9} {voxel_m:8.2f} {range_m:8.0f} {row.median_ms:10.2f} {row.p99_ms:8.2f} "
                f"{row.median_cpu_ms:8.2f} {row.voxels_per_frame:9d} {row.memory_mb:6.1f}"
            )
    if arguments.json:
        report = {"machine": platform.machine(), "load": load, "frames": FRAMES, "rows": [asdict(row) for row in rows]}
        arguments.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
