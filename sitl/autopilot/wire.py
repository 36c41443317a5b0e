"""Bytes to messages and back. Nothing that arrives can raise."""

from __future__ import annotations

import struct
from typing import Any

from sitl.autopilot.mavlink import Message, dialect
from sitl.autopilot.signing import Signing

LARGEST_DATAGRAM = 4096
"""Some fifteen messages; what is longer is nobody's telemetry."""
_BAD = ("BAD_DATA", "UNKNOWN")


class Encoder:
    """Packs what the autopilot of vehicle ``system_id`` says, with its running sequence number.

    Args:
        system_id: of the vehicle.
        signing: signs all of it.
    """

    def __init__(self, system_id: int, signing: Signing | None = None) -> None:
        self._mavlink = dialect.MAVLink(None, system_id, 1)
        self._signing = signing
        if signing is not None:
            signing.attach(self._mavlink)

    def bytes(self, message: Message) -> bytes:
        """One packet."""
        if self._signing is not None:
            self._signing.advance()
        packet: bytes = message.pack(self._mavlink)
        self._mavlink.seq = (self._mavlink.seq + 1) % 256
        return packet


class Decoder:
    """Finds the messages in a stream of bytes; datagrams get one each, so that none spoils the next.

    Args:
        signing: checks each.
    """

    def __init__(self, signing: Signing | None = None) -> None:
        self._signing = signing
        self._mavlink = self._new()
        self.bad = 0
        """Pieces that were no message."""

    def messages(self, data: bytes) -> list[Message]:
        """Whole and undamaged messages in what has newly arrived."""
        try:
            found = self._mavlink.parse_buffer(data) or []
        except (dialect.MAVError, struct.error, ValueError, TypeError, IndexError, OverflowError):
            # The parser has lost its place: what was in it is gone.
            self._mavlink = self._new()
            self.bad += 1
            return []
        good = [message for message in found if not message.get_type().startswith(_BAD)]
        self.bad += len(found) - len(good)
        return good

    @property
    def unfinished(self) -> bool:
        """Whether a message has begun and not ended: in a datagram, a truncated one."""
        return bool(len(self._mavlink.buf) > self._mavlink.buf_index)

    def _new(self) -> Any:
        mavlink = dialect.MAVLink(None)
        mavlink.robust_parsing = True
        if self._signing is not None:
            self._signing.attach(mavlink)
        return mavlink
