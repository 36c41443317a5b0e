"""Maps for the tests of files, made without the map engine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.mapping.voxels.chunks import NOTHING, OFFSETS
from companion.mapping.voxels.piece import MOST_CHUNKS, MapPiece, MapSource
from companion.model import FloatArray

FREE_VALUE, OCCUPIED_VALUE, THRESHOLD = -1234, 2345, 847
Voxel = tuple[int, int, int]


@dataclass(frozen=True)
class Held:
    """A map in memory (a `MapSource`)."""

    chunks: NDArray[np.int32]
    values: NDArray[np.int16]
    voxel_m: float = 0.1
    threshold: int = THRESHOLD

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        for first in range(0, len(self.chunks), most_chunks):
            yield MapPiece(self.chunks[first : first + most_chunks], self.values[first : first + most_chunks])


def of_voxels(voxels: dict[Voxel, int], voxel_m: float = 0.1) -> Held:
    """A map of some voxels with their log-odds in thousandths."""
    places = {tuple(offset): place for place, offset in enumerate(OFFSETS.tolist())}
    chunks: dict[Voxel, NDArray[np.int16]] = {}
    for (x, y, z), value in voxels.items():
        chunk = chunks.setdefault((x // 16, y // 16, z // 16), np.full(4096, NOTHING))
        chunk[places[x % 16, y % 16, z % 16]] = value
    return Held(
        np.array(list(chunks), np.int32).reshape(-1, 3), np.array(list(chunks.values())).reshape(-1, 4096), voxel_m
    )


def of_solid(inside_m: Callable[[FloatArray], FloatArray], lowest: Voxel, highest: Voxel, voxel_m: float = 0.1) -> Held:
    """What a perfect sensor in a hollow would leave: walls where the voxel holds a piece of them, free inside.

    Args:
        inside_m: for points (..., 3) in m how far they are inside the hollow; below zero in the rock.
        lowest: least chunk.
        highest: largest chunk.
        voxel_m: edge of a voxel.
    """
    chunks = np.stack(np.meshgrid(*map(np.arange, lowest, np.array(highest) + 1), indexing="ij"), axis=-1)
    numbers = chunks.reshape(-1, 3).astype(np.int32)
    corners = (16 * numbers[:, np.newaxis] + OFFSETS)[:, :, np.newaxis] + np.array(list(np.ndindex(2, 2, 2)))
    inside = inside_m(corners * voxel_m)
    values = np.full(inside.shape[:2], NOTHING)
    values[inside.min(axis=2) > 0.0] = FREE_VALUE
    values[(inside.min(axis=2) <= 0.0) & (inside.max(axis=2) >= 0.0)] = OCCUPIED_VALUE
    return Held(numbers, values, voxel_m)


def room(voxel_m: float = 0.1) -> Held:
    """A room on both sides of the origin, 3.37 x 2.91 x 2.53 m, turned by 0.4 rad, with unknown all around."""
    return of_solid(inside_room_m, (-2, -2, -2), (1, 1, 1), voxel_m)


ROOM_HALF_M = np.array([1.685, 1.455, 1.265])


def inside_room_m(points: FloatArray) -> FloatArray:
    """How far points are inside the room."""
    c, s = np.cos(0.4), np.sin(0.4)
    x, y = c * points[..., 0] + s * points[..., 1], c * points[..., 1] - s * points[..., 0]
    return np.asarray((ROOM_HALF_M - np.abs(np.stack([x, y, points[..., 2]], axis=-1))).min(axis=-1))


def scattered(seed: int = 0, chunks: int = 60) -> Held:
    """Random chunks, with every kind of value next to every other, equal blocks of all sizes, and unknown."""
    rng = np.random.default_rng(seed)
    where = np.unique(rng.integers(-5, 5, (chunks, 3)), axis=0).astype(np.int32)
    rng.shuffle(where)
    kinds = np.array([NOTHING, -2000, -1, 0, 400, THRESHOLD, 3511], np.int16)
    values = np.full((len(where), 4096), NOTHING)
    for row in range(len(where)):
        block = 8 ** int(rng.integers(0, 5))
        values[row] = np.repeat(rng.choice(kinds, 4096 // block), block)
        some = rng.integers(0, 4096, rng.integers(0, 60))
        values[row, some] = rng.integers(-2000, 3511, len(some))
    return Held(where, values)


def contents(source: MapSource) -> dict[Voxel, bytes]:
    """All that a map knows, by chunk: equal if and only if the maps are, in whatever order they give it."""
    return {
        (int(x), int(y), int(z)): values.astype(np.int16).tobytes()
        for piece in source.pieces()
        for (x, y, z), values in zip(piece.chunks, piece.values, strict=True)
        if (values != NOTHING).any()
    }


def centres_m(source: Held) -> FloatArray:
    """(n, 4096, 3) centres of all voxels."""
    return np.asarray((16 * source.chunks[:, np.newaxis] + OFFSETS + 0.5) * source.voxel_m)


def occupied_m(source: Held) -> FloatArray:
    """(n, 3) centres of the occupied voxels."""
    return np.asarray(centres_m(source)[source.values >= source.threshold])


EMPTY = Held(np.zeros((0, 3), np.int32), np.zeros((0, 4096), np.int16))
