"""The referee: least distance, contacts and way, from true poses alone."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from companion.config.settings import Settings
from companion.errors import InputError
from companion.model import Pose
from sitl.scene.live import LiveWorld
from sitl.scene.raycast import RayCaster
from sitl.world.contact_monitor import ContactMonitor, Look, Trajectory, write_score
from sitl.world.placement import Scene
from tests.sitl.scene.test_render import box

SETTINGS = Settings()
RADIUS_M = SETTINGS.vehicle.body_radius_m
STAND = Pose(0.0, 5.0, 3.0, 0.15, 0.0)


@pytest.fixture(scope="module")
def scene() -> Scene:
    world = box((0.0, 0.0, 0.0), (20.0, 6.0, 3.0))
    return Scene(world, RayCaster(world), STAND)


def live_in(scene: Scene) -> LiveWorld:
    return LiveWorld(scene.world, scene.caster, SETTINGS.sensors.camera.model())


class Trip:
    """A vehicle that is led about, watched at 50 Hz."""

    def __init__(self, scene: Scene) -> None:
        self.watch = ContactMonitor(scene, SETTINGS, live_in(scene))
        self.pose = replace(scene.stand, t_s=10.0)

    def to(self, x_m: float, y_m: float, z_m: float, speed_mps: float = 0.5) -> list[Look]:
        looks = []
        for pose in self._way(x_m, y_m, z_m, speed_mps):
            self.pose = pose
            look = self.watch.look(pose)
            if look is not None:
                looks.append(look)
        return looks

    def _way(self, x_m: float, y_m: float, z_m: float, speed_mps: float) -> Iterator[Pose]:
        begin = self.pose
        delta = (x_m - begin.x_m, y_m - begin.y_m, z_m - begin.z_m)
        length_m = sum(d * d for d in delta) ** 0.5
        steps = max(1, round(length_m / speed_mps / 0.02))
        for i in range(1, steps + 1):
            share = i / steps
            yield replace(
                begin,
                t_s=begin.t_s + 0.02 * i,
                x_m=begin.x_m + share * delta[0],
                y_m=begin.y_m + share * delta[1],
                z_m=begin.z_m + share * delta[2],
                vx_mps=delta[0] / (0.02 * steps),
                vy_mps=delta[1] / (0.02 * steps),
            )


def test_a_flight_from_floor_to_floor(scene: Scene) -> None:
    """Up, 4 m along, to 1.2 m from a wall, down: the floor under it is no contact, and the walls are measured."""
    trip = Trip(scene)
    assert {look.d_m for look in trip.to(5.0, 3.0, 0.45)} == {None}
    trip.to(5.0, 3.0, 1.5)
    trip.to(9.0, 3.0, 1.5)
    trip.to(9.0, 1.2, 1.5)
    trip.to(9.0, 1.2, 0.15)
    watch = trip.watch
    assert watch.contacts == 0
    assert watch.least_d_m == pytest.approx(1.2, abs=0.01)
    assert watch.path_m == pytest.approx(1.35 + 4.0 + 1.8 + 1.35, abs=0.1)
    assert watch.figures()["highest_above_start_m"] == pytest.approx(1.35, abs=0.02)
    assert watch.figures()["time_below_d_s_fraction"] == 0.0


def test_looks_come_twenty_times_a_second(scene: Scene) -> None:
    """Of truth at 50 Hz: every 5 cm of the way at 1 m/s."""
    assert len(Trip(scene).to(15.0, 3.0, 0.15, speed_mps=1.0)) == pytest.approx(200, abs=4)


def test_a_wall_within_the_body_is_a_contact_and_counts_once(scene: Scene) -> None:
    """Scraping along for metres is one contact; coming clear and back is another."""
    trip = Trip(scene)
    trip.to(5.0, 3.0, 1.5)
    trip.to(5.0, RADIUS_M - 0.02, 1.5)
    trip.to(9.0, RADIUS_M - 0.02, 1.5)
    trip.to(9.0, RADIUS_M + 0.05, 1.5)
    trip.to(9.0, RADIUS_M - 0.02, 1.5)
    assert trip.watch.contacts == 1
    assert trip.watch.first_contact_s is not None
    trip.to(9.0, 2.0, 1.5)
    looks = trip.to(9.0, 0.1, 1.5)
    assert trip.watch.contacts == 2
    assert looks[-1].touching
    assert trip.watch.least_d_m == pytest.approx(0.1, abs=0.01)
    assert trip.watch.figures()["least_clearance_m"] == pytest.approx(0.1 - RADIUS_M, abs=0.01), "inside of the wall"


@pytest.mark.parametrize(
    ("where", "speed_mps"),
    [
        pytest.param((5.0, 3.0, 2.9), 0.5, id="the roof"),
        pytest.param((5.0, 8.0, 1.5), 0.5, id="through the wall"),
        pytest.param((12.0, 3.0, 0.2), 1.0, id="the floor at speed"),
    ],
)
def test_other_contacts(scene: Scene, where: tuple[float, float, float], speed_mps: float) -> None:
    """The roof, the rock behind the wall, and a floor that is flown into and not landed on."""
    trip = Trip(scene)
    trip.to(5.0, 3.0, 1.5)
    assert trip.watch.contacts == 0
    trip.to(*where, speed_mps)
    assert trip.watch.contacts >= 1


def test_a_landing_that_ends_below_the_floor_is_no_contact(scene: Scene) -> None:
    """Simulators have a level ground of their own, which may lie deeper than the mine's floor."""
    trip = Trip(scene)
    trip.to(5.0, 3.0, 1.5)
    trip.to(5.0, 3.0, -1.0)
    assert trip.watch.contacts == 0


