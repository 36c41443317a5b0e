"""Where a vehicle starts in a mesh: given, or in the JSON file beside it."""

from __future__ import annotations

import json
import math
from pathlib import Path

from companion.errors import InputError
from companion.model import Pose

Start = tuple[float, float, float, float]
"""x, y, z in m and yaw in rad."""


def start_pose(start: Start) -> Pose:
    """The pose at rest at ``start``.

    Raises:
        InputError: a number is not finite.
    """
    if not all(map(math.isfinite, start)):
        raise InputError(f"start {start}: x, y, z and yaw must be finite numbers")
    x_m, y_m, z_m, yaw_rad = start
    return Pose(t_s=0.0, x_m=x_m, y_m=y_m, z_m=z_m, yaw_rad=yaw_rad)


def start_beside(path: Path) -> Start:
    """The start that the JSON file beside a mesh names, key ``start`` with ``x``, ``y``, ``z`` and ``yaw``.

    Raises:
        InputError: there is none, or it cannot be read.
    """
    beside = path.with_suffix(".json")
    if not beside.is_file():
        raise InputError(
            f"world {path}: where does the vehicle start? Give a start (x, y, z in m, yaw in rad), or put it into "
            f'{beside.name} beside the mesh: {{"start": {{"x": 0, "y": 0, "z": 1.5, "yaw": 0}}}}'
        )
    try:
        # Editors on Windows put a byte order mark in front.
        start = json.loads(beside.read_text(encoding="utf-8-sig"))["start"]
        return float(start["x"]), float(start["y"]), float(start["z"]), float(start["yaw"])
    except (ValueError, OSError) as error:
        raise InputError(f"start in {beside}: cannot be read: {error}") from error
    except (KeyError, TypeError) as error:
        raise InputError(
            f'start in {beside}: expected {{"start": {{"x": m, "y": m, "z": m, "yaw": rad}}}}, all numbers'
        ) from error
