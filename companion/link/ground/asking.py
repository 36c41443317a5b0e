"""How a vehicle is asked over the network: its own answer is taken, and nobody else's."""

from __future__ import annotations

from collections.abc import Callable

import zenoh

from companion.link.answering import opened_answer
from companion.link.sealing import Proofs
from companion.link.wire import RefusedError


class Asker:
    """Asks one vehicle; from any thread.

    Args:
        vehicle: its name.
        session: over which it is asked.
        proofs: tell whose an answer is.
        refused: is told why, of each answer that is not to be believed.
    """

    def __init__(self, vehicle: str, session: zenoh.Session, proofs: Proofs, refused: Callable[[str], None]) -> None:
        self._vehicle = vehicle
        self._session = session
        self._proofs = proofs
        self._refused = refused

    def ask(self, topic: str, question: bytes, timeout_s: float, priority: zenoh.Priority) -> bytes | None:
        """The vehicle's answer; None when none came in time.

        Args:
            topic: where it is asked.
            question: in which something was drawn for it alone.
            timeout_s: how long to wait.
            priority: of the question.

        Raises:
            zenoh.ZError: the session is closed.
        """
        replies = self._session.get(
            topic,
            payload=question,
            timeout=timeout_s,
            priority=priority,
            congestion_control=zenoh.CongestionControl.DROP,
            express=True,
            # Whoever else answers there must neither be asked in the vehicle's place nor hide what it answers.
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
        for reply in replies:
            if reply.ok is None:
                continue
            try:
                opened = opened_answer(self._proofs, self._vehicle, question, reply.ok.payload.to_bytes())
            except RefusedError as refusal:
                self._refused(str(refusal))
                continue
            if opened is not None:
                return opened
        return None
