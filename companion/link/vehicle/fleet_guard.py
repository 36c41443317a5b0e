"""What other vehicles tell is believed when it is theirs, and new. Pure.

A position under another one's number would send a vehicle into another's layer, and so would an old one that is played
back. So with certificates each message is signed, and the number in it must be the one that the authority has put into
the certificate. A message of a session counts once, and only the newest. A session counts from when it quotes what this
vehicle has sent in the last seconds: two that come into each other's reach believe each other after two messages each.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace

from companion.config.link import is_name
from companion.control.fleet import MOST_VEHICLES
from companion.errors import InputError
from companion.link.certificates import Certificates, Holder, bytes_signed_by
from companion.link.fleet_envelope import Envelope, Quote, read_envelope
from companion.link.fleet_messages import FleetMessageError, decode
from companion.link.vehicle.guard import RefusedError
from companion.link.wire import WireError

CERTIFICATE_PERIOD_S = 1.0
"""A certificate is larger than most of what it proves: whoever has had it once keeps it."""

QUOTE_HOLDS_S = 5.0
"""What quotes something older of this vehicle may have been written before the sender began anew."""

MOST_SESSIONS = 4
"""Of one vehicle: it begins anew no more often than that while a quote holds."""


@dataclass(slots=True)
class _Known:
    number: int
    newest: Quote = ("", 0)
    sessions: dict[str, int] = field(default_factory=dict)
    """Those that were believed, oldest first, and the newest number of each."""


class FleetGuard:
    """Seals what this vehicle tells, and opens what others tell.

    Args:
        name: of this vehicle.
        number: in the fleet.
        session: of this process.
        certificates: of this vehicle; None: on loopback, where nobody has to prove who they are.
    """

    def __init__(self, name: str, number: int, session: str, certificates: Certificates | None) -> None:
        self._name = name
        self._number = number
        self._session = session
        self._certificates = certificates
        self._sent = 0
        self._sent_s: deque[tuple[int, float]] = deque()
        self._next_certificate_s = -math.inf
        self._known: dict[str, _Known] = {}
        self._certificate_of: dict[str, bytes] = {}

    @property
    def others(self) -> int:
        """How many other vehicles have been heard."""
        return len(self._known)

    def sealed(self, message: bytes, now_s: float) -> bytes:
        """What this vehicle tells, ready to be sent."""
        self._sent += 1
        self._sent_s.append((self._sent, now_s))
        self._forget(now_s)
        heard = {name: known.newest for name, known in self._known.items()}
        envelope = Envelope(self._session, self._sent, heard, message)
        given = self._certificates
        if given is not None:
            certificate = b""
            if now_s >= self._next_certificate_s:
                self._next_certificate_s = now_s + CERTIFICATE_PERIOD_S
                certificate = given.certificate_der
            envelope = replace(envelope, certificate=certificate, signature=given.sign_bytes(envelope.signed()))
        return envelope.encode()

    def opened(self, sender: str, data: bytes, now_s: float) -> tuple[int, bytes] | None:
        """What another vehicle told; None while it has not shown whose it is and that it is of now.

        Args:
            sender: whose topic it came on.
            data: what came.
            now_s: now.

        Returns:
            The number of the vehicle, and its message.

        Raises:
            RefusedError: it is not to be believed.
        """
        try:
            envelope = read_envelope(data)
            who = self._who(sender, envelope)
            if who is None:
                return None
            vehicle = decode(envelope.message).vehicle
        except (WireError, FleetMessageError, InputError) as error:
            raise RefusedError(str(error)) from None
        if vehicle != who.number and who.number is not None:
            raise RefusedError(f"it is of {who.name}, who has the number {who.number}, and says {vehicle}")
        known = self._sender(who.name, vehicle)
        if envelope.session in known.sessions:
            if envelope.number <= known.sessions[envelope.session]:
                raise RefusedError(f"it came before, or after a newer one of {who.name}")
        else:
            known.newest = envelope.session, envelope.number
            if not self._is_of_now(envelope, now_s):
                return None
            while len(known.sessions) >= MOST_SESSIONS:
                del known.sessions[next(iter(known.sessions))]
        known.sessions[envelope.session] = envelope.number
        known.newest = envelope.session, envelope.number
        return vehicle, envelope.message

    def _who(self, sender: str, envelope: Envelope) -> Holder | None:
        """Whose it is; None while the certificate of a signed one has not come yet."""
        if not is_name(sender):
            raise RefusedError("who tells it has no name")
        if self._certificates is None:
            return Holder(sender, "vehicle", None)
        certificate = envelope.certificate
        if envelope.signature and not certificate:
            certificate = self._certificate_of.get(sender, b"")
            if not certificate:
                return None
        who = bytes_signed_by(certificate, envelope.signed(), envelope.signature, self._certificates)
        if who.role != "vehicle":
            raise RefusedError(f"{who.name} may {who.role}, and is no vehicle")
        if who.name != sender:
            raise RefusedError(f"it is told as that of {sender[:32]!r}, but {who.name} has signed it")
        if who.number is None:
            raise RefusedError(f"{who.name} has a certificate without a number: make it with --number")
        if who.name in self._certificate_of or len(self._certificate_of) < MOST_VEHICLES:
            self._certificate_of[who.name] = certificate
        return who

    def _sender(self, name: str, number: int) -> _Known:
        """What is known of one; of two with one number or one name the second is not believed."""
        if name == self._name:
            raise RefusedError(f"another vehicle is called {name} as this one: give each another link.name")
        others = {self._number: self._name} | {known.number: other for other, known in self._known.items()}
        if others.get(number, name) != name:
            raise RefusedError(f"{name} has the number {number} of {others[number]}: give each another fleet.number")
        known = self._known.get(name)
        if known is None:
            if len(self._known) >= MOST_VEHICLES:
                raise RefusedError(f"{name} is one vehicle too many")
            known = self._known[name] = _Known(number)
        if known.number != number:
            raise RefusedError(f"{name} had the number {known.number}, and now says {number}")
        return known

    def _is_of_now(self, envelope: Envelope, now_s: float) -> bool:
        self._forget(now_s)
        session, number = envelope.heard.get(self._name, ("", 0))
        return session == self._session and any(number == sent for sent, _ in self._sent_s)

    def _forget(self, now_s: float) -> None:
        while self._sent_s and now_s - self._sent_s[0][1] > QUOTE_HOLDS_S:
            self._sent_s.popleft()
