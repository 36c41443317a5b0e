"""The application on the real PX4 and the real ArduCopter: it explores, lands, and stops when it dies."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.real.conftest import real_or_skip
from validation.fault_matrix.injection import PERSONALITIES
from validation.fault_matrix.run import fly_on
from validation.fault_matrix.stand import RealStand
from validation.real.faults import SIMULATED
from validation.real.flight import Task, Ways, fly
from validation.real.flights import problems
from validation.real.real_faults import BY_NAME

ROOM_S = 300.0
BOTH = pytest.mark.parametrize("personality", PERSONALITIES)


@pytest.mark.real
@pytest.mark.timeout(700)
@BOTH
def test_it_explores_a_room_without_gps_and_lands_where_it_was(personality: str, tmp_path: Path) -> None:
    """Protects the whole on what a user flies: complete, no contact, landed in place, the same again in replay."""
    flown = fly(real_or_skip(personality), Task(personality, False, "room", 1, ROOM_S), tmp_path, Ways())

    assert problems(flown) == [], flown


@pytest.mark.real
@pytest.mark.timeout(400)
@pytest.mark.parametrize("name", ["SIGKILL application", "SIGKILL gate", "SIGKILL world"])
@BOTH
def test_it_stands_when_a_part_of_it_dies(personality: str, name: str, tmp_path: Path) -> None:
    """Protects the promise of the gate, and of the autopilot's own failsafe as pre-flight has configured it."""
    stand = RealStand(real_or_skip(personality), parameters=SIMULATED[personality])
    outcome = fly_on(stand, BY_NAME[name], tmp_path)

    assert outcome.problem is None, outcome
    assert outcome.contacts == 0
    assert outcome.standing_s is not None, outcome
