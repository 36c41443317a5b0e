"""Bytes to messages and back, signed where there is a key. Nothing that arrives can raise."""

from __future__ import annotations

import struct
import time
from typing import Any

from sitl.autopilot.mavlink import Message, dialect

_EPOCH_S = 1_420_070_400
_TICKS_PER_S = 100_000

LARGEST_DATAGRAM = 4096
"""Some fifteen messages; what is longer is nobody's telemetry."""
_BAD = ("BAD_DATA", "UNKNOWN")


class Signing:
    """One key both ways: signs what is sent, and drops what arrives unsigned or wrongly signed.

    Args:
        key: of 32 bytes.
    """

    def __init__(self, key: bytes) -> None:
        # Shared by all parsers: it holds the newest stamp of each sender.
        self._state = dialect.MAVLinkSigning()
        self._state.secret_key = key
        self._state.sign_outgoing = True

    def advance(self) -> None:
        """Our stamps follow the clock, and whoever is ahead of it."""
        ticks = int((time.time() - _EPOCH_S) * _TICKS_PER_S)
        self._state.timestamp = max(self._state.timestamp, ticks)

    def attach(self, mavlink: Any) -> None:
        """Makes an encoder or parser of pymavlink use the key."""
        mavlink.signing = self._state
        check, stamps = mavlink.check_signature, self._state.stream_timestamps

        def checked(raw: bytearray, system_id: int, component_id: int) -> bool:
            # pymavlink believes the stamp before it looks at the signature: anybody could lock a sender out.
            sender = (raw[-13], system_id, component_id)
            before = stamps.get(sender)
            good = bool(check(raw, system_id, component_id))
            if not good:
                stamps.pop(sender, None)
                if before is not None:
                    stamps[sender] = before
            return good

        mavlink.check_signature = checked


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
