"""What a vehicle tells is sealed there, and believed elsewhere when it is its own, and new. Pure.

With certificates each message is signed, and the certificate must be that of a vehicle of the name that it is told as.
A message of a session counts once, and only the newest; a session counts from when it has shown that it is of now. An
answer counts for its question only: `companion.link.answering`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from companion.config.link import is_name
from companion.control.fleet import MOST_VEHICLES
from companion.errors import InputError
from companion.link.certificates import Certificates, Holder, bytes_signed_by
from companion.link.envelope import Envelope, Quote
from companion.link.wire import RefusedError

CERTIFICATE_PERIOD_S = 1.0
"""A certificate is larger than most of what it proves: whoever has had it once keeps it."""


class Seal:
    """Seals what this vehicle tells.

    Args:
        session: of this process.
        certificates: of this vehicle; None: on loopback, where nobody has to prove who they are.

    Attributes:
        sent: the number of the newest message.
    """

    def __init__(self, session: str, certificates: Certificates | None) -> None:
        self.sent = 0
        self._session = session
        self._certificates = certificates
        self._next_certificate_s = -math.inf

    def sealed(self, message: bytes, heard: Mapping[str, Quote], now_s: float) -> bytes:
        """A message, ready to be sent.

        Args:
            message: what is told.
            heard: whom this vehicle has heard.
            now_s: now.
        """
        self.sent += 1
        certificate = b""
        if self._certificates is not None and now_s >= self._next_certificate_s:
            self._next_certificate_s = now_s + CERTIFICATE_PERIOD_S
            certificate = self._certificates.certificate_der
        return self._signed(Envelope(self._session, self.sent, heard, message, certificate))

    def answer(self, message: bytes) -> bytes:
        """An answer, sealed for who has asked; from any thread.

        It has no number, since it counts for its question and not in an order, and no certificate: whoever asks has had
        that with what this vehicle tells.
        """
        return self._signed(Envelope(self._session, 0, {}, message))

    def _signed(self, envelope: Envelope) -> bytes:
        if self._certificates is not None:
            envelope = replace(envelope, signature=self._certificates.sign_bytes(envelope.signed()))
        return envelope.encode()


class Proofs:
    """Tells whose a sealed message is.

    Args:
        certificates: of whoever reads; None: on loopback.
    """

    def __init__(self, certificates: Certificates | None) -> None:
        self._certificates = certificates
        self._certificate_of: dict[str, bytes] = {}

    def whose(self, sender: str, envelope: Envelope) -> Holder | None:
        """The vehicle that has sealed it; None while the certificate of a signed one has not come yet.

        Args:
            sender: whose topic it came on.
            envelope: what came.

        Raises:
            RefusedError: nobody's that is to be believed.
        """
        if not is_name(sender):
            raise RefusedError("who tells it has no name")
        if self._certificates is None:
            return Holder(sender, "vehicle", None)
        certificate = envelope.certificate
        if envelope.signature and not certificate:
            certificate = self._certificate_of.get(sender, b"")
            if not certificate:
                return None
        try:
            who = bytes_signed_by(certificate, envelope.signed(), envelope.signature, self._certificates)
        except InputError as error:
            raise RefusedError(str(error)) from None
        if who.role != "vehicle":
            raise RefusedError(f"{who.name} may {who.role}, and is no vehicle")
        if who.name != sender:
            raise RefusedError(f"it is told as that of {sender[:32]!r}, but {who.name} has signed it")
        if who.name in self._certificate_of or len(self._certificate_of) < MOST_VEHICLES:
            self._certificate_of[who.name] = certificate
        return who


class Sessions:
    """The sessions of one vehicle, of which each message counts once.

    Args:
        most: so many are kept.
        forgets: whether the oldest makes room for a new one; else a new one is refused.

    Attributes:
        newest: message of it, also of a session that is not believed yet.
    """

    def __init__(self, most: int, *, forgets: bool) -> None:
        self.newest: Quote = ("", 0)
        self._most = most
        self._forgets = forgets
        self._numbers: dict[str, int] = {}

    def take(self, name: str, envelope: Envelope, *, is_of_now: bool) -> bool:
        """Whether a message is believed now.

        Args:
            name: of the vehicle.
            envelope: proven to be its own.
            is_of_now: whether it shows that it was written a moment ago.

        Raises:
            RefusedError: it never will be.
        """
        session, number = envelope.session, envelope.number
        if session in self._numbers:
            if number <= self._numbers[session]:
                raise RefusedError(f"it came before, or after a newer one of {name}")
        else:
            self.newest = session, number
            if not is_of_now:
                return False
            if len(self._numbers) >= self._most and not self._forgets:
                raise RefusedError(f"{name} has begun anew {self._most} times: begin anew here")
            while len(self._numbers) >= self._most:
                del self._numbers[next(iter(self._numbers))]
        self._numbers[session] = number
        self.newest = session, number
        return True
