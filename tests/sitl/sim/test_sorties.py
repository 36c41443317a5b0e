"""More than one sortie in the same mine: the second one goes on where the first had to turn back."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from bench.flight.sorties import left_by, put_back
from companion.config.mapping import MapSettings
from companion.config.sensors import CameraSettings, SensorSettings
from companion.config.settings import Settings
from companion.config.sim import SimSettings
from companion.control.known_ground import KnownGround
from companion.control.left_out import to_explore
from companion.mapping import VoxelMap
from companion.model import Pose
from sitl.mines import World
from sitl.mines.plan import square_drift
from sitl.sim.simulation import COMPLETE_SHARE, Simulation
from tests.sitl.sim.test_passages import raised

SETTINGS = Settings(
    sensors=SensorSettings(camera=CameraSettings(width_px=96, height_px=72)), mapping=MapSettings(voxel_m=0.3)
)
ARM_M, BATTERY_S = 18.0, 80.0
"""Time for one of three arms; all of them take up to four times as long."""


def crossing() -> World:
    """Where three drifts 4 m wide meet, in the middle of which it takes off."""
    drifts = [square_drift(-ARM_M, 0.0, ARM_M, 0.0, width_m=4.0), square_drift(0.0, 0.0, 0.0, ARM_M, width_m=4.0)]
    mine = raised(drifts, [-ARM_M - 2.0, ARM_M + 2.0], [3.0, 3.0])
    return replace(mine, start=Pose(0.0, 0.0, 0.0, SETTINGS.control.height_m, 0.5))


@pytest.fixture(scope="module")
def first() -> Simulation:
    mission = Simulation(crossing(), SETTINGS, seed=3)
    mission.run(BATTERY_S)
    mission.come_home()
    return mission


@pytest.mark.flight
def test_the_second_sortie_goes_to_what_the_first_left(first: Simulation) -> None:
    """It completes the mine sooner than a flight that begins anew, and comes home over the ground of both."""
    assert first.coming_home[0].score()["arrived"]
    assert first.completeness < 0.7
    assert to_explore(first.left_out) >= 1, "whoever changes the battery is told to fly again"
    anew = Simulation(crossing(), SETTINGS, seed=13)
    anew.run(600.0)
    second = Simulation(crossing(), SETTINGS, seed=13, earlier=left_by(first))
    second.run(600.0)
    assert anew.completed_at_s is not None
    assert second.completed_at_s is not None
    assert second.completed_at_s < 0.85 * anew.completed_at_s
    assert second.progress[0][1] >= first.completeness, "the shares add up"
    assert second.completeness >= COMPLETE_SHARE
    second.come_home()
    assert second.coming_home[0].score()["arrived"]
    assert second.score()["contacts"] == 0
    both, before = second.flights[0].navigator.known_ground.seen(), first.flights[0].navigator.known_ground.seen()
    assert both.free_m2 > 1.3 * before.free_m2
    assert both.free_m2 == pytest.approx(anew.flights[0].navigator.known_ground.seen().free_m2, rel=0.1)


@pytest.mark.flight
@pytest.mark.parametrize("turned_deg", [-5.0, 5.0])
def test_a_vehicle_that_was_put_back_beside_its_place_explores_and_turns_home(
    turned_deg: float, first: Simulation
) -> None:
    """Nobody puts it back to the centimetre: what it knows of the ground lies 0.3 m and 5° beside what it sees."""
    mine = put_back(crossing(), 0.3, math.radians(turned_deg))
    settings = SETTINGS.model_copy(update={"sim": SimSettings(ends="done")})
    left = left_by(first)
    # By what it maps itself: what the first one mapped is as far off as it was put back.
    second = Simulation(mine, settings, seed=13, earlier=replace(left, voxels=VoxelMap(settings.mapping)))
    second.run(600.0)
    second.come_home()
    assert second.ended_because == "done"
    home = second.coming_home[0].score()
    assert home["arrived"], home
    assert second.score()["contacts"] == 0
    assert second.completeness > 1.0 - first.completeness


@pytest.mark.parametrize("voxel_m", [0.3, 0.2])
def test_what_does_not_fit_is_refused(voxel_m: float) -> None:
    """Protects the map from one with voxels of another size, and the ground from one with other cells."""
    earlier = left_by(Simulation(crossing(), SETTINGS, seed=3))
    if voxel_m == SETTINGS.mapping.voxel_m:
        earlier = replace(earlier, ground=KnownGround(cell_m=0.3).seen())
    settings = SETTINGS.model_copy(update={"mapping": MapSettings(voxel_m=voxel_m)})
    with pytest.raises(ValueError, match=r"cells are 0\.3 m wide|voxels of 0\.3 m into one of 0\.2 m"):
        Simulation(crossing(), settings, seed=1, earlier=earlier)
