"""Depth images in memory that two processes share: a ring of a few slots.

The memory is a file that has no name any more when it is first used, so nothing is left of it however the processes
end. Who writes and who reads a slot is agreed by message: the writer takes a free one, fills it and tells the reader,
who tells back when it has been read.
"""

from __future__ import annotations

import ctypes
from multiprocessing.context import SpawnContext
from typing import Any

import numpy as np
from numpy.typing import NDArray

SLOTS = 3
"""One is being read, one is waiting, and one is the next to be written."""


class FrameRing:
    """The slots. Is handed over to the other process when that is started.

    Args:
        context: that starts the other process.
        height_px: of every image.
        width_px: of every image.
    """

    def __init__(self, context: SpawnContext, height_px: int, width_px: int) -> None:
        self.shape = (SLOTS, height_px, width_px)
        self._memory: Any = context.RawArray(ctypes.c_float, SLOTS * height_px * width_px)
        self._free = list(range(SLOTS))

    def put(self, depth_m: NDArray[np.floating]) -> int | None:
        """Copy an image into a free slot and return its number; None when there is none."""
        if not self._free:
            return None
        slot = self._free.pop()
        self.image(slot)[...] = depth_m
        return slot

    def image(self, slot: int) -> NDArray[np.float32]:
        """The (height, width) image in a slot, without a copy."""
        images: NDArray[np.float32] = np.frombuffer(self._memory, np.float32).reshape(self.shape)
        image: NDArray[np.float32] = images[slot]
        return image

    def give_back(self, slot: int) -> None:
        """The slot has been read."""
        if slot not in self._free:
            self._free.append(slot)

    def give_back_all(self) -> None:
        """Nobody reads any more: the other process is gone."""
        self._free = list(range(SLOTS))
