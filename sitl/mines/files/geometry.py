"""What the readers of files return, and how they refuse."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Up = Literal["y", "z"]
"""Which axis of a file points up."""


class UnreadableError(Exception):
    """A file cannot be used; the text says why, without the file's name."""


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """The content of a file, in its own unit, axes and origin.

    Attributes:
        vertices: (n, 3) float64.
        triangles: (m, 3) int64 indices into ``vertices``; m = 0 for a cloud of points.
        up: the axis that points up, as the file or the standard of its format says.
        unit_m: the length of the file's unit, if it says so.
        step: the coarsest step in which the coordinates were kept, as of single precision far from 0; 0 for double.
        remarks: what was odd or left out, for people.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    up: Up = "z"
    unit_m: float = 1.0
    step: float = 0.0
    remarks: tuple[str, ...] = ()


def single_step(numbers: NDArray[np.floating]) -> float:
    """The step of single precision at the largest of some numbers."""
    largest = np.abs(numbers[np.isfinite(numbers)]).max(initial=0.0)
    return float(np.spacing(np.float32(largest)))


NO_TRIANGLES: NDArray[np.int64] = np.empty((0, 3), np.int64)
