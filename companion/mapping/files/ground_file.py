"""The known ground as a file, `known_ground.npz`: the cells of the plan by levels; docs/map.md."""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.lib.npyio import NpzFile

from companion.control.ground_grid import GIVEN_UP, MOST_LEVELS, GroundGrid
from companion.control.known_ground import MOST_CELLS, Window
from companion.errors import InputError
from companion.mapping.files.whole import whole_file

GROUND_NAME = "known_ground.npz"
"""Its name beside a map, and in the recording of a flight that went on from it."""

_NAMES = {"cells", "ground_dm", "belief", "blocked", "low_m", "cell_m"}

_DAMAGE = (ValueError, LookupError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error)
"""What comes of a damaged archive: flags that say it is encrypted or packed otherwise, sizes that no memory holds."""


def write_known_ground(ground: Window, path: Path) -> None:
    """Write what is known of the ground; whole or not at all.

    Raises:
        OSError: it cannot be written; what was there before still is.
    """
    with whole_file(path) as file:
        _save(ground, file)


def ground_content(ground: Window) -> bytes:
    """The content of the file that `write_known_ground` writes."""
    file = io.BytesIO()
    _save(ground, file)
    return file.getvalue()


def read_known_ground(path: Path) -> Window:
    """What `write_known_ground` has written.

    Raises:
        InputError: there is no such file, or it is not one that can be.
    """
    try:
        # Opened here: of what is no archive numpy leaves the file open.
        with path.open("rb") as opened:
            return _load(opened, str(path))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}") from None


def ground_of_content(content: bytes, name: str) -> Window:
    """What `ground_content` was made of.

    Args:
        content: of the file.
        name: of where it comes from, for people.

    Raises:
        InputError: it is none, or damaged.
    """
    return _load(io.BytesIO(content), name)


def _save(ground: Window, file: BinaryIO) -> None:
    np.savez_compressed(
        file,
        cells=ground.grid.cells,
        ground_dm=ground.grid.ground_dm,
        belief=ground.grid.belief,
        blocked=ground.blocked,
        low_m=np.array([ground.x_m, ground.y_m]),
        cell_m=np.array(ground.cell_m),
    )


def _load(opened: BinaryIO, path: str) -> Window:
    try:
        file = np.load(opened, allow_pickle=False)
        if not isinstance(file, NpzFile) or not _NAMES.issubset(file.files):
            raise InputError(f"{path}: is no known ground: it lacks one of {', '.join(sorted(_NAMES))}")
        arrays = {name: file[name] for name in _NAMES}
    except _DAMAGE as error:
        raise InputError(f"{path}: is no known ground, or damaged: {error}") from None
    cells, ground_dm, belief, blocked = (arrays[name] for name in ("cells", "ground_dm", "belief", "blocked"))
    low_m, cell_m = arrays["low_m"], arrays["cell_m"]
    wrong = (
        ("cells", cells.dtype == np.uint8 and cells.ndim == 3 and cells.max(initial=0) <= GIVEN_UP),
        ("cells", cells.ndim == 3 and 0 < cells.shape[0] <= MOST_LEVELS and max(cells.shape[1:]) <= MOST_CELLS),
        ("ground_dm", ground_dm.dtype == np.int16 and ground_dm.shape == cells.shape),
        ("belief", belief.dtype == np.int8 and belief.shape == cells.shape),
        ("blocked", blocked.dtype == np.int64 and blocked.ndim == 2 and blocked.shape[1] == 3),
        ("low_m", low_m.dtype == np.float64 and low_m.shape == (2,) and bool(np.isfinite(low_m).all())),
        ("cell_m", cell_m.dtype == np.float64 and cell_m.shape == () and 0.0 < float(cell_m) < np.inf),
    )
    for name, right in wrong:
        if not right:
            found = f"{arrays[name].dtype} {arrays[name].shape}"
            raise InputError(f"{path}: {name}: {found} is not what a flight writes; the file is damaged")
    return Window(GroundGrid(cells, ground_dm, belief), blocked, float(low_m[0]), float(low_m[1]), float(cell_m))
