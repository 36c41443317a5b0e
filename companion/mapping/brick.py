"""What one look does to the 64 voxels of a brick."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.mapping.chunks import BRICK, NOTHING
from companion.mapping.sensor_model import Steps
from companion.mapping.store import Table, load_brick, store_brick

HITS, LOWERED, CHANGED = 0, 1, 2
"""Places in the counts of an update: voxels hit, voxels made surer of being free, chunks changed."""


@njit(cache=True, nogil=True)
def lowered(value: np.int16, steps: Steps) -> np.int16:
    """The value of a voxel after one miss."""
    lowest = np.int16(steps.lowest)
    new = np.int16((np.int16(0) if value == NOTHING else value) + np.int16(steps.miss))
    return max(lowest, new)


@njit(cache=True, nogil=True)
def update_brick(
    table: Table,
    row: int,
    word: int,
    seen: NDArray[np.int16],
    hit: np.uint64,
    gains: NDArray[np.int16],
    steps: Steps,
    counts: NDArray[np.int64],
) -> bool:
    """One miss for each voxel that was looked through, or one hit where a ray ended: hits win.

    Args:
        table: is changed; there is room for one more brick.
        row: of the chunk.
        word: number of the brick in it.
        seen: (64,) not 0 where the voxel was looked through.
        hit: one bit for each voxel in which a ray ended.
        gains: (64,) what a hit adds.
        steps: the sensor model.
        counts: (3,) hits and voxels made surer of being free are added to it.

    Returns:
        Whether any voxel has another value than before.
    """
    old, new = np.empty(BRICK, np.int16), np.empty(BRICK, np.int16)
    load_brick(table, table.codes[row, word], old)
    for n in range(BRICK):
        new[n] = lowered(old[n], steps) if seen[n] else old[n]
    if hit != np.uint64(0):
        for n in range(BRICK):
            value = old[n]
            risen = min((np.int16(0) if value == NOTHING else value) + gains[n], steps.highest)
            is_hit = (hit >> np.uint64(n)) & np.uint64(1) != np.uint64(0)
            new[n] = np.int16(risen) if is_hit else new[n]
            counts[HITS] += is_hit
    changed = 0
    for n in range(BRICK):
        changed += new[n] != old[n]
        counts[LOWERED] += (new[n] < old[n]) | ((old[n] == NOTHING) & (new[n] < 0) & (new[n] != NOTHING))
    if changed:
        store_brick(table, row, word, new)
    return changed != 0
