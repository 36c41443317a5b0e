"""What one look does to the 64 voxels of a brick.

Every loop here is over all 64, without a branch and in 16 bits, so that it runs on the processor's vector unit. Arrays
are handed over one by one, for the reason given in `chunk_table.store_brick`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.voxels.chunks import BRICK, NOTHING

HITS, LOWERED, CHANGED = 0, 1, 2
"""Places in the counts of an update: voxels hit, voxels made surer of being free, chunks changed."""

_ZERO = np.int16(0)


@compiled
def lowered(value: np.int16, miss: np.int16, lowest: np.int16) -> np.int16:
    """The value of a voxel after one miss."""
    return max(np.int16((_ZERO if value == NOTHING else value) + miss), lowest)


@compiled
def lower(
    old: NDArray[np.int16], seen: NDArray[np.int16], miss: np.int16, lowest: np.int16, new: NDArray[np.int16]
) -> None:
    """Fill in ``new`` (64,): one miss for each voxel that was looked through.

    Args:
        old: (64,) the brick before.
        seen: (64,) not 0 where the voxel was looked through.
        miss: what a miss adds.
        lowest: lower clamp.
        new: (64,) the brick afterwards.
    """
    for n in range(BRICK):
        value = old[n]
        new[n] = lowered(value, miss, lowest) if seen[n] != _ZERO else value


@compiled
def spread(hit: np.uint64, hits: NDArray[np.int16]) -> None:
    """Fill in ``hits`` (64,): 1 for each bit that is set, else 0."""
    for n in range(BRICK):
        hits[n] = np.int16((hit >> np.uint64(n)) & np.uint64(1))


@compiled
def raise_(
    old: NDArray[np.int16],
    hits: NDArray[np.int16],
    gains: NDArray[np.int16],
    highest: np.int16,
    new: NDArray[np.int16],
) -> None:
    """One hit, and no miss, for each voxel in which a ray ended: hits win over misses.

    Args:
        old: (64,) the brick before.
        hits: (64,) 1 where a ray ended, else 0.
        gains: (64,) what a hit adds.
        highest: upper clamp.
        new: (64,) is changed.
    """
    for n in range(BRICK):
        value = old[n]
        risen = min(np.int16((_ZERO if value == NOTHING else value) + gains[n]), highest)
        new[n] = risen if hits[n] != _ZERO else new[n]


@compiled
def compared(
    old: NDArray[np.int16], new: NDArray[np.int16], hits: NDArray[np.int16]
) -> tuple[np.int16, np.int16, np.int16]:
    """How many voxels were hit, how many have another value, and how many of these were not hit."""
    hit, changed, missed = _ZERO, _ZERO, _ZERO
    for n in range(BRICK):
        differs = np.int16(new[n] != old[n])
        hit = np.int16(hit + hits[n])
        changed = np.int16(changed + differs)
        missed = np.int16(missed + np.int16(differs & ~hits[n]))
    return hit, changed, missed
