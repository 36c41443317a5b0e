"""What a vehicle answers, to a command and about its map: sealed as what it tells, and bound to what was asked. Pure.

An answer begins with a digest of its question, as that came. Each question has something in it that was drawn for it
alone, so an answer to it was written after it, and to nothing else: what was answered before cannot be played back, and
what was answered to somebody else, or on something else, is not passed off for it. A command quotes the vehicle's
session, and so does its answer with it.
"""

from __future__ import annotations

import hashlib

from companion.link.envelope import read_envelope
from companion.link.sealing import Proofs, Seal
from companion.link.wire import RefusedError, WireError

LARGEST_BYTES = 1_200_000
"""The largest about the map, a million bytes, with its head."""

_MAGIC = b"MCAN"
"""No telemetry and no message to other vehicles begins so: the one never passes for the other."""

_DIGEST_BYTES = 16
"""Nobody finds a question of his own with the same so long as what was drawn for it is unknown to him."""


def sealed_answer(seal: Seal, question: bytes, message: bytes) -> bytes:
    """An answer, ready to be sent.

    Args:
        seal: of the vehicle.
        question: as it came.
        message: what is answered.
    """
    return seal.answer(_front(question) + message)


def opened_answer(proofs: Proofs, vehicle: str, question: bytes, data: bytes) -> bytes | None:
    """What a vehicle answers; None while the certificate that proves it has not come yet.

    Args:
        proofs: tell whose it is.
        vehicle: that was asked.
        question: as it was sent.
        data: what came.

    Raises:
        RefusedError: it is not to be believed.
    """
    try:
        envelope = read_envelope(data, LARGEST_BYTES)
    except WireError as error:
        raise RefusedError(str(error)) from None
    front = _front(question)
    if not envelope.message.startswith(front):
        raise RefusedError("it answers something else than what was asked: an old answer, or one to somebody else")
    return None if proofs.whose(vehicle, envelope) is None else envelope.message[len(front) :]


def _front(question: bytes) -> bytes:
    return _MAGIC + hashlib.sha256(question).digest()[:_DIGEST_BYTES]
