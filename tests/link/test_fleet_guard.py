"""What another vehicle tells is believed once, while it is new, and only where it is its own."""

from __future__ import annotations

import contextlib
import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.cli.main import main
from companion.control.fleet import MOST_VEHICLES, Report
from companion.errors import InputError
from companion.link.authority import Authority
from companion.link.certificates import REVOKED, Certificates, vehicle_certificates
from companion.link.envelope import Envelope, read_envelope
from companion.link.fleet_messages import FleetMessage
from companion.link.sealing import CERTIFICATE_PERIOD_S
from companion.link.vehicle.fleet_guard import MOST_SESSIONS, QUOTE_HOLDS_S, FleetGuard
from companion.link.wire import RefusedError, WireError

NUMBERS = {"drone1": 1, "drone2": 2, "drone3": 3}


def told(vehicle: int, x_m: float = 0.0) -> bytes:
    return FleetMessage(vehicle, 1, Report(1.0, x_m, 0.0, 0.0)).encode()


def session(number: int) -> str:
    return f"{number:016x}"


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    made = Authority.make(tmp_path / "authority")
    for name, number in NUMBERS.items():
        made.issue(name, "vehicle", tmp_path / name, number)
    made.issue("bob", "watch", tmp_path / "bob")
    made.issue("anna", "command", tmp_path / "anna")
    made.issue("lone", "vehicle", tmp_path / "lone")
    return made


class Pair:
    """Two vehicles that believe each other.

    Args:
        folder: with their certificates; None: without.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self.now_s = 100.0
        self.one, self.two = self.guard("drone1"), self.guard("drone2")
        for _ in range(2):
            self.to_two = self.one.sealed(told(1), self.now_s)
            self.two.opened("drone1", self.to_two, self.now_s)
            self.to_one = self.two.sealed(told(2), self.now_s)
            self.one.opened("drone2", self.to_one, self.now_s)

    def guard(self, name: str, session_: str = "") -> FleetGuard:
        given = None if self.folder is None else Certificates(self.folder / name)
        return FleetGuard(name, NUMBERS.get(name, 9), session_ or session(NUMBERS.get(name, 9)), given)

    def comes(self, data: bytes, sender: str = "drone2") -> tuple[int, bytes] | None:
        """What the first makes of it."""
        return self.one.opened(sender, data, self.now_s)

    def next(self, message: bytes = b"") -> bytes:
        """The next of the second."""
        return self.two.sealed(message or told(2), self.now_s)


@pytest.fixture(params=["signed", "unsigned"])
def pair(request: pytest.FixtureRequest, tmp_path: Path, authority: Authority) -> Pair:
    assert authority.issued()
    return Pair(tmp_path if request.param == "signed" else None)


def test_two_believe_each_other_after_two_messages_each(pair: Pair) -> None:
    """Lost ones do no harm: the newest counts."""
    assert pair.comes(pair.next(told(2, 1.0))) == (2, told(2, 1.0))
    for _ in range(100):
        pair.next()
    assert pair.comes(pair.next(told(2, 2.0))) == (2, told(2, 2.0))


def test_what_came_before_or_is_overtaken_is_refused(pair: Pair) -> None:
    first, second = pair.next(), pair.next()
    assert pair.comes(second)
    for data in (first, second):
        with pytest.raises(RefusedError, match="came before"):
            pair.comes(data)


def test_an_earlier_flight_cannot_be_played_back(pair: Pair) -> None:
    """Everything that was ever sent, also to this vehicle, before its link began anew: nothing of it is believed."""
    record = [pair.next(told(2, float(k))) for k in range(20)]
    pair.one = pair.guard("drone1", session(77))
    for k in range(3):
        pair.one.sealed(told(1), pair.now_s + k)
    assert [pair.comes(data) for data in record] == [None] * 20
    # The true one is believed as before, whatever was played back.
    pair.two.opened("drone1", pair.one.sealed(told(1), pair.now_s), pair.now_s)
    pair.now_s += CERTIFICATE_PERIOD_S
    assert pair.comes(pair.next())
    with pytest.raises(RefusedError, match="came before"):
        pair.comes(record[-1])


def test_a_vehicle_that_began_anew_is_believed_and_what_it_was_before_is_not(pair: Pair) -> None:
    before = [pair.next() for _ in range(3)]
    assert pair.comes(before[0])
    for k in range(2 * MOST_SESSIONS):
        pair.two = pair.guard("drone2", session(100 + k))
        assert pair.comes(pair.next()) is None, "it has not shown yet that it is of now"
        pair.now_s += CERTIFICATE_PERIOD_S
        pair.two.opened("drone1", pair.one.sealed(told(1), pair.now_s), pair.now_s)
        assert pair.comes(pair.next())
        pair.now_s += QUOTE_HOLDS_S
    # What it quotes is too old by now: it may have been written before.
    pair.now_s += 1.0
    assert pair.comes(before[1]) is None


def test_a_quote_does_not_hold_for_long(pair: Pair) -> None:
    """A message of a session that was never believed, kept back and brought later."""
    pair.two = pair.guard("drone2", session(50))
    pair.two.opened("drone1", pair.one.sealed(told(1), pair.now_s), pair.now_s)
    late = pair.next()
    pair.now_s += QUOTE_HOLDS_S + 0.1
    assert pair.comes(late) is None


def test_nobody_takes_the_number_or_the_name_of_another_one(pair: Pair) -> None:
    """Neither this vehicle's own nor that of one that was heard."""
    third = pair.guard("drone3")
    for number, sender, why in ((2, "drone3", "number"), (1, "drone3", "number"), (3, "drone1", "called|signed it")):
        pair.now_s += CERTIFICATE_PERIOD_S
        with pytest.raises(RefusedError, match=why):
            pair.comes(third.sealed(told(number), pair.now_s), sender)


