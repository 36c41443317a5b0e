"""What is drawn of a map: the states of its voxels, packed so that a large one fits into memory, and the way flown."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.errors import InputError
from companion.mapping.voxels.chunks import EDGE, NOTHING, OFFSETS, VOLUME
from companion.mapping.voxels.piece import MapSource
from companion.model import FloatArray

PIECE = 256
"""Chunks of which the voxels are given at a time."""

_OCTETS = VOLUME // 8

ESTIMATED = "estimated_x_m", "estimated_y_m", "estimated_z_m"
PLAIN = "x_m", "y_m", "z_m"


class State(IntEnum):
    """What is drawn of a voxel."""

    OCCUPIED = 0
    FREE = 1
    UNDECIDED = 2


@dataclass(frozen=True, slots=True)
class PackedVoxels:
    """One bit for each voxel and state.

    Attributes:
        voxel_m: edge of a voxel.
        chunks: (n, 3) int32 coordinates.
        bits: (3, n, 512) uint8 by `State`; bit 0 of a byte is the first of its eight voxels in Morton order, so a byte
            is a cube of 2 and eight of them a cube of 4.
    """

    voxel_m: float
    chunks: NDArray[np.int32]
    bits: NDArray[np.uint8]

    def count(self, state: State) -> int:
        """How many voxels are in that state."""
        return int(np.bitwise_count(self.bits[state]).sum(dtype=np.int64))

    def where(self, rows: NDArray[np.bool_]) -> PackedVoxels:
        """Only some of the chunks, those of which ``rows`` (n,) is true."""
        return PackedVoxels(self.voxel_m, self.chunks[rows], self.bits[:, rows])

    def bounds(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Lowest voxel and the one after the highest of what is known; one voxel at the origin of an empty map."""
        some = self.where(np.asarray(self.bits[[State.OCCUPIED, State.FREE]].any(axis=(0, 2))))
        chunks = some.chunks
        if len(chunks):
            # Only what is farthest out can be at an edge.
            outer = (chunks == np.stack([chunks.min(axis=0), chunks.max(axis=0)])[:, None]).any(axis=(0, 2))
            some = some.where(np.asarray(outer, np.bool_))
        corners = [
            corner
            for state in (State.OCCUPIED, State.FREE)
            for numbers in some.numbers(state)
            if len(numbers)
            for corner in (numbers.min(axis=0), numbers.max(axis=0))
        ]
        if not corners:
            return np.zeros(3, np.int64), np.ones(3, np.int64)
        together = np.array(corners, np.int64)
        return together.min(axis=0), together.max(axis=0) + 1

    def numbers(self, state: State, level: int = 0) -> Iterator[NDArray[np.int32]]:
        """The (k, 3) integer coordinates of cubes of 2^level voxels, from 0 to 4, a few hundred chunks at a time.

        An occupied or undecided voxel shows in the cube around it. A cube is free when half of it is.
        """
        edge = 1 << level
        corners = OFFSETS[:: edge**3].astype(np.int32) // edge
        for first in range(0, len(self.chunks), PIECE):
            shown = cubes(self.bits[state, first : first + PIECE], level, state is State.FREE)
            rows, places = np.nonzero(shown)
            yield self.chunks[first + rows] * (EDGE // edge) + corners[places]


def cubes(bits: NDArray[np.uint8], level: int, by_half: bool) -> NDArray[np.bool_]:
    """(n, 4096 / 8^level) whether the cubes of 2^level voxels are shown, from ``bits`` (n, 512)."""
    if level == 0:
        return np.unpackbits(bits, axis=1, bitorder="little").view(np.bool_)
    octets = 8 ** (level - 1)
    filled = np.bitwise_count(bits).reshape(len(bits), _OCTETS // octets, octets).sum(axis=2, dtype=np.int32)
    return np.asarray(filled >= (8**level // 2 if by_half else 1))


def packed(source: MapSource, progress: Callable[[int], None] = lambda _: None) -> PackedVoxels:
    """Go through a map once.

    Args:
        source: the map.
        progress: is given how many chunks were seen so far.
    """
    chunks = [np.zeros((0, 3), np.int32)]
    bits = [np.zeros((3, 0, _OCTETS), np.uint8)]
    seen = 0
    for piece in source.pieces(PIECE):
        values = piece.values
        known = values != NOTHING
        occupied = known & (values >= source.threshold)
        free = known & (values < 0)
        states = np.stack([occupied, free, known & ~occupied & ~free])
        some = states.any(axis=(0, 2))
        chunks.append(piece.chunks[some])
        bits.append(np.packbits(states[:, some], axis=2, bitorder="little"))
        seen += len(piece.chunks)
        progress(seen)
    return PackedVoxels(source.voxel_m, np.concatenate(chunks), np.concatenate(bits, axis=1))


def trajectories(folder: Path) -> dict[str, FloatArray]:
    """By file name, the (n, 3) positions in m of every ``trajectory*.csv`` in a folder.

    The map is in the frame in which the vehicle knew its place, so the columns estimated_x_m, estimated_y_m and
    estimated_z_m are taken where a file has them, else x_m, y_m and z_m. A row without a position is left out.

    Raises:
        InputError: such a file has no such columns, or cannot be read.
    """
    return {path.name: _positions(path) for path in sorted(folder.glob("trajectory*.csv"))}


def _positions(path: Path) -> FloatArray:
    found: list[tuple[float, ...]] = []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.DictReader(file)
            there = set(rows.fieldnames or ())
            columns = next((names for names in (ESTIMATED, PLAIN) if there.issuperset(names)), None)
            if columns is None:
                raise InputError(f"{path}: has no columns {', '.join(PLAIN)}; move it away to see the map without it")
            for row in rows:
                place = tuple(float(row[name] or "nan") for name in columns)
                if all(map(math.isfinite, place)):
                    found.append(place)
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read: {error}; move it away to see the map without it") from None
    return np.array(found, np.float64).reshape(-1, 3)
