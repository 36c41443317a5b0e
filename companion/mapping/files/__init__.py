"""The map as files that other programs open: PLY, PCD, LAS and OctoMap's binary tree.

Each file is written beside its place and moved there when it is whole, so a program that is killed leaves the old file
or the new one, never half of one. A map with nothing in it gives valid files with nothing in them.
"""

from __future__ import annotations

from pathlib import Path

from companion.mapping import Mapper
from companion.mapping.files.las import write_las
from companion.mapping.files.octree import write_octree
from companion.mapping.files.pcd import write_pcd
from companion.mapping.files.ply import write_ply


def write_map(voxels: Mapper, folder: Path) -> dict[str, Path]:
    """Write map.ply, map.pcd, map.las and map.bt; by format, where they are.

    The first three hold the centres of the occupied voxels with a colour for their height, the last one also what is
    free.

    Args:
        voxels: the map.
        folder: is made when it does not exist.

    Raises:
        MapFileError: a voxel is too far away for the OctoMap format; the other files are there.
        OSError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    snapshot = voxels.snapshot()
    points_m = snapshot.occupied()
    paths = {format_: folder / f"map.{format_}" for format_ in ("ply", "pcd", "las", "bt")}
    write_ply(points_m, paths["ply"])
    write_pcd(points_m, paths["pcd"])
    write_las(points_m, paths["las"])
    write_octree(snapshot, paths["bt"])
    return paths


__all__ = ["write_las", "write_map", "write_octree", "write_pcd", "write_ply"]
