"""What it costs that answers are sealed: their size, and what sealing and opening take, to a command and about the map.

python -m bench.link.answers
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from bench.common import say
from companion.link.answering import opened_answer, sealed_answer
from companion.link.authority import Authority
from companion.link.certificates import Certificates
from companion.link.envelope import read_envelope
from companion.link.map_wire import BUCKETS, MOST_ASKED_BYTES, Ask, Told, answer, asked
from companion.link.sealing import Proofs, Seal
from companion.link.wire import encoded
from companion.link.words import Answer

SESSION = "0123456789abcdef"
TIMES = 1_000


def main() -> None:
    """Print it."""
    random = np.random.default_rng(1)
    # Records of the map hardly shrink when they are compressed once more.
    bodies = {
        "to a command": encoded(Answer(accepted=True)),
        "nothing new of the map": answer(_told()),
        "sums of the map": answer(_told(), random.bytes(8 * BUCKETS)),
        "8 kB of the map": answer(_told(), random.bytes(8_000)),
        "the most of the map": answer(_told(), random.bytes(MOST_ASKED_BYTES)),
    }
    question = asked(Ask("chunks", "20261129-113000", f"{SESSION}-0", 1234, 1200, by="a" * 16, nonce="b" * 16))
    with tempfile.TemporaryDirectory() as folder:
        for is_signed in (False, True):
            seal, proofs = both_ends(Path(folder) if is_signed else None)
            for what, message in bodies.items():
                _print(f"{what}, {'signed' if is_signed else 'not signed'}", seal, proofs, question, message)


def both_ends(folder: Path | None) -> tuple[Seal, Proofs]:
    """A vehicle's seal, and the proofs of a ground that has heard it.

    Args:
        folder: for the certificates; None: without.
    """
    if folder is None:
        return Seal(SESSION, None), Proofs(None)
    authority = Authority.make(folder / "authority")
    authority.issue("drone1", "vehicle", folder / "drone1")
    authority.issue("anna", "command", folder / "anna")
    seal, proofs = Seal(SESSION, Certificates(folder / "drone1")), Proofs(Certificates(folder / "anna"))
    proofs.whose("drone1", read_envelope(seal.sealed(b"", {}, 0.0)))
    return seal, proofs


def _print(what: str, seal: Seal, proofs: Proofs, question: bytes, message: bytes) -> None:
    sealing_s, opening_s, data = list[float](), list[float](), b""
    for _ in range(TIMES):
        began_s = time.perf_counter()
        data = sealed_answer(seal, question, message)
        sealed_s = time.perf_counter()
        opened = opened_answer(proofs, "drone1", question, data)
        opening_s.append(time.perf_counter() - sealed_s)
        sealing_s.append(sealed_s - began_s)
        if opened != message:
            raise AssertionError("what was sealed is not opened")
    say(f"{what}: {len(message)} bytes are {len(data)}; sealing {_ms(sealing_s)}, opening {_ms(opening_s)}")


def _ms(values_s: list[float]) -> str:
    return f"{1e3 * float(np.quantile(values_s, 0.5)):.2f} ms (99 %: {1e3 * float(np.quantile(values_s, 0.99)):.2f})"


def _told() -> Told:
    return Told(f"{SESSION}-0", "20261129-113000", 1234, 1234, "0123456789abcdef", 400)


if __name__ == "__main__":
    main()