@pytest.mark.parametrize(
    ("forger", "sender", "number", "why"),
    [
        ("drone3", "drone2", 2, "drone3 has signed it"),
        ("drone3", "drone3", 2, "has the number 3, and says 2"),
        ("bob", "bob", 2, "bob may watch, and is no vehicle"),
        ("bob", "drone2", 2, "bob may watch, and is no vehicle"),
        ("anna", "drone2", 2, "anna may command, and is no vehicle"),
        ("lone", "lone", 2, "without a number"),
    ],
)
def test_what_another_one_has_signed_is_refused(
    forger: str, sender: str, number: int, why: str, tmp_path: Path, authority: Authority
) -> None:
    """Whoever has a certificate, whatever for: nobody tells where the second is but itself."""
    assert authority.issued()
    pair = Pair(tmp_path)
    forged = FleetGuard(sender, number, session(5), Certificates(tmp_path / forger))
    for _ in range(3):
        pair.now_s += CERTIFICATE_PERIOD_S
        with pytest.raises(RefusedError, match=why):
            pair.comes(forged.sealed(told(number, 50.0), pair.now_s), sender)
    assert pair.comes(pair.next())


@pytest.mark.parametrize("forger", ["drone3", "bob"])
def test_leaving_out_the_certificate_helps_no_forger(forger: str, tmp_path: Path, authority: Authority) -> None:
    """That of the second is known by then: it is not the forger's signature."""
    assert authority.issued()
    pair = Pair(tmp_path)
    forged = FleetGuard("drone2", 2, session(5), Certificates(tmp_path / forger))
    forged.sealed(told(2), pair.now_s)
    with pytest.raises(RefusedError, match="not that of drone2"):
        pair.comes(forged.sealed(told(2, 50.0), pair.now_s))


def test_what_is_not_signed_or_changed_on_its_way_is_refused(tmp_path: Path, authority: Authority) -> None:
    assert authority.issued()
    pair = Pair(tmp_path)
    bare = Pair(None)
    with pytest.raises(RefusedError, match="not signed"):
        pair.comes(bare.next())
    good = read_envelope(pair.next())
    later = Envelope(good.session, good.number + 5, good.heard, good.message, good.certificate, good.signature)
    moved = Envelope(good.session, good.number, good.heard, told(2, 50.0), good.certificate, good.signature)
    quoted = Envelope(good.session, good.number, {}, good.message, good.certificate, good.signature)
    for changed in (later, moved, quoted):
        with pytest.raises(RefusedError, match="not that of drone2"):
            pair.comes(changed.encode())
    assert pair.comes(good.encode())


def test_certificates_go_once_a_second_and_who_is_revoked_is_not_believed(tmp_path: Path, authority: Authority) -> None:
    pair = Pair(tmp_path)
    sizes = []
    for _ in range(10):
        pair.now_s += 0.21
        data = pair.next()
        sizes.append(len(data))
        assert pair.comes(data)
    assert max(sizes) > 500 > min(sizes)
    assert sum(size > 500 for size in sizes) == round(10 * 0.21 / CERTIFICATE_PERIOD_S)
    authority.revoke("drone2")
    (tmp_path / "drone1" / REVOKED).write_bytes((tmp_path / "authority" / REVOKED).read_bytes())
    with pytest.raises(RefusedError, match="revoked"):
        pair.comes(pair.next())


