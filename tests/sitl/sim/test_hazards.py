"""Flights past what mines hold: nothing is touched, nothing descended into, and what cannot be seen is not flown into.

The short ones begin right before the hazard; docs/mines.md has the table of whole missions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from companion.config.load import load_settings
from companion.config.vary import vary
from companion.model import Input, Pose
from sitl.campaign.flight import figures
from sitl.mines import World, load_world
from sitl.mines.conditions import Conditions, Trigger
from sitl.mines.hazards import HAZARDS
from sitl.scene.raycast import RayCaster
from sitl.sim.flight import Flight
from sitl.sim.simulation import Simulation
from validation.hazards.table import table

CAMERA = {"sensors.camera.width_px": 80, "sensors.camera.height_px": 60}
FLIGHT = vary(load_settings(None, "flight"), CAMERA, lambda setting: setting)
"""With a camera of a quarter of the pixels, which sees less and costs less."""

BEFORE = Pose(0.0, 7.5, 0.0, 1.5, 0.0)
"""1.5 to 3.5 m before what is looked at, in the middle of the drift and heading for it."""

TOWARDS = {
    "dark-wall": replace(BEFORE, y_m=0.4, yaw_rad=0.5),
    "shiny-wall": replace(BEFORE, y_m=0.4, yaw_rad=0.5),
    "pillar": replace(BEFORE, x_m=2.5),
    "mirrored-edges": replace(BEFORE, x_m=11.0),
    "person": replace(BEFORE, x_m=6.4),
    "machine": replace(BEFORE, x_m=13.0, yaw_rad=np.pi),
    "door": replace(BEFORE, x_m=12.5, yaw_rad=np.pi),
    "door-on-loop": replace(BEFORE, x_m=12.5, yaw_rad=np.pi),
    "open-end": replace(BEFORE, x_m=20.0),
    "wind": replace(BEFORE, x_m=20.0, y_m=4.5, yaw_rad=-np.pi / 2.0),
}
"""Where that is elsewhere; what closes behind is flown back to."""

SHORT_S, SHORT_M = 20.0, 2.5


def flown(name: str, way_m: float = SHORT_M, world: World | None = None) -> Flight:
    """Fly for `SHORT_S` or so far, whichever ends first, in the hazard's world or in that one."""
    world = load_world(f"hazard:{name}", 1) if world is None else world
    start = TOWARDS.get(name, BEFORE)
    flight = Flight(1, world, RayCaster(world), FLIGHT, start, np.random.SeedSequence(1))
    while flight.vehicle.pose.t_s < SHORT_S and flight.vehicle.path_m < way_m and not flight.touched:
        flight.tick(FLIGHT.control.period_s, fleet=False)
    return flight


@pytest.mark.parametrize("name", [name for name in HAZARDS if name not in ("shaft", "no-light", "water")])
def test_it_is_flown_up_to_and_not_touched(name: str) -> None:
    """Protects the body: a look round, and up to 2.5 m of the way."""
    flight = flown(name)
    assert not flight.touched
    assert flight.vehicle.path_m > 1.0
    assert flight.blind_s < 1.0


def test_a_shaft_is_not_descended_into() -> None:
    """Protects from the height law over an edge: 16 m of height would be flown off downward."""
    flight = flown("shaft")
    assert not flight.touched
    assert flight.log.column("z_m").min() > 1.2
    assert flight.vehicle.path_m > 1.0


def test_water_below_changes_the_height_by_no_more_than_a_hand() -> None:
    """Protects from a beam that says 4.5 m where 1.5 m are, and then nothing: no descent, no climb to the roof."""
    flight = flown("water")
    assert not flight.touched
    assert flight.log.column("z_m").min() > 1.2
    assert flight.log.column("z_m").max() < 1.9


