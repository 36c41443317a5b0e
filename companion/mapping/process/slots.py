"""Readings in memory that two processes share: a ring of a few slots for each sensor.

The memory is a file that has no name any more when it is first used, so nothing is left of it however the processes
end. Who writes and who reads a slot is agreed by message: the writer takes a free one, fills it and tells the reader,
who tells back when it has been read.
"""

from __future__ import annotations

import ctypes
from multiprocessing.context import SpawnContext
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

SLOTS = 3
"""One is being read, one is waiting, and one is the next to be written."""


class SlotRing:
    """The slots of one sensor. Is handed over to the other process when that is started.

    A sensor has slots of its own, so that none can take the room of another.

    Args:
        context: that starts the other process.
        shape: of every reading, or of the largest.
        dtype: of its numbers.
    """

    def __init__(self, context: SpawnContext, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self.shape = shape
        self._dtype = np.dtype(dtype)
        size_bytes = SLOTS * int(np.prod(shape)) * self._dtype.itemsize
        self._memory: Any = context.RawArray(ctypes.c_byte, size_bytes)
        self._free = list(range(SLOTS))

    def take(self) -> int | None:
        """The number of a slot to write to; None when there is none."""
        return self._free.pop() if self._free else None

    @property
    def in_use(self) -> int:
        """How many slots have not been given back."""
        return SLOTS - len(self._free)

    def array(self, slot: int) -> NDArray[Any]:
        """What is in a slot, without a copy."""
        return np.asarray(np.frombuffer(self._memory, self._dtype).reshape(SLOTS, *self.shape)[slot])

    def give_back(self, slot: int) -> None:
        """The slot has been read."""
        if slot not in self._free:
            self._free.append(slot)

    def give_back_all(self) -> None:
        """Nobody reads any more: the other process is gone."""
        self._free = list(range(SLOTS))
