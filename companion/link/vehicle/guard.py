"""Who may command, and what: each order is checked before the application hears of it. Pure."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from companion.config.link import is_name
from companion.errors import InputError
from companion.link.certificates import Certificates, signed_by
from companion.link.wire import Order, RefusedError, SignedOrder, WireError, decoded
from companion.link.words import Answer

MOST_REMEMBERED = 256
"""Orders of the last seconds; of more than these none is taken: nobody presses buttons so fast."""

AHEAD_S = 1.0
"""A sender reckons the vehicle's clock by what it heard, so never ahead of it but for what its own runs too fast."""


_ID = re.compile(r"[0-9a-f]{32}")


Proof = Callable[[SignedOrder], str]
"""The name of who gave an order, or `RefusedError`."""


def by_certificate(certificates: Certificates, commanders: Collection[str]) -> Proof:
    """Who gave an order, by the certificate that it was signed with; only those whose role is to command.

    Args:
        certificates: of this vehicle.
        commanders: only these of them; empty: all.
    """

    def proof(signed: SignedOrder) -> str:
        try:
            name, role, _ = signed_by(signed.certificate, signed.order, signed.signature, certificates)
        except InputError as error:
            raise RefusedError(str(error)) from None
        if role != "command":
            raise RefusedError(f"{name} may {role}, not command")
        if commanders and name not in commanders:
            raise RefusedError(f"{name} is not among link.commanders")
        return name

    return proof


def by_its_word(signed: SignedOrder) -> str:
    """Who gave an order, as it says itself: on loopback, where nobody has to prove it."""
    return decoded(Order, signed.order.encode()).by


@dataclass(frozen=True, slots=True)
class _Known:
    order: Order
    answer: Answer | None


class CommandGuard:
    """Lets an order pass once: when it is for this vehicle and this session, young, and of somebody who may give it.

    Args:
        vehicle: its name.
        session: of this process.
        oldest_s: an order that was given longer ago is refused.
        proof: who gave it.
    """

    def __init__(self, vehicle: str, session: str, oldest_s: float, proof: Proof) -> None:
        self._vehicle = vehicle
        self._session = session
        self._oldest_s = oldest_s
        self._proof = proof
        self._known: dict[str, _Known] = {}

    def check(self, data: bytes, now_s: float) -> tuple[Order, Answer | None, bool]:
        """An order that came.

        Returns:
            The order; its answer, when it came before and has one; and whether it is new, so that it is to be obeyed.

        Raises:
            RefusedError: it is not obeyed.
        """
        try:
            signed = decoded(SignedOrder, data)
            order = decoded(Order, signed.order.encode())
        except WireError as error:
            raise RefusedError(str(error)) from None
        if _ID.fullmatch(order.id) is None:
            raise RefusedError("its number is none")
        if not is_name(order.by):
            raise RefusedError("who gave it has no name")
        if order.vehicle != self._vehicle:
            raise RefusedError(f"it is for the vehicle {order.vehicle[:32]!r}, and this is {self._vehicle}")
        who = self._proof(signed)
        if who != order.by:
            raise RefusedError(f"it says that it is by {order.by[:32]!r}, but {who} has signed it")
        if order.session != self._session:
            raise RefusedError("it was given before the vehicle's link began anew: give it again")
        age_s = now_s - order.clock_s
        if age_s > self._oldest_s:
            raise RefusedError(
                f"it was given {age_s:.1f} s ago, more than link.oldest_command_s = {self._oldest_s:g} s"
            )
        if age_s < -AHEAD_S:
            raise RefusedError(f"it is dated {-age_s:.1f} s ahead of the vehicle's clock")
        return self._once(order, now_s)

    def answered(self, id_: str, answer: Answer) -> None:
        """What became of an order; it is said again when the order comes again."""
        known = self._known.get(id_)
        if known is not None:
            self._known[id_] = _Known(known.order, answer)

    def _once(self, order: Order, now_s: float) -> tuple[Order, Answer | None, bool]:
        # What is too old to be obeyed need not be remembered.
        forget_s = now_s - self._oldest_s - AHEAD_S
        self._known = {id_: known for id_, known in self._known.items() if known.order.clock_s >= forget_s}
        known = self._known.get(order.id)
        if known is None:
            if len(self._known) >= MOST_REMEMBERED:
                raise RefusedError(f"more than {MOST_REMEMBERED} commands in {self._oldest_s:g} s: wait a moment")
            self._known[order.id] = _Known(order, None)
            return order, None, True
        if order.attempt <= known.order.attempt:
            raise RefusedError("it was sent before, letter for letter: a replay")
        if replace(order, attempt=0, clock_s=0.0) != replace(known.order, attempt=0, clock_s=0.0):
            raise RefusedError("another command had the same number")
        self._known[order.id] = replace(known, order=order)
        return order, known.answer, False
