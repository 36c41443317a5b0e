"""Sequences of the TUM RGB-D benchmark: depth.txt, groundtruth.txt and a folder of PNG images; its world is z up."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.errors import InputError
from companion.geometry import rotation_of
from companion.mapping.datasets.posed_images import Listing, PosedImage
from companion.mapping.datasets.text import refused, text_of
from companion.model import FloatArray

WITHIN_S = 0.02
"""An image whose next pose is further away in time has none. The benchmark's own tool says so."""

IMAGES, POSES = "depth.txt", "groundtruth.txt"


def tum(folder: Path, within_s: float = WITHIN_S) -> Listing:
    """The depth images of a sequence, each with the pose next to it in time.

    Args:
        folder: it has depth.txt (time, file) and groundtruth.txt (time, x y z, qx qy qz qw of the optical frame).
        within_s: largest time between an image and its pose.

    Raises:
        InputError: a file is missing or has a line that cannot be, or no image has a pose.
    """
    images = list(_images(folder / IMAGES))
    poses = sorted(_poses(folder / POSES), key=lambda pose: pose[0])
    if not images or not poses:
        raise InputError(f"{folder / (POSES if images else IMAGES)}: has no lines but comments; get the data set again")
    times_s = np.array([pose[0] for pose in poses])
    found = []
    for t_s, path in images:
        after = int(np.searchsorted(times_s, t_s))
        near = min((k for k in (after - 1, after) if 0 <= k < len(poses)), key=lambda k: abs(times_s[k] - t_s))
        if abs(times_s[near] - t_s) <= within_s:
            found.append(PosedImage(path, t_s, *poses[near][1:]))
    if not found:
        raise InputError(
            f"{folder}: no image has a pose within {within_s:g} s: {IMAGES} goes from {images[0][0]:.3f} to "
            f"{images[-1][0]:.3f} s, {POSES} from {times_s[0]:.3f} to {times_s[-1]:.3f} s; they are of two sequences, "
            "or --within is too small"
        )
    lost = len(images) - len(found)
    return Listing(found, {f"have no pose within {within_s:g} s": lost} if lost else {})


def _images(path: Path) -> Iterator[tuple[float, Path]]:
    for number, line in _lines(path):
        words = line.split(maxsplit=1)
        if len(words) != 2:
            raise refused(path, number, line, "a time in s and the name of an image")
        yield _numbers(path, number, line, words[:1])[0], path.parent / words[1].strip()


def _poses(path: Path) -> Iterator[tuple[float, NDArray[np.float64], FloatArray]]:
    """Time, rotation and position of each line."""
    for number, line in _lines(path):
        words = line.split()
        if len(words) != 8:
            raise refused(path, number, line, "eight numbers: time, x y z, qx qy qz qw")
        t_s, x_m, y_m, z_m, qx, qy, qz, qw = _numbers(path, number, line, words)
        turn = rotation_of((qw, qx, qy, qz))
        if turn is None:
            raise refused(path, number, line, "a quaternion qx qy qz qw of length 1 in the last four")
        yield t_s, turn, np.array([x_m, y_m, z_m])


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    wanted = f"a sequence of TUM RGB-D has {IMAGES}, {POSES} and a folder of images"
    for number, line in enumerate(text_of(path, wanted).splitlines(), start=1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line


def _numbers(path: Path, number: int, line: str, words: list[str]) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = [math.nan]
    if not all(map(math.isfinite, numbers)):
        raise refused(path, number, line, "finite numbers")
    return numbers
