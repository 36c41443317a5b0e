"""What a report is made of, and how a long series is shown with fewer values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.control.graph import Graph
from companion.control.left_out import LeftOut
from sitl.sim.flight_log import FlightLog

Array = NDArray[np.float64]
Points = NDArray[np.floating]
"""(n, 3) points in the world frame, in m."""


@dataclass(frozen=True, slots=True, eq=False)
class ReportData:
    """Everything that a report shows. Any of the arrays may be empty, and ``flights`` too.

    Attributes:
        title: the headline, in plain text.
        summary: the content of summary.json. Keys that are not there are shown as not known.
        vertices_m: (n, 3) vertices of the true surface.
        triangles: (m, 3) indices into ``vertices_m``.
        flights: one log for each vehicle.
        progress: (k, 2) time in s and completeness from 0 to 1.
        occupied_m: (v, 3) centres of the occupied voxels of the map.
        voxel_m: their edge length.
        missed_m: (w, 3) points of the true surface that could be seen and are not in the map.
        margin_m: d_s, the distance that the vehicle keeps to walls.
        critical_margin_m: d_c, the distance at which it stops to turn (paper eq. (12)).
        height_m: H, the flying height above ground.
        left_out: what was seen and not looked into.
        settings_yaml: the settings of the flight, in plain text.
        graphs: the navigation graph of each vehicle.
        explored_ticks: rows of each log that belong to the exploring, what follows is the way home; empty: all do.
    """

    title: str
    summary: Mapping[str, object]
    vertices_m: Points
    triangles: NDArray[np.integer]
    flights: tuple[FlightLog, ...]
    progress: Array
    occupied_m: Points
    voxel_m: float
    missed_m: Points
    margin_m: float
    critical_margin_m: float
    height_m: float
    left_out: tuple[LeftOut, ...]
    settings_yaml: str
    graphs: tuple[Graph, ...] = ()
    explored_ticks: tuple[int, ...] = ()

    def homeward_from(self, index: int) -> int:
        """The row of a vehicle's log with which its way home begins; that behind the last where it has none."""
        return self.explored_ticks[index] if self.explored_ticks else len(self.flights[index])


def thinned(t_s: Array, values: Array, bins: int) -> tuple[Array, Array]:
    """The least and the greatest value of each of at most ``bins`` pieces, in their order.

    A dip of one sample stays visible. A piece of nothing but NaN leaves one, so gaps stay gaps.
    """
    size = -(-len(values) // bins)
    if size <= 2:
        return t_s, values
    padded = np.concatenate([values, np.full(-len(values) % size, np.nan)]).reshape(-1, size)
    known = np.isfinite(padded)
    lowest = np.argmin(np.where(known, padded, np.inf), axis=1)
    highest = np.argmax(np.where(known, padded, -np.inf), axis=1)
    picked = np.sort(np.stack([lowest, highest], axis=1), axis=1) + size * np.arange(len(padded))[:, None]
    picked = np.minimum(picked.ravel(), len(values) - 1)
    return t_s[picked], values[picked]


def stretches(modes: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where each run of equal values begins, and the index after its end."""
    changes = np.flatnonzero(np.diff(modes)) + 1
    bounds = np.unique(np.concatenate([[0], changes, [len(modes)]]))
    return bounds[:-1], bounds[1:]
