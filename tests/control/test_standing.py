"""What is to stand stays where it came to stand; what flies is steered by the laws alone."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.control.governor import ROOM_M
from companion.control.navigator import Navigator
from companion.control.parameters import Parameters
from companion.control.standing import AWAY_MPS, Standing
from companion.model import HIT, Input, Mode, Pose, Scan, Setpoint
from companion.sides import NOTHING_AROUND, Side, Sides
from companion.station_keeping import GAIN_PER_S, MOST_MPS
from tests.control.scene import scan_of
from tests.control.stages import (
    ALWAYS,
    DT_S,
    IN_MODE,
    OPEN,
    ORIGIN,
    beside,
    mode_of,
    navigator_with,
)

CREPT_M = 0.08


def turning(navigator: Navigator, poses: list[Pose], begin_s: float = 0.0) -> list[Setpoint]:
    """The setpoints of R1 on its initial circle, which stands, a sampling period apart."""
    setpoints = [navigator.step(OPEN, pose, begin_s + DT_S * i) for i, pose in enumerate(poses)]
    assert mode_of(navigator) is Mode.CIRCLE
    return setpoints


@pytest.mark.parametrize("yaw_rad", [0.0, 0.5 * math.pi, -2.0])
def test_while_it_turns_on_the_spot_it_is_led_back_to_that_spot(yaw_rad: float) -> None:
    """Protects from drifting into a wall: the real PX4 crept half a metre in 9 s of turning at speed zero."""
    navigator = navigator_with()
    first, second = turning(navigator, [ORIGIN, replace(ORIGIN, x_m=CREPT_M, yaw_rad=yaw_rad)])
    assert (first.speed_mps, first.lateral_mps) == (0.0, 0.0)
    back_mps = GAIN_PER_S * CREPT_M
    expected = (-back_mps * math.cos(yaw_rad), back_mps * math.sin(yaw_rad))
    assert (second.speed_mps, second.lateral_mps) == pytest.approx(expected, abs=1e-12)
    # What it turns by, and its height, are the laws' as before.
    assert (second.yaw_rate_radps, second.climb_mps) == (first.yaw_rate_radps, first.climb_mps)


def test_however_far_it_was_carried_it_comes_back_slowly() -> None:
    """Protects from a setpoint beyond what the gate lets pass of a vehicle that stands."""
    setpoint = turning(navigator_with(), [ORIGIN, replace(ORIGIN, x_m=3.0, y_m=-4.0)])[-1]
    assert math.hypot(setpoint.speed_mps, setpoint.lateral_mps) == pytest.approx(MOST_MPS, abs=1e-12)


@pytest.mark.parametrize("mode", [Mode.TANGENT, Mode.BOUNDARY])
def test_what_flies_is_steered_by_the_laws_alone(mode: Mode) -> None:
    """Protects the paper's vehicle, which has a speed and a turn: to the left nothing is asked of it in flight."""
    navigator = IN_MODE[mode](tangent_probability=ALWAYS)
    for i in range(5):
        setpoint = navigator.step(beside(1), replace(ORIGIN, x_m=0.02 * i), 1.0 + DT_S * i)
        assert setpoint.speed_mps > 0.0
        assert setpoint.lateral_mps == 0.0


def test_what_has_flown_on_stands_at_its_next_stop() -> None:
    """Protects from being led back to where it stood before: metres backward, unseen."""
    standing = Standing(Parameters())
    for i, (speed_mps, x_m) in enumerate([(0.0, 0.0), (0.5, 0.5), (0.0, 1.0)]):
        asked = Setpoint(DT_S * i, speed_mps, 0.0, 0.0)
        stopped = standing.of(asked, seen(), NOTHING_AROUND, replace(ORIGIN, x_m=x_m))
    assert (stopped.speed_mps, stopped.lateral_mps) == (0.0, 0.0)


def test_nobody_is_led_back_by_inputs_that_are_missing() -> None:
    """Protects from moving on a guess: what is not seen is not flown to, and the place of before is forgotten."""
    navigator = navigator_with()
    turning(navigator, [ORIGIN])
    away = replace(ORIGIN, x_m=CREPT_M)
    blind = navigator.step(replace(OPEN, missing=(Input.DEPTH,)), away, DT_S)
    assert mode_of(navigator) is Mode.HOLD
    assert (blind.speed_mps, blind.lateral_mps) == (0.0, 0.0)
    (seeing,) = turning(navigator, [away], 2.0 * DT_S)
    assert (seeing.speed_mps, seeing.lateral_mps) == (0.0, 0.0)


@pytest.mark.parametrize("mode", [Mode.TANGENT, Mode.BOUNDARY])
@pytest.mark.parametrize(
    ("sides", "left_mps"),
    [
        (Sides(right=Side(ROOM_M + 0.7, 0.0)), 0.2),
        (Sides(left=Side(ROOM_M + 0.75, 0.1)), -0.2),
        (Sides(right=Side(ROOM_M + 0.85, 0.2)), 0.1),
        (Sides(right=Side(ROOM_M + 0.85, 0.1)), 0.0),
        (Sides(left=Side(0.4, 0.0)), -AWAY_MPS),
        (Sides(front=Side(0.4, 0.0), back=Side(0.6, 0.0)), 0.0),
    ],
)
def test_what_flies_is_moved_aside_from_a_wall_that_comes_too_near(mode: Mode, sides: Sides, left_mps: float) -> None:
    """Protects from being carried sideways into the wall that is followed: the real PX4 with GPS was, at 0.4 m/s."""
    navigator = IN_MODE[mode](tangent_probability=ALWAYS)
    for i in range(20):
        setpoint = navigator.step(replace(beside(1), sides=sides), replace(ORIGIN, x_m=0.02 * i), 1.0 + DT_S * i)
    assert setpoint.speed_mps > 0.0
    assert setpoint.lateral_mps == pytest.approx(left_mps)
    assert math.hypot(setpoint.speed_mps, setpoint.lateral_mps) <= navigator.parameters.speed_mps + 1e-9


