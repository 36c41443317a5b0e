"""What a vehicle answers is believed as the answer to one question, and of the vehicle that was asked."""

from __future__ import annotations

import contextlib
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.control.fleet import Report as Place
from companion.link.answering import LARGEST_BYTES, opened_answer, sealed_answer
from companion.link.authority import Authority
from companion.link.certificates import REVOKED, Certificates
from companion.link.envelope import Envelope, read_envelope
from companion.link.fleet_messages import FleetMessage
from companion.link.ground.signing import Signer
from companion.link.ground.telemetry_guard import TelemetryGuard
from companion.link.sealing import Proofs, Seal
from companion.link.vehicle.fleet_guard import FleetGuard
from companion.link.wire import Order, RefusedError, Report, encoded
from companion.link.words import Answer, Command, Telemetry

SESSION, ANOTHER, GROUND = "b" * 16, "c" * 16, "a" * 16
ORDER = Order("0123456789abcdef" * 2, 1, "drone1", SESSION, 100.0, Command.STOP, "anna")
DONE = encoded(Answer(accepted=True))


class Fleet:
    """A ground that has heard two vehicles, so that it has their certificates.

    Args:
        folder: for the certificates.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.authority = Authority.make(folder / "authority")
        for name in ("drone1", "drone2"):
            self.authority.issue(name, "vehicle", folder / name)
        self.authority.issue("anna", "command", folder / "anna")
        self.authority.issue("bob", "watch", folder / "bob")
        anna = Certificates(folder / "anna")
        self.proofs = Proofs(anna)
        self.guard = TelemetryGuard(GROUND, self.proofs)
        self._signer = Signer("", anna)
        for name in ("drone1", "drone2"):
            assert self.guard.opened(name, self.telemetry(name))

    def seal(self, name: str, session: str = SESSION) -> Seal:
        return Seal(session, Certificates(self.folder / name))

    def telemetry(self, name: str) -> bytes:
        told = encoded(Report(SESSION, 1.0, "map", 0, Telemetry(name, "flight", 1, 1.0, "exploring")))
        return self.seal(name).sealed(told, {GROUND: (GROUND, 0)}, 1.0)

    def question(self, order: Order = ORDER, attempt: int = 1) -> bytes:
        return encoded(self._signer.signed(order, attempt))

    def answer_of(self, data: bytes, question: bytes, vehicle: str = "drone1") -> bytes | None:
        return opened_answer(self.proofs, vehicle, question, data)

    def refused(self, data: bytes, question: bytes, why: str, vehicle: str = "drone1") -> None:
        with pytest.raises(RefusedError, match=why):
            self.answer_of(data, question, vehicle)


@pytest.fixture
def fleet(tmp_path: Path) -> Fleet:
    return Fleet(tmp_path)


def test_the_vehicles_own_answer_is_believed(fleet: Fleet) -> None:
    question = fleet.question()
    data = sealed_answer(fleet.seal("drone1"), question, DONE)
    assert fleet.answer_of(data, question) == DONE
    assert fleet.answer_of(sealed_answer(fleet.seal("drone1"), question, b""), question) == b""


@pytest.mark.parametrize(
    ("by", "why"),
    [
        ("bob", "its signature is not that of drone1"),
        ("anna", "its signature is not that of drone1"),
        ("drone2", "its signature is not that of drone1"),
        (None, "it is not signed"),
    ],
)
def test_nobody_else_says_that_a_stop_was_taken(fleet: Fleet, by: str | None, why: str) -> None:
    """Protects whoever walks up to a vehicle since its stop was answered."""
    question = fleet.question()
    seal = Seal(SESSION, None) if by is None else fleet.seal(by)
    fleet.refused(sealed_answer(seal, question, DONE), question, why)


@pytest.mark.parametrize(("by", "why"), [("bob", "may watch, and is no vehicle"), ("drone2", "drone2 has signed it")])
def test_a_certificate_that_comes_with_it_helps_nobody_else(fleet: Fleet, by: str, why: str) -> None:
    question = fleet.question()
    forged = read_envelope(sealed_answer(fleet.seal(by), question, DONE))
    with_it = replace(forged, certificate=Certificates(fleet.folder / by).certificate_der)
    fleet.refused(with_it.encode(), question, why)


def test_an_answer_to_something_else_is_refused(fleet: Fleet) -> None:
    """Each is genuine: to the same order before, to another one, in an earlier session, to somebody else."""
    question, seal = fleet.question(attempt=2), fleet.seal("drone1")
    others = [
        fleet.question(attempt=1),
        fleet.question(replace(ORDER, id="f" * 32), 2),
        fleet.question(replace(ORDER, session=ANOTHER), 2),
        fleet.question(replace(ORDER, command=Command.LAND), 2),
        fleet.question(replace(ORDER, vehicle="drone2"), 2),
        encoded(Signer("bob", None).signed(ORDER, 2)),
        b"",
    ]
    for other in others:
        fleet.refused(sealed_answer(seal, other, DONE), question, "something else than what was asked: an old answer")
    assert fleet.answer_of(sealed_answer(seal, question, DONE), question) == DONE


def test_what_was_changed_on_its_way_is_refused(fleet: Fleet) -> None:
    """One octet after the other: nothing but what the vehicle said is ever believed."""
    question = fleet.question()
    no = encoded(Answer(accepted=False, reason="it is on the ground"))
    data = sealed_answer(fleet.seal("drone1"), question, no)
    yes = read_envelope(data).message.replace(no, DONE)
    fleet.refused(replace(read_envelope(data), message=yes).encode(), question, "signature")
    fleet.refused(replace(read_envelope(data), session=ANOTHER).encode(), question, "signature")
    for at in range(len(data)):
        changed = data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]
        with contextlib.suppress(RefusedError):
            # Where the length of the certificate was changed it may be waited for, in vain.
            assert fleet.answer_of(changed, question) in (None, no)
    fleet.refused(DONE, question, "no sealed message")
    fleet.refused(bytes(LARGEST_BYTES + 10_000), question, "no sealed message")


def test_who_is_revoked_is_not_believed_from_that_moment_on(fleet: Fleet) -> None:
    question = fleet.question()
    data = sealed_answer(fleet.seal("drone1"), question, DONE)
    assert fleet.answer_of(data, question) == DONE
    fleet.authority.revoke("drone1")
    (fleet.folder / "anna" / REVOKED).write_bytes((fleet.folder / "authority" / REVOKED).read_bytes())
    fleet.refused(data, question, "the certificate of drone1 was revoked")
    assert fleet.answer_of(sealed_answer(fleet.seal("drone2"), question, DONE), question, "drone2") == DONE


def test_before_a_vehicle_was_heard_its_answer_is_none(fleet: Fleet) -> None:
    question = fleet.question()
    data = sealed_answer(fleet.seal("drone1"), question, DONE)
    assert opened_answer(Proofs(Certificates(fleet.folder / "anna")), "drone1", question, data) is None


def test_answers_and_what_is_told_never_pass_for_each_other(fleet: Fleet) -> None:
    """Both are signed with one key: what was signed as the one is not to be read as the other."""
    question, told = fleet.question(), fleet.telemetry("drone1")
    fleet.refused(told, question, "something else")
    report = read_envelope(told).message
    with pytest.raises(RefusedError, match="no Report"):
        fleet.guard.opened("drone1", sealed_answer(fleet.seal("drone1"), question, report))
    other = FleetGuard("drone3", 3, ANOTHER, None)
    place = FleetMessage(1, 1, Place(1.0, 0.0, 0.0, 0.0)).encode()
    with pytest.raises(RefusedError, match="no message of a vehicle"):
        other.opened("drone1", sealed_answer(Seal(SESSION, None), question, place), 1.0)


def test_without_certificates_an_answer_is_believed_by_its_word_and_to_its_question_only() -> None:
    question, proofs = b"anything", Proofs(None)
    data = sealed_answer(Seal(SESSION, None), question, DONE)
    assert opened_answer(proofs, "drone1", question, data) == DONE
    with pytest.raises(RefusedError, match="something else"):
        opened_answer(proofs, "drone1", b"anything else", data)


def test_answers_leave_the_order_of_what_is_told_as_it_is() -> None:
    """They are given by other threads, in between: a number that is missing or comes twice would cost telemetry."""
    seal = Seal(SESSION, None)
    numbers = []
    for _ in range(3):
        numbers.append(read_envelope(seal.sealed(b"x", {}, 0.0)).number)
        assert read_envelope(sealed_answer(seal, b"q", b"a")).number == 0
    assert numbers == [1, 2, 3]


@given(st.binary(max_size=200), st.integers(0, 120))
def test_nothing_but_a_refusal_comes_of_any_bytes(noise: bytes, at: int) -> None:
    good = sealed_answer(Seal(SESSION, None), b"question", DONE)
    for data in (noise, good[:at] + noise + good[at + len(noise) :], Envelope(SESSION, 0, {}, noise).encode()):
        with contextlib.suppress(RefusedError):
            opened_answer(Proofs(None), "drone1", b"question", data)


@given(st.binary(max_size=2_000), st.binary(max_size=2_000), st.binary(max_size=200))
def test_any_bytes_go_over_as_they_are_and_to_their_own_question_only(
    message: bytes, question: bytes, other: bytes
) -> None:
    data = sealed_answer(Seal(SESSION, None), question, message)
    assert opened_answer(Proofs(None), "drone1", question, data) == message
    if other != question:
        with pytest.raises(RefusedError):
            opened_answer(Proofs(None), "drone1", other, data)


def test_the_largest_answer_fits_and_one_octet_more_does_not() -> None:
    seal, proofs = Seal(SESSION, None), Proofs(None)
    front = len(sealed_answer(seal, b"q", b"")) - struct.calcsize("<4sBHHH") - len(f'["{SESSION}",0,{{}}]')
    largest = bytes(LARGEST_BYTES - front)
    assert opened_answer(proofs, "drone1", b"q", sealed_answer(seal, b"q", largest)) == largest
