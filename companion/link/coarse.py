"""A coarse picture of chunks, for a link that is too thin for all of them: two bits for each brick of 64 voxels.

It has about a thirtieth of the bytes. It is looked at until the chunk itself comes, and is never part of the map.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.link.wire import WireError
from companion.mapping.journal.coding import decode
from companion.mapping.journal.segment import FRONT_BYTES, record_at
from companion.mapping.voxels.chunks import BRICK, NOTHING, VOLUME, WORDS, keys_of
from companion.mapping.voxels.lookup import FREE, OCCUPIED, UNKNOWN

_BYTES = 8 + 2 * WORDS // 8


class CoarseChunks(NamedTuple):
    """Some chunks: (n,) keys, (n, 64) whether each brick holds an occupied voxel, (n, 64) the same of a free one."""

    keys: NDArray[np.int64]
    occupied: NDArray[np.bool_]
    free: NDArray[np.bool_]

    def states(self) -> NDArray[np.uint8]:
        """(n, 4096) states of the voxels, all of a brick alike; what is partly occupied is occupied."""
        bricks = np.where(self.occupied, OCCUPIED, np.where(self.free, FREE, UNKNOWN))
        return np.repeat(bricks, BRICK, axis=1)


def coarse_body(records: Sequence[bytes], threshold: int) -> bytes:
    """The coarse picture of chunks, as bytes.

    Args:
        records: of a journal.
        threshold: a voxel is occupied from this value on.
    """
    whole = [(data, record) for data in records if (record := record_at(data, 0)) is not None]
    starts = np.cumsum([0, *(len(data) - FRONT_BYTES for data, _ in whole)], dtype=np.int64)
    values = np.empty((len(whole), VOLUME), np.int16)
    valid = decode(np.frombuffer(bytearray().join(data[FRONT_BYTES:] for data, _ in whole), np.uint8), starts, values)
    keys = keys_of(np.array([record.chunk for _, record in whole], np.int32).reshape(-1, 3))[valid]
    bricks = values[valid].reshape(-1, WORDS, BRICK)
    occupied = (bricks >= threshold).any(axis=2)
    free = ((bricks < 0) & (bricks != NOTHING)).any(axis=2)
    bits = [np.packbits(part, axis=1, bitorder="little") for part in (occupied, free)]
    return np.concatenate([keys.view(np.uint8).reshape(-1, 8), *bits], axis=1).tobytes()


def read_coarse(data: bytes) -> CoarseChunks:
    """The coarse picture that some bytes are.

    Raises:
        WireError: they are none.
    """
    if len(data) % _BYTES:
        raise WireError(f"no coarse picture: {len(data)} bytes are no multiple of {_BYTES}")
    rows = np.frombuffer(data, np.uint8).reshape(-1, _BYTES)
    keys = np.ascontiguousarray(rows[:, :8]).view(np.int64).reshape(-1)
    if (keys < 0).any():
        raise WireError("no coarse picture: a chunk in it cannot be")
    bits = np.unpackbits(rows[:, 8:], axis=1, bitorder="little").astype(np.bool_)
    return CoarseChunks(keys.copy(), bits[:, :WORDS], bits[:, WORDS:])
