"""What a world is: one triangle mesh and where a vehicle may start in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.model import Pose
from sitl.mines.conditions import NONE, Conditions


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A mine, cave or tunnel as a triangle mesh, in the world frame (east-north-up, m).

    Attributes:
        name: what a report calls it; it holds the seed of a world that was drawn at random.
        vertices_m: (n, 3) float32.
        triangles: (m, 3) int32 indices into ``vertices_m``. The triangles of generated worlds face the free space;
            those of a mesh file may face anywhere.
        start: where the vehicle starts, or ``None`` where that is left to whoever flies it.
        start_area_m: (k, 3) points on the floor along the middle of the drifts, from which a start may be drawn; empty
            for mesh files.
        description: one sentence for people.
        origin_m: what was taken away from the coordinates of a mesh file far from 0, in m: adding it gives them back.
        remarks: what people should know of a mesh file: its extent, what was odd, what was left out.
        unit_m: what one unit of a mesh file is.
        conditions: what there is besides rock.
    """

    name: str
    vertices_m: NDArray[np.float32]
    triangles: NDArray[np.int32]
    start: Pose | None
    start_area_m: NDArray[np.float64]
    description: str
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    remarks: tuple[str, ...] = ()
    unit_m: float = 1.0
    conditions: Conditions = NONE

    def named(self, x_m: float, y_m: float, z_m: float) -> str:
        """A place in words, from the origin that its file has, in m."""
        x_0, y_0, z_0 = self.origin_m
        return f"({x_m + x_0:.2f}, {y_m + y_0:.2f}, {z_m + z_0:.2f})" + (" m" if self.unit_m != 1.0 else "")

    def in_file(self, x_m: float, y_m: float, z_m: float) -> tuple[str, str, str]:
        """A place as ``--start`` takes it, from the origin and in the unit that its file has, to the cm."""
        x, y, z = (np.add((x_m, y_m, z_m), self.origin_m) / self.unit_m).tolist()
        return f"{x:.{self._digits}f}", f"{y:.{self._digits}f}", f"{z:.{self._digits}f}"

    def typed(self, places_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """The places (n, 3) that `in_file` writes for some: these rounded to about a cm."""
        in_file = np.round((places_m + self.origin_m) / self.unit_m, self._digits)
        return np.asarray(in_file * self.unit_m - self.origin_m)

    @property
    def _digits(self) -> int:
        return max(0, math.ceil(2.0 + math.log10(self.unit_m)))

    def bounds(self) -> str:
        """From where to where it reaches, in words, from the origin that its file has, in m."""
        used = self.vertices_m[self.triangles].reshape(-1, 3)
        low, high = used.min(axis=0) + self.origin_m, used.max(axis=0) + self.origin_m
        return ", ".join(f"{axis} {a:.2f} to {b:.2f}" for axis, a, b in zip("xyz", low, high, strict=True))