def test_at_rest_no_way_is_counted(scene: Scene) -> None:
    """The truth's last digits flicker by millimetres: an hour of that is not a flight."""
    watch = ContactMonitor(scene, SETTINGS, live_in(scene))
    for i in range(5000):
        watch.look(replace(STAND, t_s=10.0 + 0.02 * i, x_m=STAND.x_m + 0.005 * (i % 2)))
    assert watch.path_m == 0.0


def test_a_restart_is_not_flown(scene: Scene) -> None:
    """From 4 m away back to the start, in no time."""
    trip = Trip(scene)
    trip.to(5.0, 3.0, 1.5)
    trip.to(9.0, 3.0, 1.5)
    before_m = trip.watch.path_m
    trip.watch.restart()
    trip.watch.look(replace(STAND, t_s=trip.pose.t_s + 1.0))
    assert trip.watch.path_m == before_m


def test_figures_of_a_vehicle_that_never_came(tmp_path: Path, scene: Scene) -> None:
    """No infinity and no NaN in the file: JSON has neither."""
    write_score(tmp_path / "score.json", ContactMonitor(scene, SETTINGS, live_in(scene)).figures())
    score = json.loads((tmp_path / "score.json").read_text())
    assert score["least_d_m"] is None
    assert (score["contacts"], score["path_length_m"], score["sim_time_s"]) == (0, 0.0, 0.0)


def test_files_that_cannot_be_written_are_the_users_mistake(tmp_path: Path) -> None:
    """With the option's name."""
    with pytest.raises(InputError, match="--score"):
        write_score(tmp_path / "nowhere" / "score.json", {})
    with pytest.raises(InputError, match="--trajectory"), Trajectory(tmp_path / "nowhere" / "t.csv"):
        pass


def test_the_trajectory_is_a_row_for_each_look(tmp_path: Path) -> None:
    """Distance empty while it stands: it is not known, and not zero."""
    with Trajectory(tmp_path / "t.csv") as trajectory:
        trajectory.add(Look(STAND, None, touching=False))
        trajectory.add(Look(STAND, 1.25, touching=True))
    trajectory.flush()  # after the end as well
    with (tmp_path / "t.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["d_m"], row["touching"]) for row in rows] == [("", "0"), ("1.250", "1")]
    assert float(rows[0]["x_m"]) == STAND.x_m
