"""Whether the vehicle does what is asked of it: told when it does not, and never of one that does."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.gate.obedience import FOR_S, FRESH_S, MOVE_AFTER_S, STAND_AFTER_S, STAND_MPS, Obedience
from companion.station_keeping import MOST_MPS

LIMIT_MPS = 0.2
PERIOD_S = 1 / 16
AT_S = 64.0


def flown(
    asked: tuple[float, float], flies: tuple[float, float], seconds: float, obedience: Obedience | None = None
) -> tuple[Obedience, list[float]]:
    """Asks and flies for so long from `AT_S` on; after how long it was said not to obey."""
    watched = obedience or Obedience(LIMIT_MPS)
    wrong = []
    for tick in range(round(seconds / PERIOD_S) + 1):
        now_s = AT_S + tick * PERIOD_S
        watched.on_setpoint(*asked, now_s)
        watched.on_velocity(*flies, now_s)
        if watched.wrong(now_s) is not None:
            wrong.append(now_s - AT_S)
    return watched, wrong


@pytest.mark.parametrize("flies", [(0.25, 0.0), (0.0, -0.25), (-0.15, 0.15), (2.0, 0.0)])
def test_who_is_asked_to_stand_and_flies_does_not_obey(flies: tuple[float, float]) -> None:
    """Protects from a vehicle that runs away on zero, whichever way: PX4 did with a velocity estimate gone wrong."""
    watched, wrong = flown((0.0, 0.0), flies, 4.0)
    assert wrong[0] == STAND_AFTER_S
    assert watched.wrong(AT_S + 4.0) == f"asked to stand, flies {math.hypot(*flies):.2f} m/s"


@pytest.mark.parametrize("flies", [(0.0, 0.0), (0.05, 0.3), (-0.5, 0.0), (0.09, 0.0)])
def test_who_is_asked_to_move_and_stands_does_not_obey(flies: tuple[float, float]) -> None:
    """Protects from ArduCopter's guided mode that somebody has paused: it ignores every setpoint, without a text."""
    watched, wrong = flown((0.4, 0.0), flies, 3.0)
    assert wrong[0] == MOVE_AFTER_S
    assert watched.wrong(AT_S + 3.0) == f"asked 0.40 m/s, flies {flies[0]:.2f}"


@pytest.mark.parametrize(
    ("asked", "flies"),
    [
        ((0.0, 0.0), (LIMIT_MPS, 0.0)),
        ((MOST_MPS, 0.0), (-0.1, 0.1)),
        ((0.4, 0.0), (0.1, 0.0)),
        ((0.0, -0.4), (0.0, -0.4)),
        ((0.15, 0.0), (0.0, 0.0)),
        ((0.15, 0.0), (0.5, 0.0)),
    ],
)
def test_who_obeys_is_not_accused(asked: tuple[float, float], flies: tuple[float, float]) -> None:
    """Protects a good flight: what is slow, noisy, or asked for too little to tell, is no fault."""
    assert flown(asked, flies, 8.0)[1] == []


@given(
    speed=st.floats(0.0, 0.55),
    way_rad=st.floats(-math.pi, math.pi),
    tau_s=st.floats(0.1, 0.61),
    noise=st.lists(st.floats(-0.05, 0.05), min_size=32, max_size=32),
    changes_s=st.floats(0.5, 4.0),
)
def test_who_follows_as_the_autopilots_do_is_never_accused(
    speed: float, way_rad: float, tau_s: float, noise: list[float], changes_s: float
) -> None:
    """Protects every flight: both follow a velocity within 0.61 s; they set out, stop, and turn round as they like."""
    watched, north, east = Obedience(LIMIT_MPS), 0.0, 0.0
    for tick in range(160):
        now_s = AT_S + tick * PERIOD_S
        leg = int(tick * PERIOD_S / changes_s) % 4
        factor = (1.0, 0.0, -1.0, 1.0)[leg]
        asked = factor * speed * math.cos(way_rad), factor * speed * math.sin(way_rad)
        share = 1.0 - math.exp(-PERIOD_S / tau_s)
        north, east = north + share * (asked[0] - north), east + share * (asked[1] - east)
        watched.on_setpoint(*asked, now_s)
        watched.on_velocity(north + noise[tick % 32], east + noise[(tick + 7) % 32], now_s)
        assert watched.wrong(now_s) is None


