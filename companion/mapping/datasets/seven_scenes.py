"""Sequences of 7-Scenes: frame-000000.depth.png in mm and frame-000000.pose.txt, from the camera to the world."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.errors import InputError
from companion.mapping.datasets.posed_images import Listing, PosedImage
from companion.mapping.datasets.text import refused, text_of

_IMAGE = re.compile(r"frame-(\d+)\.depth\.png")
_FRAMES_PER_S = 30.0
_SKEWED = 0.05
"""So far from a rotation a pose is no rounding any more."""


def seven_scenes(folder: Path, _within_s: float = 0.0) -> Listing:
    """The depth images of a sequence with their poses; each has one of its own, so no time is looked at.

    Images without a file of their pose, and those whose pose is not finite, which says that the tracking was lost, are
    left out.

    Raises:
        InputError: there are no such images here, or a pose that cannot be.
    """
    numbers = {}
    try:
        for path in folder.iterdir():
            if match := _IMAGE.fullmatch(path.name):
                numbers[int(match[1])] = path
        below = sorted(path.name for path in folder.iterdir() if path.is_dir() and any(path.glob("frame-*.depth.png")))
    except OSError as error:
        raise InputError(f"{folder}: cannot be read: {error.strerror}") from None
    if not numbers:
        which = f": it has the sequences {', '.join(below)}, give one of them" if below else ""
        raise InputError(
            f"{folder}: no image is called frame-000000.depth.png or similar, as those of 7-Scenes are"
            f"{which or '. Is --from its folder, and --format right?'}"
        )
    found, unposed, lost = [], 0, 0
    for number, path in sorted(numbers.items()):
        pose = path.with_name(path.name.replace(".depth.png", ".pose.txt"))
        if not pose.exists():
            unposed += 1
            continue
        matrix = _matrix(pose)
        if not np.isfinite(matrix).all():
            lost += 1
            continue
        found.append(PosedImage(path, number / _FRAMES_PER_S, _rotation(pose, matrix), matrix[:3, 3]))
    reasons = {"have no file of their pose": unposed, "have a pose that is not finite (tracking lost)": lost}
    left_out = {reason: count for reason, count in reasons.items() if count}
    if not found:
        raise InputError(f"{folder}: no image has a pose: {'; '.join(f'{n} {why}' for why, n in left_out.items())}")
    return Listing(found, left_out)


def _matrix(path: Path) -> NDArray[np.float64]:
    rows = [line for line in text_of(path, "each image of 7-Scenes has one").splitlines() if line.strip()]
    if len(rows) != 4:
        raise InputError(f"{path}: has {len(rows)} lines, expected a matrix of 4 x 4 numbers; get the data set again")
    matrix = np.empty((4, 4))
    for number, row in enumerate(rows):
        try:
            matrix[number] = [float(word) for word in row.split()]
        except ValueError:
            raise refused(path, number + 1, row, "four numbers") from None
    return matrix


def _rotation(path: Path, matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation next to the upper left of ``matrix``: seven digits leave it a little skewed."""
    left, sizes, right = np.linalg.svd(matrix[:3, :3])
    turn = left @ right
    if np.abs(sizes - 1.0).max() > _SKEWED or np.linalg.det(turn) < 0.0:
        raise InputError(
            f"{path}: is no pose: its rotation has determinant {np.linalg.det(matrix[:3, :3]):.3g} and stretches by "
            f"{sizes.min():.3g} to {sizes.max():.3g}, expected 1; get the data set again"
        )
    return np.asarray(turn)
