"""How long a way takes, by the speed that was really flown."""

from __future__ import annotations

import pytest

from companion.control.homing.pace import FIRST_SHARE, SETTLE_S, Pace
from companion.control.informed import Route
from companion.model import Pose
from tests.control.scene import law_parameters

LAW = law_parameters(speed_mps=1.0)


def flown(pace: Pace, speed_mps: float, seconds: float, straight: bool = True, start_s: float = 0.0) -> None:
    for k in range(round(10.0 * seconds)):
        t_s = start_s + 0.1 * k
        pace.note(Pose(t_s, speed_mps * t_s, 0.0, 1.5, 0.0, vx_mps=speed_mps), straight)


def test_before_anything_is_known_a_share_of_what_is_asked_for() -> None:
    """Neither nothing nor all of it: a vehicle flies slower than it is told to."""
    assert Pace(LAW).speed_mps == pytest.approx(FIRST_SHARE)


def test_what_is_flown_on_straights_counts_and_nothing_else() -> None:
    """Protects the promise from the slow following of walls, which the way home has none of."""
    pace = Pace(LAW)
    flown(pace, 0.8, 30.0)
    flown(pace, 0.1, 300.0, straight=False, start_s=100.0)
    assert pace.speed_mps == pytest.approx(0.8, rel=0.01)


def test_a_way_takes_its_length_its_turns_and_coming_to_stand() -> None:
    """Turns on the spot cost time without any way."""
    pace = Pace(LAW)
    flown(pace, 0.5, 30.0)
    straight, turned = pace.takes_s(Route(40.0, 0.0)), pace.takes_s(Route(40.0, 6.0))
    assert straight == pytest.approx(80.0 + SETTLE_S, rel=0.02)
    assert turned - straight == pytest.approx(6.0 / (0.6 * LAW.max_yaw_rate_radps), rel=0.01)


def test_a_gap_in_time_is_no_speed() -> None:
    """A vehicle that was held for minutes did not fly slowly meanwhile."""
    pace = Pace(LAW)
    flown(pace, 0.8, 20.0)
    flown(pace, 0.8, 20.0, start_s=500.0)
    assert pace.speed_mps == pytest.approx(0.8, rel=0.01)
