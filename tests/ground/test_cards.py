"""What stands on the page: every figure, and nothing of what came over the link as anything but text."""

from __future__ import annotations

import math
import re

from companion.ground.cards import Row, answers_card, fleet_card, vehicle_card
from tests.ground.fakes import FakeVehicle, telling


def words(html: str) -> str:
    return " ".join(re.sub(r"<[^>]*>", " ", html).split())


def test_every_figure_that_the_operator_needs_stands_on_the_card() -> None:
    """Protects the content: mode, rock against the margin, height, battery against the way home, map, link."""
    text = words(vehicle_card(FakeVehicle()))
    assert "exploring · R2 along a tangent" in text
    assert "rock 1.80 m keeps 1.00 m" in text
    assert "height 1.50 m wants 1.50 m" in text
    assert "battery 70 % 52 % at home" in text
    assert "way home 25 m 1:05 min" in text
    assert "map 40 % 2 places left" in text
    assert "link live map complete" in text


def test_what_is_not_known_is_a_dash_and_never_a_number() -> None:
    """Protects from zeros that nobody measured."""
    vehicle = FakeVehicle("a", telling(d_m=None, h_m=None, battery_percent=None, completeness=None, home_m=None))
    text = words(vehicle_card(vehicle))
    for name in ("rock", "height", "battery", "map", "way home"):
        assert f"{name} –" in text
    assert "nan" not in text.lower()


def test_what_is_old_looks_old() -> None:
    """Protects from reading a figure of a minute ago as one of now."""
    vehicle = FakeVehicle()
    vehicle.age_s = 61.0
    assert "gp-stale" in vehicle_card(vehicle)
    assert "61 s ago" in words(vehicle_card(vehicle))
    assert "gp-old" in fleet_card([Row(vehicle, "red", chosen=False)], 0)
    assert "gp-stale" not in vehicle_card(FakeVehicle())


def test_a_vehicle_that_was_never_heard_has_a_card_too() -> None:
    """Protects the first minute."""
    vehicle = FakeVehicle()
    vehicle.telemetry, vehicle.age_s = None, math.inf  # type: ignore[assignment]
    assert "Nothing heard of it yet" in words(vehicle_card(vehicle))
    assert "not heard – never" in words(fleet_card([Row(vehicle, "red", chosen=True)], 0))


def test_the_list_says_that_there_is_nobody() -> None:
    """Protects from an empty page that explains nothing."""
    assert "No vehicle has been heard yet" in words(fleet_card([], 0))


def test_names_and_reasons_are_text_whatever_they_hold() -> None:
    """Protects the operator's browser: a vehicle's name runs no script there."""
    evil = "<img src=x onerror=alert(1)>"
    vehicle = FakeVehicle(evil, telling(evil, mode=evil, phase=evil, warnings=(evil,), ended_because=evil))
    for html in (
        vehicle_card(vehicle),
        fleet_card([Row(vehicle, "red", chosen=True)], 0),
        answers_card([("no", evil)]),
    ):
        assert "<img" not in html
        assert "&lt;img" in html


def test_each_second_the_list_is_another_one() -> None:
    """Protects from a page that has died and looks alive: only a list that is replaced stays without its banner."""
    assert fleet_card([], 1) != fleet_card([], 2)
    assert "gp-dead" in fleet_card([], 1)
