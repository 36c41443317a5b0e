"""Whose telemetry is believed at the ground, and which of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.link.authority import Authority
from companion.link.certificates import REVOKED, Certificates
from companion.link.ground import telemetry_guard
from companion.link.ground.telemetry_guard import TelemetryGuard
from companion.link.sealing import CERTIFICATE_PERIOD_S, Proofs, Seal
from companion.link.wire import RefusedError, Report, encoded
from companion.link.words import Telemetry

OWN = "a" * 16
SESSION, ANOTHER = "b" * 16, "c" * 16


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    authority = Authority.make(tmp_path / "authority")
    for name in ("drone1", "drone2"):
        authority.issue(name, "vehicle", tmp_path / name)
    authority.issue("anna", "command", tmp_path / "anna")
    authority.issue("bob", "watch", tmp_path / "bob")
    return tmp_path


def report(session: str = SESSION, vehicle: str = "drone1") -> bytes:
    return encoded(Report(session, 1.0, "map", 0, Telemetry(vehicle, "flight", 1, 1.0, "exploring")))


class Told:
    """A vehicle that tells once in each period of its certificate.

    Args:
        by: folder of the certificates that it signs with; None: it does not sign.
        session: of its link.
    """

    def __init__(self, by: Path | None, session: str = SESSION) -> None:
        self._session, self._now_s = session, 0.0
        self._seal = Seal(session, None if by is None else Certificates(by))

    def next(self, *, quotes: str = OWN, vehicle: str = "drone1", session: str = "", after_s: float = 1.0) -> bytes:
        self._now_s += after_s * CERTIFICATE_PERIOD_S
        return self._seal.sealed(report(session or self._session, vehicle), {quotes: (quotes, 0)}, self._now_s)


def test_a_vehicle_is_believed_once_it_quotes_this_ground(folder: Path) -> None:
    guard, vehicle = TelemetryGuard(OWN, Proofs(Certificates(folder / "anna"))), Told(folder / "drone1")
    for quotes, is_of_now in (("d" * 16, False), (OWN, True), ("d" * 16, True)):
        opened = guard.opened("drone1", vehicle.next(quotes=quotes))
        assert opened is not None
        assert opened[0].telemetry.vehicle == "drone1"
        assert opened[1] is is_of_now


@pytest.mark.parametrize(
    ("forger", "as_whom", "says", "why"),
    [
        ("bob", "drone1", "drone1", "bob may watch, and is no vehicle"),
        ("anna", "drone1", "drone1", "anna may command, and is no vehicle"),
        ("drone2", "drone1", "drone1", "drone2 has signed it"),
        ("drone2", "drone2", "drone1", "'drone1' came as that of drone2"),
        (None, "drone1", "drone1", "not signed"),
        (None, "no name!", "drone1", "has no name"),
    ],
)
def test_nobody_else_is(folder: Path, forger: str | None, as_whom: str, says: str, why: str) -> None:
    """Protects the operator from a vehicle that is shown where it is not, and the true one from a wrong command."""
    guard = TelemetryGuard(OWN, Proofs(Certificates(folder / "anna")))
    forged = Told(None if forger is None else folder / forger)
    with pytest.raises(RefusedError, match=why):
        guard.opened(as_whom, forged.next(vehicle=says))


def test_what_was_changed_on_its_way_is_refused(folder: Path) -> None:
    guard = TelemetryGuard(OWN, Proofs(Certificates(folder / "anna")))
    with pytest.raises(RefusedError, match="signature"):
        guard.opened("drone1", Told(folder / "drone1").next().replace(b"exploring", b"returning"))
    with pytest.raises(RefusedError, match="sealed"):
        guard.opened("drone1", report())
    with pytest.raises(RefusedError, match="came as that of"):
        guard.opened("drone1", Told(folder / "drone1").next(session=ANOTHER))


def test_nothing_is_played_back(folder: Path) -> None:
    """Neither of this flight, nor of one before that this ground has heard, nor of one that it has not."""
    guard = TelemetryGuard(OWN, Proofs(Certificates(folder / "anna")))
    earlier, now = Told(folder / "drone1"), Told(folder / "drone1", ANOTHER)
    first, unheard, second = earlier.next(), earlier.next(), earlier.next()
    assert guard.opened("drone1", first)
    assert guard.opened("drone1", second)
    assert guard.opened("drone1", now.next())
    for replayed in (first, unheard, second):
        with pytest.raises(RefusedError, match="came before, or after a newer one"):
            guard.opened("drone1", replayed)
    before_it_began = Told(folder / "drone1", "e" * 16).next(quotes="f" * 16)
    opened = guard.opened("drone1", before_it_began)
    assert opened is not None
    assert not opened[1]


def test_a_certificate_that_has_not_come_is_waited_for_and_one_that_was_revoked_is_not(folder: Path) -> None:
    vehicle, guard = Told(folder / "drone1"), TelemetryGuard(OWN, Proofs(Certificates(folder / "anna")))
    first, without = vehicle.next(), vehicle.next(after_s=0.5)
    assert guard.opened("drone1", without) is None
    assert guard.opened("drone1", first) is not None
    assert guard.opened("drone1", without) is not None
    Authority(folder / "authority").revoke("drone1")
    (folder / "anna" / REVOKED).write_bytes((folder / "authority" / REVOKED).read_bytes())
    with pytest.raises(RefusedError, match="revoked"):
        guard.opened("drone1", vehicle.next())


def test_no_session_is_ever_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the memory as well: of more than it is for none is believed."""
    monkeypatch.setattr(telemetry_guard, "MOST_SESSIONS", 2)
    guard = TelemetryGuard(OWN, Proofs(None))
    for number in range(2):
        assert guard.opened("drone1", Told(None, f"{number:016x}").next())
    with pytest.raises(RefusedError, match="begun anew 2 times"):
        guard.opened("drone1", Told(None, ANOTHER).next())
    for number in range(2, 33):
        assert guard.opened(f"drone{number}", Told(None).next(vehicle=f"drone{number}"))
    with pytest.raises(RefusedError, match="one vehicle too many"):
        guard.opened("drone33", Told(None).next(vehicle="drone33"))
