"""Maps that are on the disk."""

from __future__ import annotations

from pathlib import Path

from companion.mapping.files.errors import MapFileError
from companion.mapping.files.export import Progress, silent
from companion.mapping.files.octree_read import open_octree
from companion.mapping.journal import Journal
from companion.mapping.voxels.piece import MapSource

_OCTREES = (".bt", ".ot")


def open_map(path: Path, progress: Progress = silent) -> MapSource:
    """The map in an OctoMap file (``.bt``, ``.ot``), or in the folder of a journal.

    A ``.bt`` file says only what is free and what is occupied: its voxels get OctoMap's least and greatest log-odds.

    Args:
        path: the file or the folder.
        progress: takes the share of it that was read, 0 to 1, from time to time.

    Raises:
        MapFileError: there is no such map, or the file is damaged: it is read once, from end to end, to know.
        CompanionError: the folder holds no journal that can be read.
        OSError: the file cannot be read.
    """
    if path.is_dir():
        return Journal.read_only(path, progress=progress)
    if path.suffix.lower() not in _OCTREES:
        raise MapFileError(
            f"{path}: not a map that can be read; give the folder of a journal (map.journal) or a file that ends in "
            f"{' or '.join(_OCTREES)}"
        )
    if not path.exists():
        raise MapFileError(f"{path}: there is no such file")
    return open_octree(path, progress)
