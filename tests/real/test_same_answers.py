"""The stub and the real autopilots answer the same questions in the same way, so that they cannot drift apart."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.config.settings import Settings
from sitl.launch.processes import free_udp_ports
from sitl.launch.program import Ports, Running
from tests.real.answers import IN_FLIGHT, ON_THE_GROUND, STUB_DIFFERS, Expected, wrong
from tests.real.conftest import real_or_skip
from tests.real.interview import Answers, Interview, stations
from validation.fault_matrix.injection import PERSONALITIES
from validation.fault_matrix.stand import RealStand, Stand, StubStand

START_S = 60.0
BOTH = pytest.mark.parametrize("personality", PERSONALITIES)


def interviewed(stand: Stand, folder: Path, fly: bool) -> Answers:
    """Boot one, and ask it everything."""
    with stations(stand.wanted()) as (ground, companion, truth):
        (control,) = free_udp_ports(1)
        ports = Ports(companion.port, ground.port, truth.port)
        running = Running(stand.program(folder, Settings(), ports, control), folder)
        try:
            running.wait(START_S)
            return Interview(stand.personality, ground, companion, truth).hold(fly)
        finally:
            running.end()


def _stub_is_wrong(personality: str, expected: dict[str, Expected], answers: Answers) -> dict[str, str]:
    """What differs beyond what is known to, and what is said to differ and does not."""
    found = wrong(expected, answers)
    known = STUB_DIFFERS[personality] & expected.keys()
    stale = dict.fromkeys(known - found.keys(), "said to differ, and does not")
    return {question: how for question, how in found.items() if question not in known} | stale


def _lines(found: dict[str, str]) -> str:
    return "\n".join(f"{question}: {how}" for question, how in found.items())


@pytest.mark.slow
@pytest.mark.timeout(150)
@BOTH
def test_the_stub_answers_on_the_ground_as_the_real_one(personality: str, tmp_path: Path) -> None:
    """Protects everybody who trusts the stub before a flight: pre-flight and gate read these answers."""
    answers = interviewed(StubStand(personality), tmp_path, fly=False)

    found = _stub_is_wrong(personality, ON_THE_GROUND[personality], answers)
    assert not found, _lines(found)


@pytest.mark.long
@pytest.mark.timeout(240)
@BOTH
def test_the_stub_answers_in_flight_as_the_real_one(personality: str, tmp_path: Path) -> None:
    """Protects everybody who trusts a flight on the stub: it takes off and brakes as the real one does."""
    answers = interviewed(StubStand(personality), tmp_path, fly=True)

    found = _stub_is_wrong(personality, IN_FLIGHT[personality], answers)
    assert not found, _lines(found)


@pytest.mark.real
@pytest.mark.timeout(400)
@BOTH
def test_the_real_one_answers_as_it_is_written_down(personality: str, tmp_path: Path) -> None:
    """Protects the table itself: what a new version of PX4 or ArduCopter does otherwise shows here."""
    answers = interviewed(RealStand(real_or_skip(personality), gps=True), tmp_path, fly=True)

    found = wrong(ON_THE_GROUND[personality] | IN_FLIGHT[personality], answers)
    assert not found, _lines(found)


@pytest.mark.parametrize(
    ("expected", "answer", "same"),
    [
        (Expected(2.0, within=0.5), 2.4, True),
        (Expected(2.0, within=0.5), 2.6, False),
        (Expected(2.0, within=0.5), None, False),
        (Expected(2.0, within=0.5), float("nan"), False),
        (Expected(50.0, share=0.1), 45.5, True),
        (Expected({"a": 50.0, "b": 0.0}, share=0.1), {"a": 51.0, "b": 0.0, "c": 1.0}, True),
        (Expected({"a": 50.0, "b": 0.0}, share=0.1), {"a": 51.0}, False),
        (Expected(True), 1, True),
        (Expected([0, 0]), [0], False),
        (Expected(None), None, True),
    ],
)
def test_an_answer_is_the_same_within_its_tolerance(expected: Expected, answer: object, same: bool) -> None:
    """Protects the comparison: one that takes everything for the same finds nothing."""
    assert expected.met_by(answer) is same
    assert (wrong({"q": expected}, {"q": answer}) == {}) is same
    assert wrong({"q": expected}, {}) == {"q": f"expected {expected.answer}, got nothing"}
