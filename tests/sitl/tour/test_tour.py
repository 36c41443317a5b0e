"""What `sitl.tour` plans: a tour that can be flown, and that sees what it says it sees."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.config.load import load_settings
from companion.mapping import VoxelMap
from companion.model import DepthFrame, wrap_rad
from sitl.mines import load_world
from sitl.scene.render import DepthRenderer
from sitl.sim.simulation import COMPLETE_SHARE, Simulation
from sitl.tour.inspection import Inspection, inspection
from sitl.tour.ways import Ways

SEED, SPEED_MPS = 1, 0.5


@pytest.fixture(scope="module")
def mission() -> Simulation:
    return Simulation(load_world("room", SEED), load_settings(None, "flight"), SEED)


@pytest.fixture(scope="module")
def tour(mission: Simulation) -> Inspection:
    return inspection(mission.world, mission.settings, SEED, SPEED_MPS, rounds=(100, 50))


def test_a_map_made_on_the_tour_is_complete(mission: Simulation, tour: Inspection) -> None:
    """Protects every ratio to a tour: images drawn on it and the map made of them say what was seen, not its count."""
    camera = mission.settings.sensors.camera.model()
    renderer = DepthRenderer(mission.world, camera)
    voxels = VoxelMap(mission.settings.mapping)
    for k, pose in enumerate(tour.poses):
        at = replace(pose, t_s=k / mission.settings.sensors.camera.rate_hz)
        voxels.integrate(DepthFrame(at.t_s, renderer.render(at), camera, at))
    areas = mission.truth.sample_areas_m2.astype(np.float64)
    found = voxels.occupied_near(mission.truth.samples_m)
    assert areas[found].sum() / areas.sum() >= COMPLETE_SHARE
    assert tour.share >= COMPLETE_SHARE


def test_the_tour_begins_where_the_mission_does_and_takes_what_its_poses_take(
    mission: Simulation, tour: Inspection
) -> None:
    """Protects the time: every metre and every turn between the poses is in it, the first turn too."""
    assert tour.poses[0] == mission.flights[0].vehicle.pose
    pairs = list(itertools.pairwise(tour.poses))
    length_m = sum(math.dist((a.x_m, a.y_m, a.z_m), (b.x_m, b.y_m, b.z_m)) for a, b in pairs)
    turned_rad = sum(abs(wrap_rad(b.yaw_rad - a.yaw_rad)) for a, b in pairs)
    yaw_rate_radps = mission.settings.control.max_yaw_rate_radps
    assert tour.length_m == pytest.approx(length_m, rel=1e-3)
    assert tour.time_s == pytest.approx(length_m / SPEED_MPS + turned_rad / yaw_rate_radps, rel=1e-3)


def test_the_vehicle_flies_the_way_it_points_and_never_nearer_to_a_wall_than_d_c(
    mission: Simulation, tour: Inspection
) -> None:
    """Protects the comparison: whoever flew sideways or cut corners would be faster."""
    assert tour.least_d_m >= mission.settings.control.critical_margin_m
    for a, b in itertools.pairwise(tour.poses):
        if math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) > 1e-6:
            assert abs(wrap_rad(math.atan2(b.y_m - a.y_m, b.x_m - a.x_m) - b.yaw_rad)) < 1e-6


def test_the_same_mission_has_the_same_tour(mission: Simulation, tour: Inspection) -> None:
    again = inspection(mission.world, mission.settings, SEED, SPEED_MPS, rounds=(100, 50))
    assert again.poses == tour.poses


def test_who_searches_longer_finds_no_longer_tour(mission: Simulation, tour: Inspection) -> None:
    """Protects that the search searches: greedy cover, nearest neighbour and 2-opt alone are longer than its result."""
    first = inspection(mission.world, mission.settings, SEED, SPEED_MPS, rounds=(0,))
    assert tour.time_s < 0.9 * first.time_s


def grid(*rows: str, z_m: float = 0.0, step_m: float = 0.5) -> NDArray[np.float64]:
    """(k, 3) a place for each # of a drawing, the first row furthest south."""
    return np.array(
        [(x * step_m, y * step_m, z_m) for y, row in enumerate(rows) for x, is_ in enumerate(row) if is_ == "#"]
    )


def test_a_way_round_a_corner_is_pulled_taut() -> None:
    """Protects the lengths: on a grid alone a slanted way is up to 8 % too long."""
    open_place = Ways(grid(*["#" * 21] * 9), 0.5)
    leg = open_place.leg(0, 9 * 21 - 1)
    assert leg.length_m == pytest.approx(math.hypot(10.0, 4.0))
    assert leg.headings_rad == pytest.approx([math.atan2(4.0, 10.0)])
    corner = Ways(grid(*["#" * 21], *["." * 20 + "#"] * 8), 0.5)
    assert corner.leg(0, 28).length_m == pytest.approx(9.5 + math.hypot(0.5, 0.5) + 3.5)
    assert corner.leg(28, 0).headings_rad == pytest.approx([-math.pi / 2.0, -0.75 * math.pi, -math.pi])


def test_what_is_above_each_other_is_joined_by_no_way() -> None:
    """Protects mines with ramps: nobody flies through the floor."""
    ways = Ways(np.concatenate([grid("#####"), grid("#####", z_m=4.0)]), 0.5)
    assert not np.isfinite(ways.lengths_m(0)[5:]).any()
    assert ways.nearest(np.array([[1.1, 0.1, 3.9]])).tolist() == [7]
    with pytest.raises(ValueError, match="no way"):
        ways.leg(0, 7)


@pytest.mark.parametrize(("step_m", "leads"), [(0.7, True), (0.8, False)])
def test_ways_lead_over_the_steps_that_the_surface_goes_over(step_m: float, leads: bool) -> None:
    """Protects tours of real mines: what the judge counts as flown over, the tour flies over as well."""
    ways = Ways(np.concatenate([grid("#####"), grid(".....#####", z_m=step_m)]), 0.5)
    assert np.isfinite(ways.lengths_m(0)[5:]).all() == leads
    if leads:
        assert ways.leg(0, 9).length_m == pytest.approx(math.hypot(4.5, step_m))