# Walls that come nearer.


def seen(*walls: tuple[float, float], remembered: tuple[float, float] | None = None) -> Scan:
    """A scan that is free but for walls of a few degrees: (bearing, distance); one of them may be from memory."""
    scan = scan_of(lambda _: math.inf)
    for bearing_rad, range_m in (*walls, *([remembered] if remembered else [])):
        near = np.abs(np.angle(np.exp(1j * (scan.bearings_rad - bearing_rad)))) < 0.05
        scan.ranges_m[near], scan.state[near] = range_m, HIT
        scan.fresh[near] = (bearing_rad, range_m) != remembered
    return scan


def stood(scan: Scan, pose: Pose = ORIGIN) -> Setpoint:
    return Standing(Parameters()).of(Setpoint(0.0, 0.0, 0.0, 0.2), scan, NOTHING_AROUND, pose)


@pytest.mark.parametrize("bearing_rad", [0.0, 0.6, -1.2])
@pytest.mark.parametrize(
    ("range_m", "speed_mps"), [(ROOM_M + 0.81, 0.0), (ROOM_M + 0.775, 0.05), (ROOM_M + 0.7, 0.2), (0.5, 0.4)]
)
def test_it_backs_away_from_a_wall_that_has_come_too_near(bearing_rad: float, range_m: float, speed_mps: float) -> None:
    """Protects from odometry that drifts: by its own position the vehicle stands, and the wall comes nearer."""
    asked = stood(seen((bearing_rad, range_m)))
    along = asked.speed_mps * math.cos(bearing_rad) + asked.lateral_mps * math.sin(bearing_rad)
    assert along == pytest.approx(-speed_mps, abs=0.01)
    assert math.hypot(asked.speed_mps, asked.lateral_mps) == pytest.approx(speed_mps, abs=0.01)
    assert asked.yaw_rate_radps == 0.2, "and turns as it was asked to"


def test_it_does_not_back_into_another_wall() -> None:
    """Protects the side that it does not look at: between two walls it stands."""
    assert stood(seen((0.0, 0.5), (math.pi, 0.65))).speed_mps == 0.0
    assert stood(seen((0.0, 0.5), remembered=(3.0, 0.65))).speed_mps == 0.0, "a remembered one is one"
    assert stood(seen((0.0, 0.5), (2.0, 0.65))).speed_mps < 0.0, "one beside the way back is none behind"


def test_it_makes_room_behind_and_beside_too() -> None:
    """Protects from walls that no camera looks at while it turns on the spot, and from a drift towards them."""
    for sides, expected in (
        (Sides(back=Side(0.8, 0.0)), (0.1, 0.0)),
        (Sides(left=Side(0.9, 0.2)), (0.0, -0.1)),
        (Sides(left=Side(ROOM_M + 0.81, 0.0)), (0.0, 0.0)),
    ):
        asked = Standing(Parameters()).of(Setpoint(0.0, 0.0, 0.0, 0.2), seen(), sides, ORIGIN)
        assert (asked.speed_mps, asked.lateral_mps) == pytest.approx(expected), sides


def test_a_wall_that_is_only_remembered_drives_nobody() -> None:
    """Protects from a position that drifts: it carries the walls of memory along, and they come nearer in mind only."""
    assert stood(seen(remembered=(0.0, 0.4))).speed_mps == 0.0


def test_after_backing_away_it_stays_where_it_then_stands() -> None:
    """Protects from swinging: it is not led back to the place that was too near."""
    standing = Standing(Parameters())
    still = Setpoint(0.0, 0.0, 0.0, 0.0)
    standing.of(still, seen(), NOTHING_AROUND, ORIGIN)
    standing.of(replace(still, t_s=1.0), seen((0.0, 0.5)), NOTHING_AROUND, ORIGIN)
    after = standing.of(replace(still, t_s=2.0), seen((0.0, ROOM_M + 0.81)), NOTHING_AROUND, replace(ORIGIN, x_m=-0.2))
    assert (after.speed_mps, after.lateral_mps) == (0.0, 0.0)


@pytest.mark.parametrize("speed_mps", [0.1, 0.2, 0.3, 0.4])
def test_what_moves_aside_with_all_its_speed_flies_on_with_none(speed_mps: float) -> None:
    """Protects slow vehicles: the root of a rounding error below zero ended the application in flight."""
    parameters = Parameters()
    parameters.speed_mps = speed_mps
    standing = Standing(parameters)
    asked = Setpoint(0.0, speed_mps, 0.0, 0.0)
    for distance_m in np.linspace(0.3, 0.6, 301):
        flown = standing.of(asked, seen(), Sides(left=Side(float(distance_m), 0.0)), ORIGIN)
        assert flown.speed_mps == pytest.approx(0.0, abs=1e-7)
        assert flown.lateral_mps == pytest.approx(-speed_mps)