def test_without_light_it_stops_and_says_what_is_missing() -> None:
    """Protects from flying on by six beams and memory."""
    world = load_world("hazard:no-light", 1)
    # With this seed it turns back after its look round.
    behind = Conditions(light_fails=Trigger(BEFORE.x_m - 3.0, 0.0, 2.5))
    flight = flown("no-light", np.inf, replace(world, conditions=behind))
    assert not flight.touched
    assert flight.measurement is not None
    assert flight.measurement.missing == (Input.DEPTH,)
    assert flight.vehicle.path_m > 0.5, "it flew until then"
    assert np.abs(flight.log.column("speed_mps")[-10:]).max() < 0.15


def test_a_dark_dead_end_is_turned_away_from() -> None:
    """Protects the flight home: a wall without echo fills the picture, and the vehicle stood before it until it landed.

    With this seed it comes there after half a minute.
    """
    world = load_world("hazard:dark-wall", 1)
    start = replace(BEFORE, x_m=21.5)
    flight = Flight(1, world, RayCaster(world), FLIGHT, start, np.random.SeedSequence(2))
    least_light_s = 0.0
    while flight.vehicle.pose.t_s < 50.0 and not flight.touched:
        flight.tick(FLIGHT.control.period_s, fleet=False)
        least_light_s = max(least_light_s, flight.blind_s)
    assert not flight.touched
    assert flight.log.column("x_m").max() > 25.5, "it was before it"
    assert least_light_s < 1.0
    assert flight.vehicle.path_m > 10.0, "it flew on"


@pytest.mark.long
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", HAZARDS)
def test_a_whole_mission_touches_nothing(name: str) -> None:
    """Protects what the table of docs/mines.md says: no contact, on the way home neither."""
    settings = vary(load_settings(None, "swift"), {"sim.ends": "done"}, lambda setting: setting)
    simulation = Simulation(load_world(f"hazard:{name}", 1), settings, 1)
    simulation.run(600.0)
    simulation.come_home()
    assert not any(flight.touched for flight in simulation.flights)
    # How the others end is in the table: some cannot come home, and say so.
    assert (simulation.ended_because == "inputs lost") == (name == "no-light")


def test_the_table_counts_what_the_flights_left() -> None:
    """Protects the document: contacts are summed, the least distance is that of either way, ends are told apart."""
    mission = {"given_world": "hazard:shaft", "preset": "swift", "completeness": 0.5, "least_clearance_m": 0.4}
    home = {"home_ended_because": "home", "home_arrived": True, "home_off_m": 0.1, "home_least_d_m": 0.7}
    landed = {"home_ended_because": "landed on the way: time", "home_arrived": False, "home_off_m": 12.3}
    rows = [
        mission | {"mission": 2, "ended_because": "contact", "contacts": 1, "least_d_m": 0.3},
        mission | {"mission": 0, "ended_because": "done", "contacts": 0, "least_d_m": 0.9} | home,
        mission | {"mission": 1, "ended_because": "done", "contacts": 0, "least_d_m": 0.8} | home | landed,
        mission | {"mission": 3, "ended_because": "done", "contacts": 0, "least_d_m": 0.8, "preset": "flight"} | home
        | {"home_arrived": False, "home_off_m": 0.8},
    ]  # fmt: skip
    lines = table(rows)
    assert lines[2:] == [
        "| shaft | swift | 3 | 1 | 0.30 | 0.40 | 2 of 3 | 1 of 3 | 0.50 | "
        "1 done, 1 done, then landed on the way: time (12.3 m), 1 contact |",
        "| shaft | flight | 1 | 0 | 0.70 | 0.40 | 1 of 1 | 0 of 1 | 0.50 | 1 done, then beside home (0.8 m) |",
    ]


def test_a_row_of_a_campaign_has_what_the_table_needs() -> None:
    """Protects the table from figures that were renamed."""
    simulation = Simulation(load_world("hazard:step", 1), FLIGHT, 1)
    simulation.run(0.5)
    simulation.come_home()
    row = figures(simulation) | {"mission": 0, "given_world": "hazard:step", "preset": "flight"}
    (line,) = table([row])[2:]
    assert line.startswith("| step | flight | 1 | 0 |")
    assert "| 0 of 1 | 1 of 1 |" in line, "it came home, of half a second"
    assert line.endswith("| 1 time limit |")
