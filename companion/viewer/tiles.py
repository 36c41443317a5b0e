"""A map in tiles, for the eye: it may grow, and of what changed only the tiles around it are drawn anew.

Two things are known of a voxel beyond its state, both from what is free above and below it: whether it is roof, which
hides what is under it from those who look down, and whether it is ground, which is drawn brighter than a wall.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from companion.mapping.voxels.chunks import EDGE, OFFSETS, PLACES, VOLUME
from companion.mapping.voxels.lookup import FREE, OCCUPIED
from companion.mapping.voxels.piece import MapSnapshot
from companion.model import FloatArray
from companion.viewer.voxels import PIECE, PackedVoxels, State, cubes

TILE = 8
"""Chunks along the edge of a tile: with voxels of 0.1 m it is a cube of 12.8 m."""

COARSEST = 4
"""Cubes are of 1, 2, 4, 8 or 16 voxels."""

_REACH_M = 0.35
"""Free space this near above or below makes ground and roof: surfaces are some voxels thick."""

_MOST_REACH = 8

Tile = tuple[int, int, int]
"""x, y and z of a tile: it has the chunks from (8 x, 8 y, 8 z) on."""


class _Plane(IntEnum):
    """What is kept of every voxel, a bit each; the first three are `State`."""

    OCCUPIED = 0
    FREE = 1
    UNDECIDED = 2
    ROOF = 3
    GROUND = 4


@dataclass(frozen=True, slots=True)
class Shown:
    """Which part of a map is wanted.

    Attributes:
        roof: whether roofs are.
        low_m: nothing below this height.
        high_m: nothing above this one.
    """

    roof: bool = False
    low_m: float = -math.inf
    high_m: float = math.inf


@dataclass(frozen=True, slots=True)
class TileCloud:
    """What is drawn of a tile: cubes of one state.

    Attributes:
        cubes: (n, 3) int16 which cubes of the tile, counted from its corner.
        heights_m: (n,) heights of their centres.
        ground: (n,) whether they are ground.
    """

    cubes: NDArray[np.int16]
    heights_m: NDArray[np.float32]
    ground: NDArray[np.bool_]


class TiledMap:
    """The voxels of a map by tile.

    Args:
        voxel_m: edge of a voxel.
    """

    def __init__(self, voxel_m: float) -> None:
        self.voxel_m = voxel_m
        self._rows: dict[Tile, int] = {}
        self._planes = np.zeros((64, len(_Plane), VOLUME // 8), np.uint8)
        self._counts = np.zeros((64, len(State), COARSEST + 1), np.int32)
        self._total = np.zeros((len(State), COARSEST + 1), np.int64)
        self._in_tile: defaultdict[Tile, list[tuple[Tile, int]]] = defaultdict(list)
        self._reach = min(max(round(_REACH_M / voxel_m), 1), _MOST_REACH)
        self._low = np.full(3, np.iinfo(np.int32).max)
        self._high = np.full(3, np.iinfo(np.int32).min)

    @property
    def chunks(self) -> int:
        """How many it has."""
        return len(self._rows)

    @property
    def tiles(self) -> Iterator[Tile]:
        """All that have something in them."""
        return iter(self._in_tile)

    @property
    def bounds_m(self) -> tuple[FloatArray, FloatArray] | None:
        """Two (3,) corners of a box around all chunks that ever had something occupied in them; None before."""
        if (self._low > self._high).any():
            return None
        edge_m = EDGE * self.voxel_m
        return self._low * edge_m, (self._high + 1) * edge_m

    @property
    def memory_bytes(self) -> int:
        """What its voxels take."""
        return self._planes.nbytes + self._counts.nbytes

    def counts(self) -> NDArray[np.int64]:
        """(3, 5) by `State` and level, how many cubes of 2^level voxels are shown."""
        return self._total.copy()

    def put(self, voxels: PackedVoxels) -> set[Tile]:
        """Take chunks in place of what it had of them.

        Returns:
            The tiles that look different now.
        """
        for first in range(0, len(voxels.chunks), PIECE):
            self._store(voxels.chunks[first : first + PIECE], voxels.bits[:, first : first + PIECE])
        # What is free in a chunk makes roof and ground in those above and below it.
        around = {
            (x, y, z + up) for x, y, z in map(tuple, voxels.chunks.tolist()) for up in (-1, 0, 1)
        } & self._rows.keys()
        touched = sorted(around)
        for first in range(0, len(touched), PIECE):
            self._classify(touched[first : first + PIECE])
        return {_tile_of(chunk) for chunk in touched}

    def cloud(self, tile: Tile, state: State, shown: Shown, level: int, every: int = 1) -> TileCloud:
        """The cubes of 2^level voxels of a tile that are shown.

        Args:
            tile: which one.
            state: of the voxels.
            shown: the part of the map that is wanted.
            level: 0 to 4.
            every: only this many-th chunk, where even the coarsest cubes are too many.
        """
        members = [(chunk, row) for chunk, row in self._in_tile.get(tile, ()) if row % every == 0]
        rows = np.array([row for _, row in members], np.int64)
        planes = self._planes[rows]
        bits = planes[:, state]
        if state is State.OCCUPIED and not shown.roof:
            bits = bits & ~planes[:, _Plane.ROOF]
        at, places = np.nonzero(cubes(bits, level, state is State.FREE))
        ground = cubes(planes[:, _Plane.GROUND], level, by_half=False)[at, places]
        corner = np.array([chunk for chunk, _ in members], np.int32).reshape(-1, 3) - np.array(tile, np.int32) * TILE
        # One of each cube's voxels stands for it: the first in Morton order is its corner.
        inside = _OFFSETS_AT[level][places]
        numbers = corner[at] * (EDGE >> level) + inside
        edge_m = self.voxel_m * (1 << level)
        heights_m = ((numbers[:, 2] + 0.5) * edge_m + tile[2] * TILE * EDGE * self.voxel_m).astype(np.float32)
        kept = (heights_m >= shown.low_m) & (heights_m <= shown.high_m)
        return TileCloud(numbers[kept].astype(np.int16), heights_m[kept], ground[kept])

    def corner_m(self, tile: Tile) -> tuple[float, float, float]:
        """Where a tile begins."""
        edge_m = TILE * EDGE * self.voxel_m
        return tile[0] * edge_m, tile[1] * edge_m, tile[2] * edge_m

    def _store(self, chunks: NDArray[np.int32], bits: NDArray[np.uint8]) -> None:
        rows = np.empty(len(chunks), np.int64)
        for number, (x, y, z) in enumerate(chunks.tolist()):
            chunk = (x, y, z)
            row = self._rows.get(chunk)
            if row is None:
                row = self._rows[chunk] = len(self._rows)
                self._in_tile[_tile_of(chunk)].append((chunk, row))
            rows[number] = row
        while len(self._rows) > len(self._planes):
            self._planes = np.concatenate([self._planes, np.zeros_like(self._planes)])
            self._counts = np.concatenate([self._counts, np.zeros_like(self._counts)])
        with_walls = chunks[bits[State.OCCUPIED].any(axis=1)]
        self._low = np.minimum(self._low, with_walls.min(axis=0, initial=np.iinfo(np.int32).max))
        self._high = np.maximum(self._high, with_walls.max(axis=0, initial=np.iinfo(np.int32).min))
        self._total -= self._counts[rows].sum(axis=0)
        for state in State:
            self._planes[rows, state] = bits[state]
            for level in range(COARSEST + 1):
                shown = cubes(bits[state], level, state is State.FREE)
                self._counts[rows, state, level] = shown.sum(axis=1)
        self._total += self._counts[rows].sum(axis=0)

    def _classify(self, chunks: list[Tile]) -> None:
        """Find out anew what of these chunks is roof and what is ground."""
        reach = self._reach
        rows = np.array([self._rows[chunk] for chunk in chunks])
        free = np.zeros((len(rows), EDGE, EDGE, EDGE + 2 * reach), np.bool_)
        free[..., reach:-reach] = self._dense(rows, _Plane.FREE)
        for up, there, taken in ((-1, slice(None, reach), slice(-reach, None)), (1, slice(-reach, None), slice(reach))):
            beside = [self._rows.get((x, y, z + up), -1) for x, y, z in chunks]
            known = np.array(beside) >= 0
            free[known, ..., there] = self._dense(np.array(beside)[known], _Plane.FREE)[..., taken]
        occupied = self._dense(rows, _Plane.OCCUPIED)
        below, above = np.zeros_like(occupied), np.zeros_like(occupied)
        for step in range(1, reach + 1):
            below |= free[..., reach - step : reach - step + EDGE]
            above |= free[..., reach + step : reach + step + EDGE]
        self._planes[rows, _Plane.ROOF] = _in_morton_order(occupied & below & ~above)
        self._planes[rows, _Plane.GROUND] = _in_morton_order(occupied & above)

    def _dense(self, rows: NDArray[np.int64], plane: _Plane) -> NDArray[np.bool_]:
        """(n, 16, 16, 16) voxels by x, y and z."""
        return np.unpackbits(self._planes[rows, plane], axis=1, bitorder="little").view(np.bool_)[:, PLACES]


def packed_snapshot(snapshot: MapSnapshot) -> PackedVoxels:
    """What a snapshot tells of its chunks; undecided voxels are unknown in it."""
    bits = np.zeros((len(State), len(snapshot.chunks), VOLUME // 8), np.uint8)
    bits[State.OCCUPIED] = np.packbits(snapshot.states == OCCUPIED, axis=1, bitorder="little")
    bits[State.FREE] = np.packbits(snapshot.states == FREE, axis=1, bitorder="little")
    return PackedVoxels(snapshot.voxel_m, snapshot.chunks, bits)


def finest(counts: NDArray[np.int64], chunks: int, most: int) -> tuple[int, int]:
    """The finest level at which there are at most ``most`` cubes, and every how many chunks of it are shown.

    Args:
        counts: (5,) cubes by level.
        chunks: how many there are, shown or not.
        most: how many cubes there may be.
    """
    for level, count in enumerate(counts.tolist()):
        if count <= most:
            return level, 1
    return COARSEST, math.ceil(chunks / most)


def _tile_of(chunk: Tile) -> Tile:
    x, y, z = chunk
    return x // TILE, y // TILE, z // TILE


def _in_morton_order(voxels: NDArray[np.bool_]) -> NDArray[np.uint8]:
    flat = np.empty((len(voxels), VOLUME), np.bool_)
    flat[:, PLACES] = voxels
    return np.packbits(flat, axis=1, bitorder="little")


def _cube_offsets(level: int) -> NDArray[np.int32]:
    """(4096 / 8^level, 3) which cube of its chunk each is, in Morton order."""
    edge = 1 << level
    return OFFSETS[:: edge**3].astype(np.int32) // edge


_OFFSETS_AT = [_cube_offsets(level) for level in range(COARSEST + 1)]