def test_no_more_are_known_than_can_be(pair: Pair) -> None:
    if pair.folder is not None:
        return
    refused = 0
    for number in range(10, 10 + MOST_VEHICLES):
        other = FleetGuard(f"other{number}", number, session(number), None)
        try:
            pair.comes(other.sealed(told(number), pair.now_s), f"other{number}")
        except RefusedError:
            refused += 1
    assert refused == 1, "drone2 is one of them"
    with pytest.raises(RefusedError, match="no name"):
        pair.comes(pair.next(), "a/b")


def test_what_is_no_envelope_is_refused() -> None:
    good = Envelope(session(1), 1, {"drone2": (session(2), 3)}, told(1)).encode()
    assert read_envelope(good).encode() == good
    heads: list[object] = [[], {}, [1, 1, {}], [session(1), -1, {}], [session(1), 1, []], [session(1), True, {}]]
    heads += [
        [session(1), 1, {"a/b": [session(2), 1]}],
        [session(1), 1, {"a": [session(2)]}],
        [session(1), 1, {"a": 1}],
    ]
    heads += [[session(1), 1, {f"d{k}": [session(2), 1] for k in range(MOST_VEHICLES + 1)}]]
    for head in heads:
        text = json.dumps(head).encode()
        with pytest.raises(WireError):
            read_envelope(good[:5] + len(text).to_bytes(2, "little") + bytes(4) + text + told(1))
    for data in (b"", b"MCFE", b"X" * 40, good[:20], bytes(100_000)):
        with pytest.raises(WireError):
            read_envelope(data)


@given(st.binary(max_size=200), st.integers(0, 120))
def test_nothing_but_a_refusal_comes_of_any_bytes(noise: bytes, at: int) -> None:
    guard = FleetGuard("drone1", 1, session(1), None)
    good = Envelope(session(2), 1, {}, told(2)).encode()
    for data in (noise, good[:at] + noise + good[at + len(noise) :]):
        with contextlib.suppress(RefusedError):
            guard.opened("drone2", data, 1.0)


@pytest.mark.filterwarnings("ignore:Parsed a serial number")
def test_nothing_but_a_refusal_comes_of_a_certificate_that_is_changed(tmp_path: Path, authority: Authority) -> None:
    """One octet after the other, and two kinds of change."""
    assert authority.issued()
    pair = Pair(tmp_path)
    pair.now_s += CERTIFICATE_PERIOD_S
    good = read_envelope(pair.next())
    assert len(good.certificate) > 300
    for at in range(len(good.certificate)):
        for octet in (good.certificate[at] ^ 1, 0xFF - good.certificate[at]):
            changed = good.certificate[:at] + bytes([octet]) + good.certificate[at + 1 :]
            with pytest.raises(RefusedError):
                pair.comes(replace(good, certificate=changed).encode())
    assert pair.comes(good.encode())


def test_the_authority_gives_each_number_once(
    tmp_path: Path, authority: Authority, capsys: pytest.CaptureFixture[str]
) -> None:
    """And says what to do, as the vehicle does that has another number than its certificate."""
    with pytest.raises(InputError, match="drone2 has the number 2 already"):
        authority.issue("drone4", "vehicle", tmp_path / "drone4", 2)
    with pytest.raises(InputError, match="and nobody else"):
        authority.issue("carl", "command", tmp_path / "carl", 7)
    authority.revoke("drone2")
    where = ["--authority", str(tmp_path / "authority")]
    for words in (["vehicle", "drone4", "--number", "2", "--out", str(tmp_path / "drone4")], ["list"]):
        with pytest.raises(SystemExit) as ended:
            main(["keys", *words, *where])
        assert ended.value.code == 0
    assert re.search(r"drone4\s+vehicle\s+2\s+valid", capsys.readouterr().out)
    assert vehicle_certificates(str(tmp_path / "drone4"), "drone4", 2).number == 2
    assert vehicle_certificates(str(tmp_path / "drone4"), "drone4").number == 2
    for name, why in (("drone3", "the number 3"), ("lone", "no number")):
        with pytest.raises(InputError, match=rf"fleet.number = 9, but .* {why}.* --number 9"):
            vehicle_certificates(str(tmp_path / name), name, 9)
