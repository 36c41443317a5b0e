"""Just enough of the Protocol Buffers wire format to read back the images and log lines of a recording."""

from __future__ import annotations

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_LONGEST_VARINT = 10


def fields(message: bytes) -> dict[int, int | bytes]:
    """The fields of a message by number: integers as they are, fixed 32 and 64 bit unsigned, the rest as bytes.

    Of a repeated field only the last element is kept.

    Raises:
        ValueError: this is no such message, or it is cut.
    """
    found: dict[int, int | bytes] = {}
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        kind = tag & 7
        if kind == _VARINT:
            found[tag >> 3], at = _varint(message, at)
            continue
        if kind == _BYTES:
            length, at = _varint(message, at)
        elif kind in (_FIXED32, _FIXED64):
            length = 4 if kind == _FIXED32 else 8
        else:
            raise ValueError(f"wire type {kind} at byte {at}")
        if at + length > len(message):
            raise ValueError(f"field {tag >> 3} is cut")
        part = message[at : at + length]
        found[tag >> 3] = part if kind == _BYTES else int.from_bytes(part, "little")
        at += length
    return found


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = 0
    for n, byte in enumerate(message[at : at + _LONGEST_VARINT]):
        value |= (byte & 0x7F) << (7 * n)
        if byte < 0x80:
            return value, at + n + 1
    raise ValueError(f"number at byte {at} is cut")
