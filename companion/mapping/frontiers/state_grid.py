"""What is free, occupied and unknown, small enough for a whole mine: two bits a voxel, and only where needed.

A chunk has 64 bricks of 4 x 4 x 4 voxels. Of each brick it is kept in three masks whether some voxel of it is occupied,
free, unknown: so a brick with one state only costs nothing more. Of a mixed brick the occupied and the free voxels are
two 64-bit words in a pool. Bricks of a chunk, and voxels of a brick, are in Morton order as in a chunk.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, inner
from companion.mapping.voxels.chunks import (
    CHUNK_LIMIT,
    EDGE,
    EMPTY,
    MASK,
    SHIFT,
    Integer,
    bits_in,
    chunk_key,
    place_of,
    slot_of,
)
from companion.mapping.voxels.lookup import FREE, OCCUPIED, UNKNOWN, states_of
from companion.mapping.voxels.piece import MapPiece, MapSnapshot, MapSource
from companion.model import FloatArray

_ZERO, _ONE = np.uint64(0), np.uint64(1)
_ALL = np.uint64(2**64 - 1)
_FIRST_ROWS, _FIRST_BRICKS = 256, 4096

_STEP = 4
"""Room in the pool is given in so many bricks at once: whoever grows by one needs no new room each time."""

_CLASSES = 64 // _STEP + 1


class Grid(NamedTuple):
    """The arrays of a state grid, as the compiled functions take them.

    Attributes:
        keys: (2^k,) int64, hash table: packed chunk coordinates, -1 where empty.
        rows: (2^k,) int32, the row that belongs to the key beside it.
        occupied: (capacity,) uint64 for each row, bit b: brick b has an occupied voxel.
        free: (capacity,) uint64, the same for free voxels.
        unknown: (capacity,) uint64, the same for unknown ones.
        first: (capacity,) int32, where in the pool the mixed bricks of the row begin, in the order of their numbers.
        bricks: (room, 2) uint64, of a mixed brick: which voxels are occupied, which are free.
        gaps: (17,) int32, for room of 4 n bricks in the pool that is not in use: where it begins, -1 for none.
        used: (3,) int64: rows in use, bricks of the pool that were ever in use, occupied voxels.
    """

    keys: NDArray[np.int64]
    rows: NDArray[np.int32]
    occupied: NDArray[np.uint64]
    free: NDArray[np.uint64]
    unknown: NDArray[np.uint64]
    first: NDArray[np.int32]
    bricks: NDArray[np.uint64]
    gaps: NDArray[np.int32]
    used: NDArray[np.int64]


@inner
def has(word: np.uint64, bit: Integer) -> bool:
    """Whether a bit of ``word`` is set."""
    return bool((word >> np.uint64(bit)) & _ONE)


@inner
def row_of(grid: Grid, x: Integer, y: Integer, z: Integer) -> int:
    """The row of chunk (x, y, z), or -1 when it is wholly unknown and not kept, or beyond all that can be mapped."""
    inside = -CHUNK_LIMIT <= x < CHUNK_LIMIT and -CHUNK_LIMIT <= y < CHUNK_LIMIT and -CHUNK_LIMIT <= z < CHUNK_LIMIT
    if not inside:
        return -1
    key = chunk_key(x, y, z)
    slot = slot_of(grid.keys, key)
    return int(grid.rows[slot]) if grid.keys[slot] == key else -1


@inner
def mixed_bricks(grid: Grid, row: int) -> np.uint64:
    """Bit b is set where brick b has voxels of more than one state."""
    occupied, free, unknown = grid.occupied[row], grid.free[row], grid.unknown[row]
    mixed: np.uint64 = (occupied & free) | (occupied & unknown) | (free & unknown)
    return mixed


@inner
def brick_words(grid: Grid, row: int, brick: Integer) -> tuple[np.uint64, np.uint64]:
    """The occupied and the free voxels of a brick of a chunk that is kept, one bit for each."""
    mixed = mixed_bricks(grid, row)
    if has(mixed, brick):
        at = grid.first[row] + bits_in(mixed & ((_ONE << np.uint64(brick)) - _ONE))
        return grid.bricks[at, 0], grid.bricks[at, 1]
    return (_ALL if has(grid.occupied[row], brick) else _ZERO, _ALL if has(grid.free[row], brick) else _ZERO)


@inner
def state_at(grid: Grid, x: Integer, y: Integer, z: Integer) -> np.uint8:
    """The state of a voxel."""
    row = row_of(grid, x >> SHIFT, y >> SHIFT, z >> SHIFT)
    if row < 0:
        return UNKNOWN
    place = place_of(x & MASK, y & MASK, z & MASK)
    occupied, free = brick_words(grid, row, place >> 6)
    bit = place & 63
    return OCCUPIED if has(occupied, bit) else FREE if has(free, bit) else UNKNOWN


@compiled
def _states_at(grid: Grid, voxels: NDArray[np.int64]) -> NDArray[np.uint8]:
    states = np.empty(voxels.shape[0], np.uint8)
    for n in range(voxels.shape[0]):
        states[n] = state_at(grid, voxels[n, 0], voxels[n, 1], voxels[n, 2])
    return states


@compiled
def _index(
    keys: NDArray[np.int64], rows: NDArray[np.int32], old: NDArray[np.int64], old_rows: NDArray[np.int32]
) -> None:
    for n in range(old.shape[0]):
        if old[n] != EMPTY:
            slot = slot_of(keys, old[n])
            keys[slot], rows[slot] = old[n], old_rows[n]


@inner
def _room(bricks: int) -> int:
    return (bricks + _STEP - 1) // _STEP


@compiled
def _put(
    grid: Grid, chunks: NDArray[np.int32], states: NDArray[np.uint8], done: int, changed: NDArray[np.uint64]
) -> int:
    """Take chunks over from number ``done`` on while there is room; returns how many are done then.

    ``changed`` (n,) gets the bricks of each that are not what they were.
    """
    words = np.empty((64, 2), np.uint64)
    for n in range(done, chunks.shape[0]):
        if grid.used[0] == grid.occupied.shape[0] or grid.used[1] + 64 > grid.bricks.shape[0]:
            return n
        occupied, free, unknown, mixed = _ZERO, _ZERO, _ZERO, _ZERO
        count = 0
        for brick in range(64):
            is_occupied, is_free = _ZERO, _ZERO
            for bit in range(64):
                state = states[n, 64 * brick + bit]
                is_occupied |= np.uint64(state == OCCUPIED) << np.uint64(bit)
                is_free |= np.uint64(state == FREE) << np.uint64(bit)
            words[brick, 0], words[brick, 1] = is_occupied, is_free
            at = _ONE << np.uint64(brick)
            occupied |= at if is_occupied != _ZERO else _ZERO
            free |= at if is_free != _ZERO else _ZERO
            unknown |= at if (is_occupied | is_free) != _ALL else _ZERO
            count += bits_in(is_occupied)
        mixed = (occupied & free) | (occupied & unknown) | (free & unknown)
        key = chunk_key(np.int64(chunks[n, 0]), np.int64(chunks[n, 1]), np.int64(chunks[n, 2]))
        slot = slot_of(grid.keys, key)
        if grid.keys[slot] != key:
            if unknown == _ALL and mixed == _ZERO:
                changed[n] = _ZERO
                continue
            row = grid.used[0]
            grid.used[0] += 1
            grid.keys[slot], grid.rows[slot] = key, row
            grid.occupied[row], grid.free[row], grid.unknown[row], grid.first[row] = _ZERO, _ZERO, _ALL, 0
        row = grid.rows[slot]
        different = _ZERO
        before = 0
        for brick in range(64):
            was_occupied, was_free = brick_words(grid, row, brick)
            before += bits_in(was_occupied)
            if was_occupied != words[brick, 0] or was_free != words[brick, 1]:
                different |= _ONE << np.uint64(brick)
        changed[n] = different
        if different == _ZERO:
            continue
        had, needs = _room(bits_in(mixed_bricks(grid, row))), _room(bits_in(mixed))
        if had != needs:
            if had > 0:
                # The room that is given up says where the next one like it is.
                grid.bricks[grid.first[row], 0] = np.uint64(grid.gaps[had] + 1)
                grid.gaps[had] = grid.first[row]
            if needs > 0:
                gap = grid.gaps[needs]
                if gap >= 0:
                    grid.first[row] = gap
                    grid.gaps[needs] = np.int32(np.int64(grid.bricks[gap, 0]) - 1)
                else:
                    grid.first[row] = grid.used[1]
                    grid.used[1] += _STEP * needs
        grid.occupied[row], grid.free[row], grid.unknown[row] = occupied, free, unknown
        at_brick = np.int64(grid.first[row])
        for brick in range(64):
            if has(mixed, brick):
                grid.bricks[at_brick, 0], grid.bricks[at_brick, 1] = words[brick, 0], words[brick, 1]
                at_brick += 1
        grid.used[2] += count - before
    return int(chunks.shape[0])


class StateGrid:
    """The states of all voxels of a map, kept up to date by what changed. For one thread at a time.

    Args:
        voxel_m: edge of a voxel.
    """

    def __init__(self, voxel_m: float) -> None:
        if not (np.isfinite(voxel_m) and voxel_m > 0.0):
            raise ValueError(f"voxel_m is {voxel_m}, it has to be a length above 0")
        self.voxel_m = voxel_m
        self.grid = Grid(
            keys=np.full(4 * _FIRST_ROWS, EMPTY, np.int64),
            rows=np.zeros(4 * _FIRST_ROWS, np.int32),
            occupied=np.empty(_FIRST_ROWS, np.uint64),
            free=np.empty(_FIRST_ROWS, np.uint64),
            unknown=np.empty(_FIRST_ROWS, np.uint64),
            first=np.empty(_FIRST_ROWS, np.int32),
            bricks=np.empty((_FIRST_BRICKS, 2), np.uint64),
            gaps=np.full(_CLASSES, EMPTY, np.int32),
            used=np.zeros(3, np.int64),
        )

    @classmethod
    def of(cls, source: MapSource) -> Self:
        """The states of a whole map, read piece by piece."""
        made = cls(source.voxel_m)
        for piece in source.pieces():
            made.put(piece, source.threshold)
        return made

    def put(self, piece: MapPiece, threshold: int) -> NDArray[np.uint64]:
        """Take chunks as they are, in place of what was known of them; returns what `update` does.

        Args:
            piece: the chunks.
            threshold: a voxel is occupied from this value on.
        """
        return self._take(piece.chunks, np.asarray(states_of(piece.values, threshold)))

    def update(self, snapshot: MapSnapshot) -> NDArray[np.uint64]:
        """Take the chunks of a snapshot as they are, in place of what was known of them.

        Returns:
            (n,) uint64, for each chunk of the snapshot bit b where its brick b is not what it was.

        Raises:
            ValueError: the snapshot has voxels of another size.
        """
        if snapshot.voxel_m != self.voxel_m:
            raise ValueError(f"the snapshot has voxels of {snapshot.voxel_m} m, what is known has {self.voxel_m} m")
        return self._take(snapshot.chunks, snapshot.states)

    def classify(self, points: NDArray[np.floating]) -> NDArray[np.uint8]:
        """(n,) `UNKNOWN`, `FREE` or `OCCUPIED` of the voxel that holds each of ``points`` (n, 3), in m.

        Raises:
            ValueError: a point is not finite.
        """
        voxels = np.floor(self.voxels_of(points)).astype(np.int64)
        return np.asarray(_states_at(self.grid, voxels))

    def voxels_of(self, points: NDArray[np.floating]) -> FloatArray:
        """(n, 3) the same points counted in voxels; those beyond all that can be mapped are moved to its rim.

        Raises:
            ValueError: they have another shape, or a coordinate that is not finite.
        """
        points_m = np.ascontiguousarray(points, np.float64)
        if points_m.ndim != 2 or points_m.shape[1] != 3:
            raise ValueError(f"points have the shape {points_m.shape}, not (n, 3)")
        largest_m = float(np.max(np.abs(points_m), initial=0.0))
        if not np.isfinite(largest_m):
            raise ValueError("points have coordinates that are not finite")
        rim = float((CHUNK_LIMIT - 1) * EDGE)
        scaled = points_m / self.voxel_m
        return scaled if largest_m < rim * self.voxel_m else np.clip(scaled, -rim, rim)

    @property
    def chunk_count(self) -> int:
        """How many chunks are kept."""
        return int(self.grid.used[0])

    @property
    def occupied_count(self) -> int:
        """How many voxels are occupied."""
        return int(self.grid.used[2])

    @property
    def memory_bytes(self) -> int:
        """Size of the arrays, with the room that they have left."""
        return sum(array.nbytes for array in self.grid)

    def _take(self, chunks: NDArray[np.int32], states: NDArray[np.uint8]) -> NDArray[np.uint64]:
        changed = np.zeros(len(chunks), np.uint64)
        chunks, states = np.ascontiguousarray(chunks, np.int32), np.ascontiguousarray(states)
        done = 0
        while True:
            done = _put(self.grid, chunks, states, done, changed)
            if done == len(chunks):
                return changed
            self._grow()

    def _grow(self) -> None:
        grid = self.grid
        rows, bricks, _ = (int(count) for count in grid.used)
        if rows == len(grid.occupied):
            more = 2 * rows
            keys, numbers = np.full(4 * more, EMPTY, np.int64), np.zeros(4 * more, np.int32)
            _index(keys, numbers, grid.keys, grid.rows)
            grid = grid._replace(
                keys=keys,
                rows=numbers,
                occupied=_longer(grid.occupied, more),
                free=_longer(grid.free, more),
                unknown=_longer(grid.unknown, more),
                first=np.concatenate([grid.first, np.zeros(more - rows, np.int32)]),
            )
        if bricks + 64 > len(grid.bricks):
            more = len(grid.bricks) // 2
            grid = grid._replace(bricks=np.concatenate([grid.bricks, np.empty((more, 2), np.uint64)]))
        self.grid = grid


def _longer(words: NDArray[np.uint64], length: int) -> NDArray[np.uint64]:
    return np.concatenate([words, np.zeros(length - len(words), np.uint64)])
