"""What the operator is told of a vehicle: what matters, in words that say what to do."""

from __future__ import annotations

import math

from companion.ground.concerns import LOST_S, STALE_S, Weight, concerns, duration
from tests.ground.fakes import FakeVehicle, telling


def texts(vehicle: FakeVehicle) -> list[str]:
    return [concern.text for concern in concerns(vehicle)]


def test_nothing_is_said_while_all_is_well() -> None:
    """Protects attention: who is told of nothing all day reads nothing any more."""
    assert texts(FakeVehicle()) == []


def test_a_vehicle_that_has_not_been_heard_is_no_vehicle_that_is_well() -> None:
    """Protects from silence that looks like peace."""
    vehicle = FakeVehicle()
    vehicle.telemetry, vehicle.age_s = None, math.inf  # type: ignore[assignment]
    [concern] = concerns(vehicle)
    assert concern.weight is Weight.LOOK
    assert "Nothing heard of it yet" in concern.text


def test_old_words_are_said_to_be_old() -> None:
    """Protects from taking what was for what is; after the end of a flight nobody waits for more."""
    vehicle = FakeVehicle()
    vehicle.age_s = STALE_S + 1.0
    [stale] = concerns(vehicle)
    assert stale.weight is Weight.LOOK
    vehicle.age_s = LOST_S + 290.0
    [lost] = concerns(vehicle)
    assert lost.weight is Weight.ACT
    assert lost.text.startswith("No word for 5 min. It goes on by itself")
    vehicle.telemetry = telling(phase="ended")
    assert texts(vehicle) == []


def test_the_battery_is_judged_by_the_way_home() -> None:
    """Protects the way home: half a battery is little where the way takes more."""
    enough = FakeVehicle("a", telling(battery_percent=30.0, left_at_home_percent=26.0))
    little = FakeVehicle("b", telling(battery_percent=60.0, left_at_home_percent=12.0))
    too_little = FakeVehicle("c", telling(battery_percent=60.0, left_at_home_percent=-3.0))
    assert texts(enough) == []
    assert texts(little) == [
        "At home 12 % of the battery would be left, less than the 25 % that shall be. Send it home now."
    ]
    assert "does not last for the way home" in texts(too_little)[0]
    assert texts(FakeVehicle("d", telling(phase="homing", left_at_home_percent=12.0))) == []


def test_what_the_vehicle_says_is_wrong_comes_before_what_the_ground_thinks() -> None:
    """Protects the order: what asks for an act stands first."""
    vehicle = FakeVehicle("a", telling(warnings=("Camera silent: it stands. Land it.",), d_m=0.4))
    vehicle.map_age_s = 40.0
    found = concerns(vehicle)
    assert found[0].text == "Camera silent: it stands. Land it."
    assert [concern.weight for concern in found] == [Weight.ACT, Weight.LOOK, Weight.LOOK]
    assert "Rock is 0.40 m away" in found[1].text
    assert "lacks the last 40 s" in found[2].text


def test_times_are_said_as_people_say_them() -> None:
    """Protects reading at a glance."""
    assert [duration(span) for span in (0.4, 119.0, 121.0, 7300.0, math.inf)] == [
        "0 s",
        "119 s",
        "2 min",
        "2 h",
        "ever",
    ]


def test_who_claims_to_be_a_vehicle_is_told_of() -> None:
    """Protects from a stranger whose words are refused in silence: he may have worse in mind."""
    vehicle = FakeVehicle()
    vehicle.doubt = "bob may watch, and is no vehicle"
    [concern] = concerns(vehicle)
    assert concern.weight is Weight.ACT
    assert concern.text.startswith(
        "Somebody claims to be Kobold and is not believed: bob may watch, and is no vehicle."
    )
