"""Room on the disk for what does not fit into memory and is needed in another order than it comes."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray


class Spool:
    """Blocks of bytes by number, in a file without a name: it goes away with the process, however that ends.

    Args:
        folder: where there is room: beside the file that is to be written.
    """

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - closed by __exit__
        self._ends = [np.zeros(1, np.int64)]
        self._starts: NDArray[np.int64] | None = None

    def __enter__(self) -> Spool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def append(self, data: NDArray[np.uint8], ends: NDArray[np.int64]) -> None:
        """Keep blocks that lie one behind another in ``data``, the k-th up to ``ends[k]``."""
        if len(ends):
            self._ends.append(self._ends[-1][-1] + ends)
            self._file.write(data[: int(ends[-1])].tobytes())
            self._starts = None

    def block(self, number: int) -> bytes:
        """The block that was the ``number``-th to be appended, from 0."""
        if self._starts is None:
            self._starts = np.concatenate(self._ends)
            self._file.flush()
        start, end = int(self._starts[number]), int(self._starts[number + 1])
        return os.pread(self._file.fileno(), end - start, start)
