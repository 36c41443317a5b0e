"""A room seen by a camera that turns in its midst, as the files of a data set: made without any code of the product."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from companion.model import FloatArray

Matrix = NDArray[np.float64]

LOW_M, HIGH_M = np.array([-1.8, -1.2, 0.0]), np.array([2.6, 2.2, 2.4])
EYE_M = np.array([0.3, 0.2, 1.1])
WIDTH, HEIGHT = 96, 72
OPTICS = (60.0, 58.0, 47.0, 36.5)
"""Focal lengths and centre in px: no two alike, so that none can be taken for another."""

VIEWS_DEG = [(yaw, pitch) for yaw in range(0, 360, 40) for pitch in (0.0, 35.0, -35.0)] + [(20.0, 90.0), (20.0, -90.0)]
"""Where the camera looks: all around, and straight down and up."""

Y_DOWN = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Worlds in which something else is up than z: as rows, where their axes are in the room's."""


def optical(yaw_deg: float, pitch_deg: float) -> Matrix:
    """Right, down and forward of a camera that looks there, in the room, as columns; pitch is positive downwards."""
    yaw, pitch = math.radians(yaw_deg), math.radians(pitch_deg)
    forward = np.array([math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), -math.sin(pitch)])
    right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
    return np.stack([right, np.cross(forward, right), forward], axis=1)


def depth_m(turn: Matrix, size: tuple[int, int] = (WIDTH, HEIGHT), optics: tuple[float, ...] = OPTICS) -> FloatArray:
    """(height, width) along the optical axis to the walls of the room."""
    (width, height), (fx, fy, cx, cy) = size, optics
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u, np.float64)], axis=-1) @ turn.T
    rays[rays == 0.0] = 1e-12
    walls = np.where(rays > 0.0, HIGH_M - EYE_M, LOW_M - EYE_M) / rays
    return np.asarray(walls.min(axis=-1))


def quaternion(turn: Matrix) -> FloatArray:
    """(4,) x, y, z, w: of the symmetric matrix of Bar-Itzhack (2000) the eigenvector of the largest eigenvalue."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = turn
    bar = [
        [xx - yy - zz, yx + xy, zx + xz, zy - yz],
        [yx + xy, yy - xx - zz, zy + yz, xz - zx],
        [zx + xz, zy + yz, zz - xx - yy, yx - xy],
        [zy - yz, xz - zx, yx - xy, xx + yy + zz],
    ]
    return np.asarray(np.linalg.eigh(np.array(bar) / 3.0)[1][:, -1])


def png(path: Path, values: FloatArray) -> None:
    """A 16-bit PNG."""
    Image.fromarray(np.round(values).astype(np.uint16)).save(path)


def tum(folder: Path, world: Matrix | None = None, units_per_m: float = 5000.0) -> Path:
    """A sequence as TUM's, with poses a little beside the images in time; its ``world`` is turned against the room."""
    axes = np.eye(3) if world is None else world
    (folder / "depth").mkdir(parents=True)
    images, poses = ["# depth maps", "# timestamp filename"], ["# ground truth trajectory"]
    for number, view in enumerate(VIEWS_DEG):
        turn, t_s = optical(*view), 1305031100.0 + number / 30.0
        depth = depth_m(turn) * units_per_m
        depth[:2] = 0.0  # nothing measured
        png(folder / "depth" / f"{t_s:.6f}.png", depth)
        images.append(f"{t_s:.6f} depth/{t_s:.6f}.png")
        numbers = [*(axes @ EYE_M), *quaternion(axes @ turn)]
        poses.append(f"{t_s + 0.004:.4f} " + " ".join(f"{part:.6f}" for part in numbers))
    (folder / "depth.txt").write_text("\n".join(images) + "\n")
    (folder / "groundtruth.txt").write_text("\n".join(poses) + "\n")
    return folder


def seven_scenes(folder: Path, world: Matrix = Y_DOWN) -> Path:
    """A sequence as those of 7-Scenes."""
    folder.mkdir(parents=True)
    for number, view in enumerate(VIEWS_DEG):
        turn = optical(*view)
        depth = depth_m(turn) * 1000.0
        depth[:2] = 65535.0  # nothing measured
        png(folder / f"frame-{number:06}.depth.png", depth)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = world @ turn, world @ EYE_M
        rows = ["\t ".join(f"{part: .7e}" for part in row) + "\t" for row in pose]
        (folder / f"frame-{number:06}.pose.txt").write_text("\n".join(rows) + "\n")
    return folder
