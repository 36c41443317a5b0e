"""Points in PCD, LAS and LAZ files, through the readers of maps: there is one for each format."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.mapping.files import MapFileError
from companion.mapping.files.point_cloud import READERS
from companion.mapping.voxels.piece import silent
from sitl.mines.files.geometry import NO_TRIANGLES, Geometry, UnreadableError, single_step

MOST_POINTS = 50_000_000
"""More would need more than 4 GB."""


def read_points(path: Path) -> Geometry:
    """The points of a file, those that are not finite among them.

    Raises:
        UnreadableError: damaged, cut off, in another unit than m, or too many points.
    """
    blocks, count = [], 0
    try:
        for block in READERS[path.suffix.lower()](path, silent):
            blocks.append(block)
            count += len(block)
            if count > MOST_POINTS:
                raise UnreadableError(
                    f"holds more than {MOST_POINTS} points: thin it first, as `CloudCompare -SILENT -O {path.name} "
                    "-SS SPATIAL 0.05` does"
                )
    except MapFileError as error:
        raise UnreadableError(str(error).removeprefix(f"{path}: ")) from None
    step = max((single_step(block) for block in blocks if block.dtype == np.float32), default=0.0)
    return Geometry(np.concatenate([np.empty((0, 3)), *blocks]), NO_TRIANGLES, step=step)
