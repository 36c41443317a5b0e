"""The tours that missions are compared with: which is whose, and ratios only where there is something to divide."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from companion.config.settings import Settings
from companion.config.vary import vary
from sitl.campaign import tours
from sitl.campaign.group_tables import group_tables
from sitl.campaign.groups import Group
from sitl.campaign.mission import Campaign, Mission, Row, failure
from sitl.campaign.tours import compared, representatives
from sitl.tour.inspection import Inspection
from tests.sitl.campaign.missions import mission


def of(number: int, world: str, seed: int, **control: object) -> Mission:
    values = {f"control.{name}": value for name, value in control.items()}
    text = vary(Settings(), values, str).model_dump_json()
    return replace(mission(number, world), seed=seed, settings_json=text)


def test_a_tour_is_of_a_world_and_a_speed_and_of_no_choice() -> None:
    """Protects hours of planning, and the comparison: at the same speed, in the same mine."""
    missions = (
        of(0, "room", 1, choice="coin"),
        of(1, "room", 2, choice="informed"),
        of(2, "room", 1, speed_mps=0.6),
        of(3, "random", 1),
        of(4, "random", 2),
        of(5, "random", 2, choice="coin"),
        of(6, "room", 1, max_yaw_rate_radps=0.5),
    )
    found = representatives(Campaign(missions, {}, ()))
    assert [found[number].number for number in range(7)] == [0, 0, 2, 3, 4, 4, 6]


def test_a_tour_is_flown_as_fast_as_the_vehicle_flies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the comparison from a tour that no choice could match: that of a vehicle which obeys better."""
    asked: list[float] = []

    def flown(_world: object, _settings: object, _seed: int, speed_mps: float) -> Inspection:
        asked.append(speed_mps)
        return Inspection(10.0, 5.0, 1.0, 1, 0.99, 1.0, ())

    monkeypatch.setattr(tours, "inspection", flown)
    row = tours.plan_tour(of(0, "room", 1, speed_mps=0.5))
    assert asked == [pytest.approx(0.5 * Settings().sim.dynamics.speed_gain)]
    assert row["tour_speed_mps"] == pytest.approx(asked[0])


def row(number: int, **figures: object) -> Row:
    return {"mission": number, "given_world": "room", "ended_because": "complete", **figures}


@pytest.fixture
def rows() -> list[Row]:
    campaign = Campaign((of(0, "room", 1), of(1, "room", 2), of(2, "random", 1)), {}, ())
    flown = [
        row(0, completed_at_s=150.0, path_length_m=60.0),
        row(1, completed_at_s=None, path_length_m=90.0),
        row(2, completed_at_s=50.0, path_length_m=20.0),
    ]
    tour: Row = {"mission": 0, "tour_time_s": 100.0, "tour_length_m": 50.0, "tour_share": 0.99}
    return compared(campaign, flown, {0: tour, 2: {"mission": 2, **failure("no room")}})


def test_ratios_are_of_complete_maps_and_of_worlds_with_a_tour(rows: list[Row]) -> None:
    assert [(one["time_ratio"], one["way_ratio"]) for one in rows] == [(1.5, 1.2), (None, None), (None, None)]
    assert [one["tour_time_s"] for one in rows] == [100.0, 100.0, None]


def test_a_mission_that_did_not_arrive_is_worse_than_any_ratio(rows: list[Row]) -> None:
    """Protects medians from hiding what never arrived; a world without a tour counts in none."""
    group = Group("room", rows)
    assert group.of_complete("time_ratio", "tour_time_s") == [1.5, math.inf]
    page = group_tables([group], toured=True)
    assert "<td>2 of 3</td><td>1.50</td><td>not reached</td><td>not reached; 1.50 where complete</td>" in page
