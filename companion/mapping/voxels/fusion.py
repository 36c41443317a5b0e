"""Evidence of the same voxels from two maps, as one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.mapping.voxels.chunks import NOTHING


@compiled
def add_log_odds(ours: NDArray[np.int16], theirs: NDArray[np.int16], lowest: int, highest: int) -> None:
    """Add ``theirs`` to ``ours``, and clamp; `NOTHING` adds nothing, and stays where neither knows anything.

    Args:
        ours: (n, k) log-odds in thousandths; is changed.
        theirs: (n, k) the same voxels of another map.
        lowest: lower clamp.
        highest: upper clamp.
    """
    for row in range(ours.shape[0]):
        for place in range(ours.shape[1]):
            a, b = np.int32(ours[row, place]), np.int32(theirs[row, place])
            known_a, known_b = a != NOTHING, b != NOTHING
            total = (a if known_a else np.int32(0)) + (b if known_b else np.int32(0))
            clamped = min(max(total, np.int32(lowest)), np.int32(highest))
            ours[row, place] = np.int16(clamped if known_a | known_b else NOTHING)
