"""Arrays that grow without being copied.

A map grows for hours. Doubling an array by copying it would need three times its size at the worst moment, and hold up
the frame that is just being put in. Here the kernel moves the pages to a larger range of addresses instead, and pages
that were never written to cost nothing.
"""

from __future__ import annotations

import math
import mmap

import numpy as np
from numpy.typing import DTypeLike, NDArray


class GrowingArray:
    """Memory for rows of numbers, zero at first.

    Args:
        rows: room at first.
        row_shape: shape of one row; () for plain numbers.
        dtype: of the numbers.
    """

    def __init__(self, rows: int, row_shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self._row_shape = row_shape
        self._dtype = np.dtype(dtype)
        self._row_bytes = math.prod(row_shape) * self._dtype.itemsize
        self._memory = _mapped(rows * self._row_bytes)
        self.rows = rows

    @property
    def array(self) -> NDArray[np.generic]:
        """All rows, without a copy. Whoever keeps it across `grow` holds on to what was there before."""
        return np.frombuffer(self._memory, self._dtype).reshape(self.rows, *self._row_shape)

    def grow(self, rows: int) -> None:
        """Make room for so many rows.

        Raises:
            OSError: there is not so much memory.
        """
        try:
            self._memory.resize(rows * self._row_bytes)
        except BufferError:
            # Somebody still looks at the array: his must not move.
            larger = _mapped(rows * self._row_bytes)
            larger[: len(self._memory)] = self._memory[:]
            self._memory = larger
        self.rows = rows


def _mapped(size_bytes: int) -> mmap.mmap:
    return mmap.mmap(-1, size_bytes, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
