"""What other vehicles tell is believed when it is theirs, and new. Pure.

A position under another one's number would send a vehicle into another's layer, and so would an old one that is played
back. So with certificates each message is signed, and the number in it must be the one that the authority has put into
the certificate. A message of a session counts once, and only the newest. A session counts from when it quotes what this
vehicle has sent in the last seconds: two that come into each other's reach believe each other after two messages each.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from companion.control.fleet import MOST_VEHICLES
from companion.link.certificates import Certificates
from companion.link.envelope import Envelope, read_envelope
from companion.link.fleet_messages import FleetMessageError, decode
from companion.link.sealing import Proofs, Seal, Sessions
from companion.link.wire import RefusedError, WireError

QUOTE_HOLDS_S = 5.0
"""What quotes something older of this vehicle may have been written before the sender began anew."""

MOST_SESSIONS = 4
"""Of one vehicle: it begins anew no more often than that while a quote holds."""


@dataclass(slots=True)
class _Known:
    number: int
    sessions: Sessions = field(default_factory=lambda: Sessions(MOST_SESSIONS, forgets=True))


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
        self._seal = Seal(session, certificates)
        self._proofs = Proofs(certificates)
        self._must_prove = certificates is not None
        self._sent_s: deque[tuple[int, float]] = deque()
        self._known: dict[str, _Known] = {}

    @property
    def others(self) -> int:
        """How many other vehicles have been heard."""
        return len(self._known)

    def sealed(self, message: bytes, now_s: float) -> bytes:
        """What this vehicle tells, ready to be sent."""
        heard = {name: known.sessions.newest for name, known in self._known.items()}
        sealed = self._seal.sealed(message, heard, now_s)
        self._sent_s.append((self._seal.sent, now_s))
        self._forget(now_s)
        return sealed

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
            who = self._proofs.whose(sender, envelope)
            if who is None:
                return None
            if who.number is None and self._must_prove:
                raise RefusedError(f"{who.name} has a certificate without a number: make it with --number")
            vehicle = decode(envelope.message).vehicle
        except (WireError, FleetMessageError) as error:
            raise RefusedError(str(error)) from None
        if vehicle != who.number and who.number is not None:
            raise RefusedError(f"it is of {who.name}, who has the number {who.number}, and says {vehicle}")
        known = self._sender(who.name, vehicle)
        if not known.sessions.take(who.name, envelope, is_of_now=self._is_of_now(envelope, now_s)):
            return None
        return vehicle, envelope.message

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
