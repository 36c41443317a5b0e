"""MAVLink 2 signing: only who has the key is heard, and nothing is heard twice.

A signed frame has a flag in its header and, behind the checksum, the number of the link, a time stamp of 48 bits and
the first 48 bits of SHA-256 over the key and all before. See https://mavlink.io/en/guide/message_signing.html.
"""

from __future__ import annotations

import hmac
import os
import re
import stat
from collections.abc import Callable
from hashlib import sha256

from companion.mavlink.codec import MAVLINK_1, MAVLINK_2, SIGNED, checksum

KEY_BYTES = 32
SIGNATURE_BYTES = 13
RADIO_STATUS = 109
"""A telemetry radio says it, which has no key."""
MOST_STREAMS = 64
"""Senders with a right signature that are told apart."""

_EPOCH_S = 1_420_070_400
"""2015-01-01, 00:00 UTC."""
_TICKS_PER_S = 100_000
_BEHIND_TICKS = 60 * _TICKS_PER_S
_LAST_TICK = 2**48 - 2**40
"""In 2100. Nobody is believed who is later: the 127 days left are what the stamps of our own must still rise in."""
_MOST_FILE_BYTES = 4096
_HEX = re.compile(rb"[0-9a-fA-F]{64}")
# The checksum is linear: to set the flag changes it by what depends on the length of the payload alone. The flag is the
# second byte; six of the header, the payload and CRC_EXTRA follow.
_FLAG_CHANGES = tuple(checksum(b"\0\1" + bytes(7 + length + 1), 0) for length in range(256))


def load_key(path: str | os.PathLike[str]) -> bytes:
    """The key of 32 bytes in a file: as they are, or as 64 hexadecimal digits.

    Raises:
        OSError: the file cannot be read.
        ValueError: it holds no key, or is not the owner's alone.
    """
    name = os.fspath(path)
    # Without waiting: a pipe nobody writes to would hold us forever.
    file = os.open(name, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _check_owner(name, os.fstat(file))
        data = os.read(file, _MOST_FILE_BYTES)
    finally:
        os.close(file)
    key = bytes.fromhex(data.decode("ascii")) if _HEX.fullmatch(data.strip()) else data
    if len(key) != KEY_BYTES:
        raise ValueError(f"{name}: holds no key; it must be 64 hexadecimal digits or 32 bytes: openssl rand -hex 32")
    if not any(key):
        raise ValueError(f"{name}: a key of zeros means no signing to autopilots; make one: openssl rand -hex 32")
    return key


def _check_owner(name: str, found: os.stat_result) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise ValueError(f"{name}: is no file; a signing key is a file of 64 hexadecimal digits")
    if found.st_uid not in (0, os.geteuid()):
        raise ValueError(f"{name}: belongs to user {found.st_uid}; a signing key must belong to you or to root")
    mode = stat.S_IMODE(found.st_mode)
    if mode & 0o077:
        raise ValueError(f"{name}: others may use it (mode {mode:04o}); keep the key to its owner: chmod 600 {name}")


class Signer:
    """Signs what goes out on one link, and checks what comes in.

    Our stamps follow the wall clock, but never fall: a clock that was stepped back must not make us unheard. A stamp
    from the other side that is later becomes ours, as the definition asks: it is how a computer and an autopilot
    without a battery behind their clocks agree.

    Args:
        key: of 32 bytes.
        link_id: number of the link, 0 to 255.
        wall_clock: seconds since 1970, UTC.
    """

    def __init__(self, key: bytes, link_id: int, wall_clock: Callable[[], float]) -> None:
        if len(key) != KEY_BYTES:
            raise ValueError(f"a key has {KEY_BYTES} bytes, not {len(key)}")
        self._key = key
        self._link = link_id.to_bytes(1, "little")
        self._wall_clock = wall_clock
        self._ticks = 0
        self._streams: dict[bytes, int] = {}

    def sign(self, raw: bytes) -> bytes:
        """The frame with our signature, in place of any other.

        Raises:
            ValueError: it is not one whole frame of MAVLink 2, which alone can be signed.
        """
        bare = self.unsigned(raw)
        if bare[0] != MAVLINK_2:
            raise ValueError("only a frame of MAVLink 2 can be signed")
        # Strictly rising: equal stamps are refused as repetitions.
        self._ticks = max(self._ticks + 1, self._wall_ticks())
        body = _with_flag_changed(bare) + self._link + self._ticks.to_bytes(6, "little")
        return body + self._signature(body)

    def accepts(self, raw: bytes) -> bool:
        """Whether the frame is of somebody with the key, and new. Never raises.

        Unsigned frames are refused, but for RADIO_STATUS. The first of a sender must not be a minute behind us; later
        ones must rise.
        """
        if not _whole(raw):
            return False
        if not _signed(raw):
            return _message_id(raw) == RADIO_STATUS
        if not hmac.compare_digest(self._signature(raw[:-6]), raw[-6:]):
            return False
        # System, component and link: what counts its own stamps.
        stream = raw[5:7] + raw[-SIGNATURE_BYTES : -SIGNATURE_BYTES + 1]
        ticks = int.from_bytes(raw[-12:-6], "little")
        newest = self._streams.get(stream)
        if newest is None:
            if len(self._streams) >= MOST_STREAMS:
                return False
            newest = max(self._ticks, self._wall_ticks()) - _BEHIND_TICKS - 1
        if not newest < ticks < _LAST_TICK:
            return False
        self._streams[stream] = ticks
        self._ticks = max(self._ticks, ticks)
        return True

    @staticmethod
    def unsigned(raw: bytes) -> bytes:
        """The frame without signature, for those who have no key; one that has none is given back.

        Raises:
            ValueError: it is not one whole frame.
        """
        if not _whole(raw):
            raise ValueError("not one whole MAVLink frame")
        return _with_flag_changed(raw[:-SIGNATURE_BYTES]) if _signed(raw) else raw

    def _signature(self, body: bytes) -> bytes:
        return sha256(self._key + body).digest()[:6]

    def _wall_ticks(self) -> int:
        """Units of 10 us since 2015, within what a stamp can be whatever the clock says."""
        return min(max(0, int((self._wall_clock() - _EPOCH_S) * _TICKS_PER_S)), _LAST_TICK)


def _whole(raw: bytes) -> bool:
    """Whether the length is right for a frame of either version."""
    if len(raw) < 8 or raw[0] not in (MAVLINK_1, MAVLINK_2):
        return False
    if raw[0] == MAVLINK_1:
        return len(raw) == 8 + raw[1]
    return not raw[2] & ~SIGNED and len(raw) == 12 + raw[1] + SIGNATURE_BYTES * raw[2]


def _signed(raw: bytes) -> bool:
    return raw[0] == MAVLINK_2 and raw[2] == SIGNED


def _message_id(raw: bytes) -> int:
    return raw[5] if raw[0] == MAVLINK_1 else int.from_bytes(raw[7:10], "little")


def _with_flag_changed(bare: bytes) -> bytes:
    """A frame up to its checksum, with the flag of the signature set or cleared and the checksum to match."""
    crc = int.from_bytes(bare[-2:], "little") ^ _FLAG_CHANGES[bare[1]]
    return bare[:2] + bytes((bare[2] ^ SIGNED,)) + bare[3:-2] + crc.to_bytes(2, "little")
