"""What a vehicle tells, as it goes over the link: with what shows that it is new, and who has sent it.

The session and the number in it tell a repeated message; what the sender quotes of each other vehicle tells the other
that it was written after that, so that nothing of an earlier flight can be played back. Both need no common clock.
The ground, which tells nothing, is quoted by what it has drawn for itself.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from companion.config.link import is_name
from companion.control.fleet import MOST_VEHICLES
from companion.link.fleet_messages import LARGEST_BYTES, LARGEST_NUMBER
from companion.link.wire import WireError

_PREFIX = struct.Struct("<4sBHHH")
_MAGIC, _VERSION = b"MCFE", 1
_SESSION = re.compile(r"[0-9a-f]{16}")

LARGEST_HEADER_BYTES, LARGEST_PROOF_BYTES = 4_096, 4_096

Quote = tuple[str, int]
"""The session of a vehicle's link, and the number of a message in it; at the ground its own session, and 0."""


@dataclass(frozen=True, slots=True)
class Envelope:
    """A message, and what it comes with.

    Attributes:
        session: drawn anew each time that the sender's process of the link starts.
        number: grows with each message of a session, from 1 on; 0: it answers a question.
        heard: by the names of other vehicles, the newest that the sender had of them, or of those at the ground.
        message: what it tells, as bytes.
        certificate: of the sender, DER; empty where it was sent a moment ago, and on loopback without certificates.
        signature: of `signed`; empty without certificates.
    """

    session: str
    number: int
    heard: Mapping[str, Quote]
    message: bytes
    certificate: bytes = b""
    signature: bytes = b""

    def signed(self) -> bytes:
        """What the signature is of. No order begins so: what was signed as the one never passes for the other."""
        head = self._head()
        return _MAGIC + struct.pack("<BH", _VERSION, len(head)) + head + self.message

    def encode(self) -> bytes:
        """As bytes."""
        head = self._head()
        prefix = _PREFIX.pack(_MAGIC, _VERSION, len(head), len(self.certificate), len(self.signature))
        return prefix + head + self.certificate + self.signature + self.message

    def _head(self) -> bytes:
        return json.dumps([self.session, self.number, self.heard], separators=(",", ":")).encode()


def read_envelope(data: bytes, most_bytes: int = LARGEST_BYTES) -> Envelope:
    """The envelope that some bytes are. Nothing of it is proven, and its message is not looked at.

    Args:
        data: the bytes.
        most_bytes: that its message may have.

    Raises:
        WireError: they are none.
    """
    if not _PREFIX.size <= len(data) <= most_bytes + LARGEST_HEADER_BYTES + LARGEST_PROOF_BYTES:
        raise WireError(f"no sealed message: {len(data)} bytes")
    magic, version, head, certificate, signature = _PREFIX.unpack_from(data)
    if (magic, version) != (_MAGIC, _VERSION) or head > LARGEST_HEADER_BYTES:
        raise WireError(f"no sealed message: it begins with {magic!r}, version {version}")
    if certificate + signature > LARGEST_PROOF_BYTES:
        raise WireError("no sealed message: its proof is too long")
    at, parts = _PREFIX.size, []
    for length in (head, certificate, signature):
        parts.append(data[at : at + length])
        at += length
    try:
        session, number, heard = json.loads(parts[0])
        if not isinstance(heard, dict) or len(heard) > MOST_VEHICLES or not all(map(is_name, heard)):
            raise ValueError("what it quotes is no list of vehicles")
        quotes = {name: _quote(*quote) for name, quote in heard.items()}
        return Envelope(*_quote(session, number), quotes, data[at:], parts[1], parts[2])
    except (ValueError, TypeError, RecursionError) as error:
        raise WireError(f"no sealed message: {error}") from None


def is_session(text: str) -> bool:
    """Whether a session may be called so."""
    return _SESSION.fullmatch(text) is not None


def _quote(session: Any, number: Any) -> Quote:
    if not isinstance(session, str) or not is_session(session):
        raise ValueError("a session is none")
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number <= LARGEST_NUMBER:
        raise ValueError("a number is none")
    return session, number
