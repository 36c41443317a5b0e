"""Who commands, and what proves it."""

from __future__ import annotations

from dataclasses import replace

from companion.link.certificates import Certificates
from companion.link.wire import Order, SignedOrder, encoded


class Signer:
    """Signs orders, with a certificate or, on loopback, by its word only.

    Args:
        name: of who commands, where no certificate says it.
        certificates: of the operator.
    """

    def __init__(self, name: str, certificates: Certificates | None) -> None:
        self.name = name if certificates is None else certificates.name
        self._certificates = certificates

    def signed(self, order: Order, attempt: int) -> SignedOrder:
        """An order, ready to be sent for the n-th time."""
        text = encoded(replace(order, attempt=attempt)).decode()
        if self._certificates is None:
            return SignedOrder(text)
        return SignedOrder(text, self._certificates.certificate, self._certificates.sign(text))
