"""Points in LAS and LAZ files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from sitl.mines.files.geometry import NO_TRIANGLES, Geometry, UnreadableError

MOST_POINTS = 50_000_000
"""More would need more than 4 GB."""


def read_las(path: Path) -> Geometry:
    """The points of a LAS or LAZ file, in double precision.

    Raises:
        UnreadableError: damaged, cut off, or too many points.
    """
    import laspy
    from laspy.errors import LaspyException

    try:
        with laspy.open(path) as file:
            said = file.header.point_count
            if said > MOST_POINTS:
                raise UnreadableError(
                    f"holds {said} points, more than {MOST_POINTS}: thin it first, as "
                    f"`CloudCompare -SILENT -O {path.name} -C_EXPORT_FMT LAS -SS SPATIAL 0.05` does"
                )
            points = file.read().xyz if said else np.empty((0, 3))
    except (LaspyException, RuntimeError, ValueError, OSError, EOFError, struct.error) as error:
        raise UnreadableError(f"the file is damaged or not what its name says: {error}") from error
    if len(points) < said:
        raise UnreadableError(f"damaged: it should hold {said} points and ends after {len(points)}")
    return Geometry(np.asarray(points, np.float64), NO_TRIANGLES)
