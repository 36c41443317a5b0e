"""The way flown, where a map lies beside a record of it."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from companion.errors import InputError
from companion.model import FloatArray

ESTIMATED = "estimated_x_m", "estimated_y_m", "estimated_z_m"
PLAIN = "x_m", "y_m", "z_m"


def trajectories(folder: Path) -> dict[str, FloatArray]:
    """By file name, the (n, 3) positions in m of every ``trajectory*.csv`` in a folder.

    The map is in the frame in which the vehicle knew its place, so the columns estimated_x_m, estimated_y_m and
    estimated_z_m are taken where a file has them, else x_m, y_m and z_m. A row without a position is left out.

    Raises:
        InputError: such a file has no such columns, or cannot be read.
    """
    return {path.name: _positions(path) for path in sorted(folder.glob("trajectory*.csv"))}


def _positions(path: Path) -> FloatArray:
    found: list[tuple[float, ...]] = []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.DictReader(file)
            there = set(rows.fieldnames or ())
            columns = next((names for names in (ESTIMATED, PLAIN) if there.issuperset(names)), None)
            if columns is None:
                raise InputError(f"{path}: has no columns {', '.join(PLAIN)}; move it away to see the map without it")
            for row in rows:
                place = tuple(float(row[name] or "nan") for name in columns)
                if all(map(math.isfinite, place)):
                    found.append(place)
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read: {error}; move it away to see the map without it") from None
    return np.array(found, np.float64).reshape(-1, 3)
