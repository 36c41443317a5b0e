"""What a flight of the matrix is judged by: where the simulator says that the vehicle truly is."""

from __future__ import annotations

import math

import pytest

from tests.sitl.world.messages import hil
from validation.fault_matrix.corridor import TO_WALL_M, WIDTH_M
from validation.fault_matrix.true_way import ROOF_M, STANDING_FOR_S, TrueWay, Truth, contacts, standing_s

RADIUS_M = 0.35


def test_the_way_leads_along_the_corridor_whichever_way_the_simulator_looks() -> None:
    """Protects every figure of the table: distance to the wall, way, height."""
    way = TrueWay()
    yaw_rad = 1.0
    assert way.newest() is None
    for i, ahead_m in enumerate((0.0, 1.0)):
        north_m, east_m = ahead_m * math.cos(yaw_rad), ahead_m * math.sin(yaw_rad)
        way.hear(hil((north_m, east_m, -1.0 * i), yaw_rad), 1.0 + i)

    first, last = way.looks()
    assert first.d_m is None, "it stands"
    assert last.x_m - first.x_m == pytest.approx(1.0, abs=0.05)
    assert last.d_m == pytest.approx(min(TO_WALL_M - 1.0, WIDTH_M / 2.0), abs=0.05)
    assert last.roof_m == pytest.approx(ROOF_M - 1.0, abs=0.02)
    assert way.looks(since_s=last.t_s) == [last]


def _look(t_s: float, speed_mps: float = 0.0, d_m: float | None = 1.0, roof_m: float = 1.5) -> Truth:
    return Truth(t_s, 0.0, 0.0, 1.5, speed_mps, d_m, roof_m)


def test_it_stands_once_it_goes_on_standing() -> None:
    """Protects the time to standing: a turning point is none."""
    looks = [_look(0.1 * i, 0.4 if i < 5 or i == 8 else 0.0) for i in range(30)]
    assert standing_s(looks, 0.0) == pytest.approx(0.8)
    assert standing_s(looks[: 8 + round(STANDING_FOR_S / 0.1)], 0.0) is None
    assert standing_s([], 0.0) is None


def test_walls_and_roof_are_touched_once_each_time() -> None:
    """Protects the first figure of all; a failsafe that climbs meets the roof."""
    distances = [1.0, 0.3, 0.3, 1.0, None, 0.2]
    assert contacts([_look(0.0, d_m=d_m) for d_m in distances], RADIUS_M) == 2
    assert contacts([_look(0.0, roof_m=0.3)], RADIUS_M) == 1
    assert contacts([_look(0.0, d_m=None, roof_m=0.3)], RADIUS_M) == 0
