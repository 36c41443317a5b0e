"""Bytes to MAVLink frames and back. Nothing that arrives can raise, and nothing that arrives is kept for long.

What is known (`messages`) must have a correct checksum. What is not known cannot be checked, as the checksum contains a
byte of the definition: it passes by its shape, that is when it is whole, names a sender, and another frame or nothing
follows. So there are two ways for noise to hide a frame: an unknown message that noise happens to look like swallows
what lies in it; and in a stream a false beginning keeps what follows waiting until the 280 bytes of the longest frame
are there at most. In a datagram nothing waits.
"""

from __future__ import annotations

import re
import struct
from binascii import crc_hqx
from dataclasses import dataclass

from companion.mavlink.messages import BY_NAME, LAYOUTS, NAMES

__all__ = ["LONGEST_FRAME", "NAMES", "SIGNED", "Encoder", "Frame", "Framer", "checksum", "decode"]

MAVLINK_1, MAVLINK_2 = 0xFE, 0xFD
SIGNED = 0x01
"""Incompatibility flag of MAVLink 2: a signature follows the checksum. No other is known."""
LONGEST_FRAME = 280
"""Bytes: header 10, payload 255, checksum 2, signature 13."""

_START = re.compile(rb"[\xfd\xfe]")
_MIRROR = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_HEADER_2 = struct.Struct("<BBBBBBBHB")
_EXTRA = {number: bytes((layout.crc_extra,)) for number, layout in LAYOUTS.items()}


@dataclass(frozen=True, slots=True)
class Frame:
    """One message as it was on the wire.

    Attributes:
        raw: all of it, the signature included.
        message_id: which message.
        system_id: of the sender.
        component_id: of the sender.
        payload: without the zeros at its end that MAVLink 2 leaves out.
        signed: whether a signature is there; not whether it is right.
    """

    raw: bytes
    message_id: int
    system_id: int
    component_id: int
    payload: bytes
    signed: bool


class Framer:
    """Finds the frames of MAVLink 1 and 2 in what arrives.

    Args:
        datagram: each call gets a whole datagram: what is unfinished at its end is dropped and counted. Otherwise it
            is a stream, and the rest is kept for the next call.

    Attributes:
        bad: stretches of bytes that were no message, each counted at least once in each call.
    """

    def __init__(self, *, datagram: bool = False) -> None:
        self.bad = 0
        self._datagram = datagram
        self._rest = b""

    def frames(self, data: bytes) -> list[Frame]:
        """All whole frames, in order. Never raises; keeps less than `LONGEST_FRAME` bytes."""
        data = self._rest + data
        self._rest = b""
        found: list[Frame] = []
        at, good_until = 0, 0
        while (start := _START.search(data, at)) is not None:
            begin = start.start()
            end = begin + _size(data, begin)
            if end > len(data) and not self._datagram:
                self._rest = data[begin:]
                break
            frame = _read(data, begin, end) if begin < end <= len(data) else None
            if frame is None:
                at = begin + 1
                continue
            self.bad += begin > good_until
            found.append(frame)
            at = good_until = end
        self.bad += len(data) - len(self._rest) > good_until
        return found


def _size(data: bytes, begin: int) -> int:
    """Bytes of the frame that seems to begin here; 0: none does; the least that it could be without its header."""
    available = len(data) - begin
    if data[begin] == MAVLINK_1:
        return 8 + data[begin + 1] if available > 1 else 8
    if available < 3:
        return 12
    flags = data[begin + 2]
    if flags & ~SIGNED:
        # A flag that says: whoever does not know me must not read this.
        return 0
    return 12 + data[begin + 1] + 13 * flags


def _read(data: bytes, begin: int, end: int) -> Frame | None:
    """The frame in ``data[begin:end]``, if it is one."""
    if data[begin] == MAVLINK_1:
        _, length, _, system_id, component_id, message_id = data[begin : begin + 6]
        payload_at, signed = begin + 6, 0
    else:
        _, length, signed, _, _, system_id, component_id, low, high = _HEADER_2.unpack_from(data, begin)
        payload_at, message_id = begin + 10, low | high << 16
    crc_at = payload_at + length
    extra = _EXTRA.get(message_id)
    if extra is not None:
        if checksum(data[begin + 1 : crc_at] + extra) != data[crc_at] | data[crc_at + 1] << 8:
            return None
    elif not system_id or (end < len(data) and data[end] not in (MAVLINK_1, MAVLINK_2)):
        return None
    payload = data[payload_at:crc_at]
    return Frame(data[begin:end], message_id, system_id, component_id, payload, bool(signed))


def checksum(data: bytes, initial: int = 0xFFFF) -> int:
    """CRC-16/MCRF4XX, MAVLink's.

    It is CRC-16/CCITT, which the standard library computes in C, with the bits of each byte and of the result mirrored.

    Args:
        data: from behind the magic byte to the payload's end, and CRC_EXTRA.
        initial: 0xFFFF, or 0 for a difference of two messages.
    """
    mirrored = crc_hqx(data.translate(_MIRROR), initial)
    return _MIRROR[mirrored >> 8] | _MIRROR[mirrored & 0xFF] << 8


def decode(frame: Frame) -> dict[str, int | float | str] | None:
    """The fields by name; None for a message that is not in the table, or longer than the one that is.

    Numbers are as they came, NaN too. Lists of numbers are left out. Text ends before its first zero.
    """
    layout = LAYOUTS.get(frame.message_id)
    if layout is None or len(frame.payload) > layout.packing.size:
        return None
    values = layout.packing.unpack(frame.payload.ljust(layout.packing.size, b"\0"))
    fields: dict[str, int | float | str] = dict(zip(layout.fields, values, strict=True))
    for name in layout.texts:
        fields[name] = values[layout.fields.index(name)].partition(b"\0")[0].decode("ascii", "replace")
    return fields


class Encoder:
    """Packs messages of one sender as MAVLink 2, with its running sequence number.

    Args:
        system_id: of the vehicle.
        component_id: of the sender.
    """

    def __init__(self, system_id: int, component_id: int) -> None:
        self._system_id = system_id
        self._component_id = component_id
        self._sequence = 0

    def pack(self, name: str, /, **fields: int | float | str) -> bytes:
        """One frame. A field that is left out is 0; a text that is too long is cut.

        Raises:
            ValueError: there is no such message or field, or the number does not fit the field.
        """
        layout = BY_NAME.get(name)
        if layout is None:
            raise ValueError(f"no message {name} in the table")
        if unknown := fields.keys() - layout.fields:
            raise ValueError(f"{name} has no field {', '.join(sorted(unknown))}")
        values = [_on_wire(fields.get(field, "" if field in layout.texts else 0)) for field in layout.fields]
        try:
            # One byte at least stays, also of nothing but zeros.
            payload = layout.packing.pack(*values)
        except (struct.error, OverflowError) as error:
            raise ValueError(f"{name}: {error}") from error
        payload = payload[:1] + payload[1:].rstrip(b"\0")
        number = layout.message_id
        body = _HEADER_2.pack(
            MAVLINK_2, len(payload), 0, 0, self._sequence, self._system_id, self._component_id, number & 0xFFFF, 0
        )
        body += payload
        self._sequence = (self._sequence + 1) % 256
        return body + checksum(body[1:] + _EXTRA[number]).to_bytes(2, "little")


def _on_wire(value: int | float | str) -> int | float | bytes:
    return value.encode("ascii", "replace") if isinstance(value, str) else value
