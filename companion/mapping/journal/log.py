"""Records in a segment: how they are framed, and how they are found again behind a place that is damaged."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.mapping.journal.coding import MOST_BYTES, encode
from companion.mapping.journal.rows import plain
from companion.mapping.voxels.chunks import CHUNK_LIMIT

_MARK = 0xA7D15EC3
_MARK_BYTES = struct.pack("<I", _MARK)
_FRONT = struct.Struct("<IIIiii")
"""Mark, a CRC of all that comes behind it, bytes of the chunk that follow, chunk coordinates."""

FRONT_BYTES = _FRONT.size
MOST_RECORD_BYTES = FRONT_BYTES + MOST_BYTES
_SUMMED_FROM = 8


@dataclass(frozen=True, slots=True)
class Loss:
    """Bytes of a journal that cannot be read.

    Attributes:
        path: the file.
        offset: where it begins.
        size_bytes: how much.
        torn: it is the unfinished end of a file, as a crash leaves it: nothing that was committed.
    """

    path: Path
    offset: int
    size_bytes: int
    torn: bool


class Record(NamedTuple):
    """A record that is whole: which chunk, where it begins, and its size with the front."""

    chunk: tuple[int, int, int]
    offset: int
    size_bytes: int


def packed(chunks: NDArray[np.int32], values: NDArray[np.int16]) -> tuple[bytes, NDArray[np.int64]]:
    """Records of ``chunks`` (n, 3) with their ``values`` (n, 4096), one behind the other; and the size of each."""
    out = np.empty(len(chunks) * MOST_RECORD_BYTES, np.uint8)
    sizes = encode(plain(values, np.int16), out, FRONT_BYTES)
    data = memoryview(out.data)
    at = 0
    for (x, y, z), size in zip(chunks.tolist(), sizes.tolist(), strict=True):
        _FRONT.pack_into(data, at, _MARK, 0, size, x, y, z)
        end = at + FRONT_BYTES + size
        struct.pack_into("<I", data, at + 4, zlib.crc32(data[at + _SUMMED_FROM : end]))
        at = end
    return data[:at].tobytes(), sizes + FRONT_BYTES


def record_at(data: bytes | memoryview, at: int) -> Record | None:
    """The record that begins at ``at``, None when there is none that is whole."""
    if len(data) - at < FRONT_BYTES:
        return None
    mark, crc, size, x, y, z = _FRONT.unpack_from(data, at)
    end = at + FRONT_BYTES + size
    if mark != _MARK or size > MOST_BYTES or end > len(data) or crc != zlib.crc32(data[at + _SUMMED_FROM : end]):
        return None
    if min(x, y, z) < -CHUNK_LIMIT or max(x, y, z) >= CHUNK_LIMIT:
        return None
    return Record((x, y, z), at, FRONT_BYTES + size)


def records(data: bytes, begin: int, path: Path, lose: Callable[[Loss], None]) -> Iterator[Record]:
    """The whole records of a segment from ``begin`` on; what lies between them is given to ``lose``."""
    view = memoryview(data)
    at = begin
    while at < len(data):
        record = record_at(view, at)
        if record is None:
            after = _next_record(data, view, at + 1)
            lose(Loss(path, at, after - at, torn=after == len(data) and _is_torn(view, at)))
            at = after
        else:
            yield record
            at += record.size_bytes


def _next_record(data: bytes, view: memoryview, at: int) -> int:
    """Where the next whole record begins, or the end."""
    while True:
        at = data.find(_MARK_BYTES, at)
        if at < 0:
            return len(data)
        if record_at(view, at) is not None:
            return at
        at += 1


def _is_torn(view: memoryview, at: int) -> bool:
    """Whether the rest looks as a crash leaves it: the beginning of a record, maybe filled up with zeros."""
    rest = view[at:].tobytes().rstrip(b"\0")
    mark, _, size, *_ = _FRONT.unpack(rest[:FRONT_BYTES].ljust(FRONT_BYTES, b"\0"))
    begins = mark == _MARK or _MARK_BYTES.startswith(rest)
    return bool(begins and len(rest) < FRONT_BYTES + size)
