"""That what `companion config check` says of narrow and low places is what is flown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from companion.config.load import load_settings
from companion.config.settings import Settings
from companion.control.governor import TIGHT_SHARE
from companion.flight.preflight.checks import braking
from companion.mavlink.firmware import AutopilotKind
from companion.model import Pose
from companion.safety_case.gate_plan import refuse_if_reachable
from companion.safety_case.passages import passages
from sitl.mines.model import World
from sitl.mines.plan import Drift, extruded, grid_lines, inside_m, square_drift
from sitl.scene.raycast import RayCaster
from sitl.scene.visibility import horizontal_clearance
from sitl.sim.flight import Flight

ROOM_M, DRIFT_M, ROOF_M = 6.0, 8.0, 3.0
OVERSHOOT_M = 0.02
"""The governor brakes before d_c, and a vehicle overshoots by a centimetre or two, turning too."""

FLYING = Path(__file__).parents[3] / "docs" / "flying.md"


class Flown(NamedTuple):
    """How a flight ended, and how near it came to a wall."""

    through: bool
    touched: bool
    least_d_m: float


def examples() -> list[Settings]:
    """The examples of docs/flying.md for narrow places: with either autopilot, with ArduPilot only."""
    text = FLYING.read_text("utf-8").partition("## Narrow and low places")[2].partition("\n## ")[0]
    return [Settings.model_validate(yaml.safe_load(block.partition("```")[0])) for block in text.split("```yaml\n")[1:]]


FLIGHT, SWIFT = load_settings(None, "flight"), load_settings(None, "swift")
SLIM, SLIM_ARDUPILOT = examples()
ALL = pytest.mark.parametrize("settings", [FLIGHT, SLIM, SLIM_ARDUPILOT], ids=["flight", "slim", "slim-ardupilot"])
MORE_WHEN_LONG = pytest.mark.parametrize(
    "settings",
    [
        pytest.param(FLIGHT, id="flight"),
        pytest.param(SLIM, id="slim", marks=pytest.mark.long),
        pytest.param(SLIM_ARDUPILOT, id="slim-ardupilot", marks=pytest.mark.long),
    ],
)


def raised(drifts: Sequence[Drift], bends_m: Sequence[float], roof_m: Sequence[float]) -> World:
    """A mine over that plan; the roof is as high as that at the bends, and goes straight from one to the next."""

    def lines(axis: int, also_m: Sequence[float]) -> NDArray[np.float64]:
        sides = [(end[axis], drift.half_width_a_m) for drift in drifts for end in (drift.a_m, drift.b_m)]
        return grid_lines([at + side for at, half in sides for side in (-half, half)], also_m, 0.5)

    shell = extruded(
        lines(0, bends_m),
        lines(1, []),
        lambda x, y: inside_m(drifts, x, y),
        lambda x, _: np.zeros_like(x),
        lambda x, _: np.asarray(np.interp(x, bends_m, roof_m)),
    )
    return World("a drift", shell.vertices_m, shell.triangles, None, np.zeros((0, 3)), "made for a test")


def narrow(width_m: float) -> World:
    """Two rooms, and a drift of that width from one to the other along x."""
    half_m = width_m / 2.0
    rooms = [square_drift(x, 0.0, x + 0.01, 0.0, width_m=ROOM_M) for x in (0.0, ROOM_M + DRIFT_M)]
    begin_m = ROOM_M / 2.0 - 0.5
    drift = square_drift(begin_m + half_m, 0.0, begin_m + DRIFT_M + 1.0 - half_m, 0.0, width_m=width_m)
    return raised([*rooms, drift], [-3.0, 18.0], [ROOF_M, ROOF_M])


def bent(width_m: float) -> World:
    """A room, a drift of that width with a right-angled bend, 6 m to it and 6 m from it, and a chamber at its end."""
    half_m = width_m / 2.0
    room, chamber = (square_drift(x, y, x + 0.01, y, width_m=width) for x, y, width in ((0, 0, 6.0), (9.0, 7.5, 4.0)))
    to_bend = square_drift(2.5 + half_m, 0.0, 9.0, 0.0, width_m=width_m)
    from_bend = square_drift(9.0, 0.0, 9.0, 6.0 - half_m, width_m=width_m)
    return raised([room, chamber, to_bend, from_bend], [-3.0, 12.0], [ROOF_M, ROOF_M])


def low(height_m: float, before_m: float = ROOF_M) -> World:
    """A drift 3.2 m wide along x; from x = 7 m on its roof is so low."""
    return raised(
        [square_drift(0.0, 0.0, 26.0, 0.0, width_m=3.2)], [-1.6, 6.8, 7.0, 27.6], [before_m] * 2 + [height_m] * 2
    )


def flown(
    world: World, settings: Settings, seed: int, start: Pose, between_m: tuple[float, float], most_s: float
) -> Flown:
    """Fly from a start until the vehicle is outside of a stretch along x, for so long at most."""
    caster = RayCaster(world)
    flight = Flight(1, world, caster, settings, start, np.random.SeedSequence(seed))
    while flight.vehicle.pose.t_s < most_s and not flight.touched:
        flight.tick(settings.control.period_s, fleet=False)
        if not between_m[0] < flight.vehicle.pose.x_m < between_m[1]:
            break
    d_m = horizontal_clearance(caster, flight.log.positions_m[::2], settings.vehicle.body_height_m / 2.0)
    through = flight.vehicle.pose.t_s < most_s and not flight.touched
    return Flown(through, flight.touched, float(d_m.min()))


def from_room(width_m: float, settings: Settings, seed: int, most_s: float) -> Flown:
    """From anywhere in a room, heading anywhere, through the drift."""
    x_m, y_m, yaw_rad = np.random.default_rng(seed).uniform([-1.0, -1.0, -math.pi], [1.0, 1.0, math.pi])
    start = Pose(0.0, x_m, y_m, settings.control.height_m, yaw_rad)
    return flown(narrow(width_m), settings, seed, start, (-ROOM_M, ROOM_M / 2.0 + DRIFT_M + 1.0), most_s)


def from_drift(width_m: float, settings: Settings, seed: int, most_s: float) -> Flown:
    """From within the drift out of either end of it."""
    start = Pose(0.0, ROOM_M / 2.0 + 2.0, 0.0, settings.control.height_m, 0.0)
    return flown(narrow(width_m), settings, seed, start, (1.5, ROOM_M / 2.0 + DRIFT_M + 1.0), most_s)


def under_edge(height_m: float, settings: Settings, seed: int, most_s: float) -> Flown:
    """Along a drift to where its roof is suddenly low, and on for 8 m."""
    start = Pose(0.0, 2.0, 0.0, settings.control.height_m, 0.0)
    return flown(low(height_m), settings, seed, start, (-9.0, 15.0), most_s)


def under_low_roof(height_m: float, settings: Settings, seed: int, most_s: float) -> Flown:
    """From under a low roof 10 m on under it."""
    start = Pose(0.0, 2.0, 0.0, min(settings.control.height_m, height_m / 2.0), 0.0)
    return flown(low(height_m, height_m), settings, seed, start, (-9.0, 12.0), most_s)


@pytest.mark.parametrize(
    ("settings", "seed"),
    [
        (SWIFT, 6),
        *(pytest.param(SWIFT, seed, marks=pytest.mark.long) for seed in range(1, 6)),
        *(pytest.param(FLIGHT, seed, marks=pytest.mark.long) for seed in range(1, 7)),
    ],
)
def test_into_a_drift_as_wide_as_it_says_it_flies_and_keeps_d_c(settings: Settings, seed: int) -> None:
    """Protects the mouth: told to keep to the middle when too near to a post to fly, it was carried on into it."""
    flight = from_room(passages(settings).enters_width_m, settings, seed, 400.0)
    assert flight.through
    assert flight.least_d_m >= settings.control.critical_margin_m - OVERSHOOT_M


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("seed", range(1, 7))
@pytest.mark.parametrize("settings", [SLIM, SLIM_ARDUPILOT], ids=["slim", "slim-ardupilot"])
def test_with_the_examples_it_flies_into_a_drift_as_wide_as_it_says(settings: Settings, seed: int) -> None:
    flight = from_room(passages(settings).enters_width_m, settings, seed, 500.0)
    assert flight.through
    assert flight.least_d_m >= TIGHT_SHARE * settings.control.critical_margin_m > settings.vehicle.body_radius_m


@ALL
def test_in_a_drift_of_the_least_width_it_goes_on_and_in_a_narrower_one_it_does_not(settings: Settings) -> None:
    least_m = passages(settings).least_width_m
    flight = from_drift(least_m, settings, 1, 200.0)
    assert flight.through
    assert not flight.touched
    assert not from_drift(least_m - 0.25, settings, 1, 40.0).through


@MORE_WHEN_LONG
def test_under_a_roof_as_high_as_it_says_it_flies_and_under_a_lower_edge_it_does_not(settings: Settings) -> None:
    enters_m = passages(settings).enters_height_m
    assert under_edge(enters_m, settings, 1, 200.0).through
    assert not under_edge(enters_m - 0.25, settings, 1, 40.0).through


@MORE_WHEN_LONG
def test_under_the_lowest_roof_it_goes_on_without_a_contact(settings: Settings) -> None:
    assert under_low_roof(passages(settings).least_height_m, settings, 1, 200.0).through


@pytest.mark.parametrize("seed", [3, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2, 4, 5, 6))])
def test_with_a_body_of_a_quarter_metre_it_reaches_the_chamber_behind_a_bent_drift_1_2_m_wide(seed: int) -> None:
    """Protects the narrow: R3 took the far post of the mouth for a wall ahead, and turned round in the bend."""
    world, settings = bent(1.2), SLIM_ARDUPILOT
    x_m, y_m, yaw_rad = np.random.default_rng(seed).uniform([-1.0, -1.0, -math.pi], [1.0, 1.0, math.pi])
    caster, start = RayCaster(world), Pose(0.0, x_m, y_m, settings.control.height_m, yaw_rad)
    flight = Flight(1, world, caster, settings, start, np.random.SeedSequence(seed))
    while flight.vehicle.pose.y_m < 6.3 and flight.vehicle.pose.t_s < 700.0 and not flight.touched:
        flight.tick(settings.control.period_s, fleet=False)
    assert not flight.touched
    assert flight.vehicle.pose.y_m >= 6.3
    d_m = horizontal_clearance(caster, flight.log.positions_m[::2], settings.vehicle.body_height_m / 2.0)
    assert d_m.min() >= TIGHT_SHARE * settings.control.critical_margin_m > settings.vehicle.body_radius_m


@pytest.mark.parametrize("settings", [SLIM, SLIM_ARDUPILOT], ids=["slim", "slim-ardupilot"])
def test_the_examples_for_narrow_places_cannot_reach_a_wall(settings: Settings) -> None:
    refuse_if_reachable(settings)
    assert settings.vehicle.body_radius_m == 0.25


def test_the_examples_for_narrow_places_are_those_that_their_autopilots_may_fly() -> None:
    """Protects PX4, which wanders further in its hold: with ArduPilot's example pre-flight refuses it."""
    assert all(braking(kind, SLIM).ok for kind in AutopilotKind)
    assert braking(AutopilotKind.ARDUPILOT, SLIM_ARDUPILOT).ok
    assert not braking(AutopilotKind.PX4, SLIM_ARDUPILOT).ok
    assert passages(SLIM_ARDUPILOT).enters_width_m == 1.2


@pytest.mark.long
@pytest.mark.timeout(1200)
@ALL
def test_the_widths_found_by_bisection_are_those_that_it_says(settings: Settings) -> None:
    """The narrowest that every seed flies lies below what is claimed, and not by more than 0.3 m."""
    said = passages(settings)
    for fly, said_m, most_s in ((from_drift, said.least_width_m, 200.0), (from_room, said.enters_width_m, 400.0)):
        none_m, all_m = said_m - 0.4, said_m
        while all_m - none_m > 0.06:
            middle_m = (none_m + all_m) / 2.0
            if all(fly(middle_m, settings, seed, most_s).through for seed in (1, 2, 3)):
                all_m = middle_m
            else:
                none_m = middle_m
        assert all(fly(said_m, settings, seed, most_s).through for seed in (1, 2, 3, 4, 5))
        assert said_m - all_m <= 0.3