@given(st.floats(0.25, 0.55), st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_who_ignores_what_is_asked_is_always_found(speed: float, asked_rad: float, flown_rad: float) -> None:
    """Protects from a runaway in any direction: asked to stand it is found, whichever way it flies."""
    flies = speed * math.cos(flown_rad), speed * math.sin(flown_rad)
    assert flown((0.0, 0.0), flies, STAND_AFTER_S + PERIOD_S)[1]
    asked = speed * math.cos(asked_rad), speed * math.sin(asked_rad)
    assert flown(asked, (0.0, 0.0), MOVE_AFTER_S + PERIOD_S)[1]


def test_it_must_go_on_for_a_while() -> None:
    """Protects from one noisy velocity: it counts after half a second without a good one."""
    watched, _ = flown((0.0, 0.0), (0.1, 0.0), 4.0)
    begun_s = AT_S + 4.0
    found = {}
    for tick in range(1, 12):
        now_s = begun_s + tick * PERIOD_S
        watched.on_setpoint(0.0, 0.0, now_s)
        watched.on_velocity(0.5, 0.0, now_s)
        found[tick * PERIOD_S] = watched.wrong(now_s) is not None
    assert next(after_s for after_s, wrong in found.items() if wrong) == PERIOD_S + FOR_S
    watched.on_velocity(0.1, 0.0, begun_s + 0.75)
    assert watched.wrong(begun_s + 0.75) is None, "and a good one ends it"


@pytest.mark.parametrize(
    "asked",
    [
        pytest.param((-0.4, 0.0), id="back"),
        pytest.param((0.0, 0.4), id="square"),
    ],
)
def test_who_is_asked_to_turn_has_time_to(asked: tuple[float, float]) -> None:
    """Protects a law that turns round without standing in between: the first second still flies the old way."""
    watched, _ = flown((0.4, 0.0), (0.4, 0.0), 4.0)
    for tick in range(round(MOVE_AFTER_S / PERIOD_S)):
        now_s = AT_S + 4.0 + (tick + 1) * PERIOD_S
        watched.on_setpoint(*asked, now_s)
        watched.on_velocity(0.4, 0.0, now_s)
        assert watched.wrong(now_s) is None
    assert flown(asked, (0.4, 0.0), MOVE_AFTER_S)[1], "but not for ever"


def test_a_slow_turn_is_not_followed_by_time_anew() -> None:
    """Protects the check from a law that bends its way a little with each setpoint: that is no new beginning."""
    watched = Obedience(LIMIT_MPS)
    wrong = False
    for tick in range(round(4.0 / PERIOD_S)):
        now_s, way_rad = AT_S + tick * PERIOD_S, 0.02 * tick
        watched.on_setpoint(0.4 * math.cos(way_rad), 0.4 * math.sin(way_rad), now_s)
        watched.on_velocity(0.0, 0.0, now_s)
        wrong = wrong or watched.wrong(now_s) is not None
    assert wrong


def test_setpoints_that_stopped_ask_for_nothing() -> None:
    """Protects an autopilot that flies by itself in another mode: nobody asks it to stand; a new beginning is one."""
    watched, _ = flown((0.0, 0.0), (0.5, 0.0), 4.0)
    end_s = AT_S + 4.0
    watched.on_velocity(0.5, 0.0, end_s + FRESH_S)
    assert watched.wrong(end_s + FRESH_S) is not None
    watched.on_velocity(0.5, 0.0, end_s + FRESH_S + 2.0**-10)
    assert watched.wrong(end_s + FRESH_S + 2.0**-10) is None
    watched.on_setpoint(0.0, 0.0, end_s + 1.0)
    watched.on_velocity(0.5, 0.0, end_s + 1.0)
    watched.on_velocity(0.5, 0.0, end_s + 1.25)
    assert watched.wrong(end_s + 1.25) is None


def test_velocities_that_stopped_say_nothing() -> None:
    """Protects from a verdict by a velocity of long ago: it may have come to stand since, and nobody has told."""
    watched = Obedience(LIMIT_MPS)
    watched.on_setpoint(0.0, 0.0, AT_S)
    watched.on_velocity(0.5, 0.0, AT_S)
    for tick in range(80):
        watched.on_setpoint(0.0, 0.0, AT_S + tick * PERIOD_S)
        assert watched.wrong(AT_S + tick * PERIOD_S) is None
    watched.on_velocity(0.5, 0.0, AT_S + 5.0)
    assert watched.wrong(AT_S + 5.0) is None, "what was wrong before the gap does not count on"


def test_a_new_flight_begins_with_nothing() -> None:
    """Protects it from what the last one did."""
    watched, _ = flown((0.0, 0.0), (0.5, 0.0), 4.0)
    watched.reset()
    assert watched.wrong(AT_S + 4.0) is None
    watched.on_velocity(0.5, 0.0, AT_S + 4.0)
    assert watched.wrong(AT_S + 5.0) is None


def test_what_keeps_a_place_asks_for_less_than_movement() -> None:
    """Protects the two apart: a vehicle that is led back to its place is one that is asked to stand."""
    assert MOST_MPS < STAND_MPS
