"""What the files of a map cost: seconds, size and the most memory, for tunnels of 0.1, 1 and 10 km.

Each line is a process of its own, so that its peak of memory is its own. The tunnel winds, as OctoMap's cube ends
3.2 km from the origin with voxels of 0.1 m; its chunks are made while they are asked for, which costs the seconds in
the line `reading`, and no memory.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench import common
from companion.mapping.files import FORMATS, open_map, write, write_map, write_mesh
from companion.mapping.voxels.chunks import NOTHING, OFFSETS
from companion.mapping.voxels.piece import MOST_CHUNKS, MapPiece

COLUMNS = ("chunks", "what", "seconds", "megabytes", "peak_mb")
CHUNKS = (1000, 10_000, 90_000)
READING, MISSION, MESHES = "reading", "mission", ("mesh.ply", "mesh.obj")
READ_BACK = ("read bt", "read ot")

_ACROSS = 3
_RADIUS_VOXELS = 21.0
_ROW_CHUNKS = 300
"""A drift is 480 m long; the next one lies beside it."""


class Tunnel:
    """Parallel drifts of 4.2 m diameter, 3 x 3 chunks across (a `MapSource`).

    Free inside, two voxels of wall with log-odds that vary from voxel to voxel, unknown behind.

    Args:
        chunks: how many, about: whole cross-sections.
    """

    voxel_m = 0.1
    threshold = 847

    def __init__(self, chunks: int) -> None:
        self._sections = chunks // _ACROSS**2
        rng = np.random.default_rng(0)
        across = np.array(list(np.ndindex(_ACROSS, _ACROSS)))
        self._section = np.column_stack([np.zeros(len(across), np.int64), across]).astype(np.int32)
        self._variants = [self._walls(rng) for _ in range(8)]

    def _walls(self, rng: np.random.Generator) -> NDArray[np.int16]:
        voxels = 16 * self._section[:, np.newaxis] + OFFSETS + 0.5
        middle = 8.0 * _ACROSS
        ripple = np.sin(voxels[..., 0] * np.pi / 8.0)
        depth = np.hypot(voxels[..., 1] - middle, voxels[..., 2] - middle) - _RADIUS_VOXELS - ripple
        values = np.full(depth.shape, NOTHING)
        values[depth < 0.0] = -2000
        near = (depth >= -2.0) & (depth < 0.0)
        values[near] = rng.integers(-2000, -400, np.count_nonzero(near))
        wall = (depth >= 0.0) & (depth < 2.0)
        values[wall] = rng.integers(847, 3511, np.count_nonzero(wall))
        return values

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """Whole cross-sections, as many as fit."""
        at_once = max(most_chunks // _ACROSS**2, 1)
        for first in range(0, self._sections, at_once):
            sections = range(first, min(first + at_once, self._sections))
            moved = [
                self._section + np.array([s % _ROW_CHUNKS, (_ACROSS + 1) * (s // _ROW_CHUNKS), 0], np.int32)
                for s in sections
            ]
            yield MapPiece(np.concatenate(moved), np.concatenate([self._variants[s % 8] for s in sections]))


def measured(what: str, chunks: int, folder: Path) -> common.Row:
    """One line, in this process, after a small map has been through the same, so that everything is compiled."""
    for source in (Tunnel(20), Tunnel(chunks)):
        path = _made(what, source, folder)
        began_s = time.perf_counter()
        written = _done(what, source, path)
        seconds = time.perf_counter() - began_s
    return {
        "chunks": chunks,
        "what": what,
        "seconds": seconds,
        "megabytes": sum(file.stat().st_size for file in written) / 1e6,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }


def _made(what: str, source: Tunnel, folder: Path) -> Path:
    """Where the file is to be, or what is to be read."""
    path = folder / (what if "." in what else f"map.{what.removeprefix('read ')}")
    if what in READ_BACK:
        write(source, path)
    return path


def _done(what: str, source: Tunnel, path: Path) -> list[Path]:
    if what == READING:
        for _ in source.pieces():
            pass
        return []
    if what == MISSION:
        return list(write_map(source, path.parent).values())
    if what in READ_BACK:
        for _ in open_map(path).pieces():
            pass
    else:
        (write_mesh if what in MESHES else write)(source, path)
    return [path]


def main() -> None:
    """Run the lines and print them."""
    options = common.parser(__doc__)
    options.add_argument("--chunks", type=int, nargs="+", default=CHUNKS)
    options.add_argument("--what", nargs="+", default=[READING, *FORMATS, MISSION, *MESHES, *READ_BACK])
    options.add_argument("--line", action="store_true", help="one line in this process, as JSON")
    given = options.parse_args()
    if given.line:
        with tempfile.TemporaryDirectory() as folder:
            print(json.dumps(measured(given.what[0], given.chunks[0], Path(folder))))
        return
    rows = []
    for chunks in given.chunks:
        for what in given.what:
            command = [sys.executable, "-m", "bench.map.files", "--line", "--chunks", str(chunks), "--what", what]
            line = subprocess.run(command, capture_output=True, text=True, check=True).stdout  # noqa: S603 - our own
            rows.append(json.loads(line))
    common.show(rows, COLUMNS, given.json)


if __name__ == "__main__":
    main()
