"""How the map goes over the link: what the ground asks, and what the vehicle answers.

The ground asks, so nothing is sent that nobody takes, and after a loss it asks again. Every change of a chunk has a
number that grows; the ground says up to which it has all, and gets the newest state of chunks that changed after it,
oldest change first: absolute values, so repeats do no harm.

Numbers belong to an epoch, which ends with the vehicle's process of the link. In a new one the two compare sums over
`BUCKETS` parts of space (`sums_of`), and only chunks of parts that differ are sent.
"""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from companion.link.wire import WireError
from companion.mapping.voxels.chunks import chunks_of

BUCKETS = 512

MOST_ASKED_BYTES = 64_000
"""Of one answer, before it is compressed; one chunk may be more than what is asked for, never more than this."""

MOST_ANSWER_BYTES = 1_000_000
"""Of an answer that is read, when it is decompressed."""

_REGION_SHIFT = 2
"""Chunks that lie together are in one bucket: a vehicle changes the map where it is."""

_LENGTH = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class Ask:
    """What the ground asks.

    Attributes:
        what: the sums of all buckets; chunks; a coarse picture of chunks; the way flown, from point ``after`` on; or
            graph and frontiers.
        map: of which it has a copy; another one than the vehicle's is answered by nothing but its name.
        epoch: in which ``after`` counts; empty before the first answer.
        after: the number of the last change of which, and of all before it, the ground has the effect.
        until: of changes up to this number only those in ``buckets`` are wanted.
        buckets: hexadecimal bits of those that differ, the lowest bucket first.
        most_bytes: of the answer, before it is compressed.
        by: who asks: drawn at random, the same for all questions of a process.
        nonce: drawn at random for each question: what answers it was written after it.
    """

    what: Literal["sums", "chunks", "coarse", "way", "drawing"]
    map: str = ""
    epoch: str = ""
    after: int = 0
    until: int = 0
    buckets: str = ""
    most_bytes: int = 8_000
    by: str = ""
    nonce: str = ""

    def within(self, most_bytes: int) -> Ask:
        """The same with another bound of the answer."""
        return replace(self, most_bytes=most_bytes)


@dataclass(frozen=True, slots=True)
class Told:
    """The head of an answer; its body follows.

    Attributes:
        epoch: in which numbers count now. Where it is another than the asked one, there is no body.
        map: the name of the vehicle's map.
        until: the ground has all changes up to this number when it has taken the body.
        head: number of the newest change.
        sum: over all chunks, hexadecimal: equal maps have equal ones (`sums_of`).
        chunks: how many there are.
        behind_chunks: how many have changed after ``until``.
        behind_bytes: their size.
        behind_s: how long ago the oldest change after ``until`` was; 0 when there is none.
        header: of the map, as `Header` has it; with the sums only.
    """

    epoch: str
    map: str
    until: int
    head: int
    sum: str
    chunks: int
    behind_chunks: int = 0
    behind_bytes: int = 0
    behind_s: float = 0.0
    header: dict[str, Any] | None = None


_ASK, _TOLD = TypeAdapter(Ask), TypeAdapter(Told)
Part = TypeVar("Part", Ask, Told)


def asked(ask: Ask) -> bytes:
    """A question as bytes."""
    return json.dumps(asdict(ask), separators=(",", ":")).encode()


def read_ask(data: bytes) -> Ask:
    """The question that some bytes ask.

    Raises:
        WireError: they ask none.
    """
    ask = _checked(_ASK, data)
    longest = max(map(len, (ask.buckets, ask.by, ask.nonce)))
    if not 0 < ask.most_bytes <= MOST_ASKED_BYTES or ask.after < 0 or longest > BUCKETS // 4:
        raise WireError("no question about the map: a number in it is out of bounds")
    return ask


def answer(told: Told, body: bytes = b"") -> bytes:
    """An answer as bytes."""
    head = json.dumps(asdict(told), allow_nan=False, separators=(",", ":")).encode()
    return _LENGTH.pack(len(head)) + head + zlib.compress(body, 6)


def read_answer(data: bytes) -> tuple[Told, bytes]:
    """Head and body of an answer.

    Raises:
        WireError: it is none.
    """
    if len(data) < _LENGTH.size:
        raise WireError("no answer about the map: it is too short")
    end = _LENGTH.size + _LENGTH.unpack_from(data)[0]
    if end > len(data):
        raise WireError("no answer about the map: it is cut off")
    told = _checked(_TOLD, data[_LENGTH.size : end])
    reader = zlib.decompressobj()
    try:
        body = reader.decompress(data[end:], MOST_ANSWER_BYTES)
    except zlib.error as error:
        raise WireError(f"no answer about the map: {error}") from None
    if not reader.eof:
        raise WireError(f"no answer about the map: it is cut off, or larger than {MOST_ANSWER_BYTES} bytes")
    return told, body


def bucket_of(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) the bucket of each chunk."""
    regions = chunks_of(keys).astype(np.int64) >> _REGION_SHIFT
    mixed = _mixed(regions[:, 0] * 73_856_093 ^ regions[:, 1] * 19_349_663 ^ regions[:, 2] * 83_492_791)
    return (mixed % np.uint64(BUCKETS)).astype(np.int64)


def sums_of(keys: NDArray[np.int64], crcs: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """(`BUCKETS`,) for each bucket the sum, modulo 2^64, of a number for each chunk and what is in it.

    Args:
        keys: (n,) of the chunks.
        crcs: (n,) of their records in a journal.
    """
    sums = np.zeros(BUCKETS, np.uint64)
    np.add.at(sums, bucket_of(keys), _mixed(keys ^ _mixed(crcs.astype(np.int64)).astype(np.int64)))
    return sums


def total(sums: NDArray[np.uint64]) -> str:
    """The sum over all buckets, hexadecimal."""
    return f"{int(sums.sum(dtype=np.uint64)):016x}"


def bits_of(differ: NDArray[np.bool_]) -> str:
    """(`BUCKETS`,) bits, hexadecimal."""
    return np.packbits(differ, bitorder="little").tobytes().hex()


def read_bits(text: str) -> NDArray[np.bool_]:
    """The inverse of `bits_of`; what is missing at the end is false.

    Raises:
        WireError: it is not hexadecimal.
    """
    try:
        data = bytes.fromhex(text)
    except ValueError:
        raise WireError("no question about the map: its buckets are not hexadecimal") from None
    bits = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little").astype(np.bool_)
    return np.concatenate([bits, np.zeros(BUCKETS, np.bool_)])[:BUCKETS]


def _mixed(numbers: NDArray[np.int64]) -> NDArray[np.uint64]:
    """(n,) each spread over all 64 bits (splitmix64)."""
    mixed = numbers.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(mixed ^ (mixed >> np.uint64(31)))


def _checked(adapter: TypeAdapter[Part], data: bytes) -> Part:
    try:
        return adapter.validate_json(data, strict=True)
    except ValidationError as error:
        raise WireError(f"no message about the map: {error.errors(include_url=False)[0]['msg']}") from None
