"""Small journals for the tests, and what is in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.config.mapping import MapSettings
from companion.mapping.journal import Header, Journal
from companion.mapping.voxels.chunks import NOTHING, VOLUME
from companion.mapping.voxels.piece import MapPiece, MapSource

HEADER = Header.of(MapSettings())

Chunk = tuple[int, int, int]
Contents = dict[Chunk, bytes]


def alike(value: int) -> NDArray[np.int16]:
    """(4096,) one value throughout: the shortest record."""
    return np.full(VOLUME, value, np.int16)


def surface(seed: int) -> NDArray[np.int16]:
    """(4096,) as a chunk with a wall in it looks: free, unknown, and some bricks with a few or many values."""
    random = np.random.default_rng(seed)
    bricks = np.full((64, 64), -1992, np.int16)
    bricks[random.random(64) < 0.3] = NOTHING
    for brick in random.permutation(64)[:20]:
        bricks[brick] = random.choice(random.integers(-1992, 3477, int(random.integers(2, 60))), 64)
    return bricks.reshape(VOLUME)


def piece(chunks: dict[Chunk, NDArray[np.int16]]) -> MapPiece:
    """A piece of these chunks."""
    values = np.array(list(chunks.values()), np.int16).reshape(-1, VOLUME)
    return MapPiece(np.array(list(chunks), np.int32).reshape(-1, 3), values)


def held(source: MapSource) -> Contents:
    """Everything that a map gives, by chunk; a chunk that is given twice fails."""
    found: Contents = {}
    for part in source.pieces(7):
        for chunk, values in zip(part.chunks.tolist(), part.values, strict=True):
            x, y, z = chunk
            assert (x, y, z) not in found
            found[x, y, z] = values.tobytes()
    return found


def written(folder: Path, steps: list[dict[Chunk, NDArray[np.int16]]], segment_bytes: int = 16 << 20) -> Contents:
    """Make a journal, one commit for each step, and close it; what it holds."""
    wanted: Contents = {}
    with Journal.open(folder, HEADER, segment_bytes=segment_bytes) as journal:
        for step in steps:
            journal.append(piece(step))
            journal.commit()
            wanted.update({chunk: values.tobytes() for chunk, values in step.items()})
    return wanted
