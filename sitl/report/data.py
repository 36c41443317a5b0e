"""What a report is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
        settings_yaml: the settings of the flight, in plain text.
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
    settings_yaml: str
