"""Who commands, and what proves it."""

from __future__ import annotations

from dataclasses import replace

from companion.link.wire import Order, SignedOrder, encoded


class Signer:
    """Signs orders; this one by its word only, which is taken on loopback.

    Args:
        name: of who commands.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def signed(self, order: Order, attempt: int) -> SignedOrder:
        """An order, ready to be sent for the n-th time."""
        return SignedOrder(encoded(replace(order, attempt=attempt)).decode())
