"""Points in PCD files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sitl.mines.files.geometry import NO_TRIANGLES, Geometry, UnreadableError, single_step
from sitl.mines.files.through_open3d import points_of

_HEADER_BYTES = 65536
_CODES = {"F": "f", "I": "i", "U": "u"}


def read_pcd(path: Path) -> Geometry:
    """The points in a PCD file, in the precision that it has.

    Raises:
        UnreadableError: damaged, cut off, or compressed in double precision.
    """
    with path.open("rb") as file:
        begin = file.read(_HEADER_BYTES)
    head, found, rest = begin.partition(b"\nDATA ")
    header = {line.split()[0]: line.split()[1:] for line in head.decode("latin-1").splitlines() if line.strip()}
    if not found or not {"FIELDS", "SIZE", "TYPE", "POINTS"} <= header.keys():
        raise UnreadableError("the file is damaged or not what its name says: no header of a PCD file")
    kind, end_of_line, _ = rest.partition(b"\n")
    sizes = [header["SIZE"][header["FIELDS"].index(axis)] for axis in "xyz" if axis in header["FIELDS"]]
    if kind.strip() == b"binary":
        return _of_binary(path, header, len(head) + len(found) + len(kind) + len(end_of_line))
    if kind.strip() == b"binary_compressed" and "8" in sizes:
        raise UnreadableError(
            "compressed in double precision, which is not read: `pcl_convert_pcd_ascii_binary IN.pcd OUT.pcd 1` "
            "writes it as it is"
        )
    points = points_of(path)
    if len(points) != int(header["POINTS"][0]):
        raise UnreadableError(f"damaged: it should hold {header['POINTS'][0]} points and {len(points)} can be read")
    return Geometry(points, NO_TRIANGLES, step=0.0 if kind.strip() == b"ascii" else single_step(points))


def _of_binary(path: Path, header: dict[str, list[str]], offset: int) -> Geometry:
    """Read here: of coordinates in double precision Open3D makes zeros."""
    try:
        counts = header.get("COUNT", ["1"] * len(header["FIELDS"]))
        columns = zip(header["FIELDS"], header["TYPE"], header["SIZE"], counts, strict=True)
        # Fields that only fill space may have the same name.
        row = np.dtype(
            [(f"{k} {name}", f"<{_CODES[code]}{size}", int(n)) for k, (name, code, size, n) in enumerate(columns)]
        )
        names = [next(each for each in row.names or () if each.partition(" ")[2] == axis) for axis in "xyz"]
        said = int(header["POINTS"][0])
    except (ValueError, KeyError, TypeError, StopIteration) as error:
        raise UnreadableError(f"the file is damaged: its header cannot be read: {error}") from None
    there = (path.stat().st_size - offset) // row.itemsize
    if there < said:
        raise UnreadableError(f"damaged: it should hold {said} points and ends after {there}")
    rows = np.memmap(path, row, "r", offset, (said,)) if said else np.empty(0, row)
    points = np.column_stack([rows[name].reshape(said, -1)[:, 0] for name in names]).astype(np.float64)
    return Geometry(points, NO_TRIANGLES, step=single_step(points) if rows[names[0]].dtype.itemsize < 8 else 0.0)
