"""Somebody of the fleet answers in a vehicle's place, and a vehicle is revoked while the ground looks at it."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
import zenoh

from companion.link.authority import Authority
from companion.link.certificates import REVOKED, Certificates
from companion.link.ground.signing import Signer
from companion.link.ground.station import LinkStation
from companion.link.ground.vehicle import LinkedVehicle
from companion.link.map_wire import BUCKETS, Told, answer, read_ask
from companion.link.session import close_session, open_session
from companion.link.wire import Report, command_topic, encoded, map_topic
from companion.link.words import Answer, Command
from sitl.launch.processes import free_tcp_port
from tests.link.exchange import MAP, Mine
from tests.link.rig import RiggedVehicle, answer_to, known, rigged, telemetry, until
from tests.mapping.journal.journals import held

AFTER_IT_S = 0.1
"""The vehicle has answered by then."""

YES = encoded(Answer(accepted=True))


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    made = Authority.make(tmp_path / "authority")
    for name in ("drone1", "drone2"):
        made.issue(name, "vehicle", tmp_path / name)
    made.issue("anna", "command", tmp_path / "anna")
    return made


def endpoint() -> str:
    return f"tls/127.0.0.1:{free_tcp_port()}"


class Impostor:
    """Another vehicle of the fleet, which answers before the first one and after it, and says that it knows all.

    Args:
        folder: of its certificates.
        at: where it listens.
        topics: at which it answers.

    Attributes:
        asked: at which topics it was.
    """

    def __init__(self, folder: Path, at: str, topics: Sequence[str]) -> None:
        self.asked: list[str] = []
        self.session = open_session([at], [], Certificates(folder))
        self._answers = [self.session.declare_queryable(topic, self._on_query, complete=True) for topic in topics]

    def _on_query(self, query: zenoh.Query) -> None:
        with query:
            self.asked.append(str(query.key_expr))
            query.reply(query.key_expr, lie(query), express=True)
            time.sleep(AFTER_IT_S)
            query.reply(query.key_expr, lie(query), express=True)


def lie(query: zenoh.Query) -> bytes:
    """A command is done; the map is empty, and so is what is new of it."""
    if str(query.key_expr) == command_topic("drone1"):
        return YES
    assert query.payload is not None
    ask = read_ask(query.payload.to_bytes())
    told = Told(ask.epoch or "0", MAP, ask.until, ask.until, "0" * 16, 0)
    return answer(told, bytes(8 * BUCKETS) if ask.what == "sums" else b"")


@contextlib.contextmanager
def impostor(folder: Path, at: str, *topics: str) -> Iterator[Impostor]:
    one = Impostor(folder, at, topics)
    try:
        yield one
    finally:
        close_session(one.session)


def secured(mine: Mine, folder: Path) -> contextlib.AbstractContextManager[RiggedVehicle]:
    return rigged(mine, listen=[endpoint()], certificates=str(folder / "drone1"))


def test_nobody_answers_in_a_vehicles_place(
    tmp_path: Path, mine: Mine, authority: Authority, caplog: pytest.LogCaptureFixture
) -> None:
    """Protects who walks up to a vehicle that "has stopped", and who flies by a map that is none."""
    assert authority.issued()
    caplog.set_level(logging.WARNING, "companion.link.ground.station")
    other = endpoint()
    with (
        secured(mine, tmp_path) as vehicle,
        impostor(tmp_path / "drone2", other, command_topic("drone1"), map_topic("drone1")) as forger,
        LinkStation(tmp_path / "ground", connect=[vehicle.endpoint, other], certificates=tmp_path / "anna") as ground,
    ):
        seen = known(ground)
        until(lambda: map_topic("drone1") in forger.asked)
        assert answer_to(seen, Command.STOP) == Answer(accepted=True)
        assert vehicle.obeyed == [(Command.STOP, "anna")], "it is the vehicle that has answered"
        assert command_topic("drone1") in forger.asked
        for _ in range(3):
            mine.grow()
            until(lambda: seen.has_whole_map and held(seen.source()) == held(mine.journal))
        vehicle.obeys = False
        asked_s = time.monotonic()
        answer_of_none = answer_to(seen, Command.STOP)
        assert answer_of_none is None or not answer_of_none.accepted
        assert time.monotonic() - asked_s > 1.0, "the forger's answer is not waited for, the vehicle's is"
        assert "no sealed message" in seen.doubt
        assert ground.refused > 1
    told = [
        record.getMessage() for record in caplog.records if "an answer in the name of 'drone1'" in record.getMessage()
    ]
    assert len(told) == 1, "the first with its reason, and no more"
    assert "no sealed message" in told[0]


class Deaf:
    """Asks nobody, and keeps what was to be asked."""

    def __init__(self) -> None:
        self.questions: list[bytes] = []

    def ask(self, _topic: str, question: bytes, _timeout_s: float, _priority: zenoh.Priority) -> None:
        self.questions.append(question)


def test_no_two_questions_are_alike(tmp_path: Path) -> None:
    """Else what was answered to the first could be played back to the second."""
    asker = Deaf()
    vehicle = LinkedVehicle("drone1", tmp_path, asker, "a" * 16, Signer("anna", None))  # type: ignore[arg-type]
    try:
        for count in range(1, 5):
            vehicle.greet()
            until(lambda count=count: len(asker.questions) >= count)  # type: ignore[misc]
        vehicle.heard(Report("b" * 16, 1.0, "", 0, telemetry()))
        assert answer_to(vehicle, Command.STOP) is None
    finally:
        vehicle.close()
    assert len(asker.questions) > 10
    assert len(set(asker.questions)) == len(asker.questions)


def test_a_command_that_only_a_forger_answers_has_no_answer(tmp_path: Path, mine: Mine, authority: Authority) -> None:
    """The vehicle is gone: what is said in its name is no word of it, and the operator is told that none came."""
    assert authority.issued()
    other = endpoint()
    with (
        secured(mine, tmp_path) as vehicle,
        impostor(tmp_path / "drone2", other, command_topic("drone1")) as forger,
        LinkStation(tmp_path / "ground", connect=[vehicle.endpoint, other], certificates=tmp_path / "anna") as ground,
    ):
        seen = known(ground)
        until(lambda: seen.has_whole_map)
        vehicle.stop()
        try:
            assert answer_to(seen, Command.STOP) is None
            assert command_topic("drone1") in forger.asked
            assert held(seen.source()) == held(mine.journal)
        finally:
            vehicle.start()


def test_a_vehicle_that_is_revoked_is_believed_in_nothing_from_then_on(
    tmp_path: Path, mine: Mine, authority: Authority
) -> None:
    """Neither for its map nor for its answers, while the link stays as it is."""
    with (
        secured(mine, tmp_path) as vehicle,
        LinkStation(tmp_path / "ground", connect=[vehicle.endpoint], certificates=tmp_path / "anna") as ground,
    ):
        seen = known(ground)
        until(lambda: seen.has_whole_map)
        had = held(seen.source())
        authority.revoke("drone1")
        (tmp_path / "anna" / REVOKED).write_bytes((tmp_path / "authority" / REVOKED).read_bytes())
        mine.grow(3)
        assert answer_to(seen, Command.STOP) is None
        assert held(seen.source()) == had
        assert "the certificate of drone1 was revoked" in seen.doubt
        assert vehicle.obeyed == [(Command.STOP, "anna")], "the vehicle has heard of it, and is not believed"
