"""What is around the vehicle: obstacles that are reported to it, ground that it stands on, walls that it hits."""

from __future__ import annotations

import math

import pytest

from companion.model import Pose
from sitl.autopilot import ARDUPILOT, PX4, Personality
from sitl.autopilot.airframe import Surroundings, inside
from sitl.autopilot.mavlink import dialect as m
from sitl.mines import load_world
from sitl.scene.raycast import RayCaster
from tests.sitl.autopilot.rig import Rig, flying, travelled

BOTH = pytest.mark.parametrize("personality", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])


def wall_ahead(rig: Rig, range_cm: int = 120) -> None:
    distances = [65535] * 72
    distances[0] = range_cm
    rig.send(m.MAVLink_obstacle_distance_message(0, 0, distances, 5, 20, 1000, 0.0, 0.0, 12))


def after_a_wall(rig: Rig) -> float:
    """Forward velocity after 3 s of zero setpoints with a wall 1.2 m ahead."""
    for _ in range(30):
        wall_ahead(rig)
        rig.run(0.1)
    pose = rig.pose
    return pose.vx_mps * math.cos(pose.yaw_rad) + pose.vy_mps * math.sin(pose.yaw_rad)


def test_ardupilot_avoidance_flies_backwards_on_a_zero_command() -> None:
    """0.77 m/s with the defaults and PRX1_TYPE 2: what pre-flight must catch."""
    assert after_a_wall(flying(ARDUPILOT, parameters={"PRX1_TYPE": 2})) == pytest.approx(-0.77, abs=0.1)


@pytest.mark.parametrize(
    "parameters",
    [
        {"PRX1_TYPE": 2, "AVOID_ENABLE": 0},
        {"PRX1_TYPE": 0},
        {"PRX1_TYPE": 2, "AVOID_MARGIN": 1.0},
        {"PRX1_TYPE": 2, "AVOID_BACKUP_SPD": 0.0},
    ],
    ids=str,
)
def test_ardupilot_avoidance_can_be_disarmed(parameters: dict[str, float]) -> None:
    """What pre-flight sets really helps."""
    assert abs(after_a_wall(flying(ARDUPILOT, parameters=parameters))) < 0.15


def test_px4_collision_prevention_does_nothing_in_offboard() -> None:
    """OBSTACLE_DISTANCE at 0.4 m, and it flew on."""
    rig = flying(PX4, parameters={"CP_DIST": 3.0})
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    since = rig.pose
    for _ in range(30):
        wall_ahead(rig, 40)
        rig.run(0.1)
    assert travelled(rig, since) > 0.7


@BOTH
def test_touching_a_wall_ends_the_flight(personality: Personality) -> None:
    """Disarmed, on the ground, counted once, not to be armed again."""
    wall = Surroundings(lambda _x, _y, _z: 0.0, lambda x, _y, z: max(0.0, min(2.0 - x, z)))
    rig = flying(personality, surroundings=wall)
    rig.streaming = (1.0, 0.0, 0.0, 0.0)
    rig.until(lambda: not rig.armed, 10.0)
    assert rig.pose.x_m == pytest.approx(1.7, abs=0.05)
    rig.run(2.0)
    assert rig.height_m == 0.0
    assert rig.vehicle.state.airframe.contacts == 1
    assert "Crash: Disarming" in rig.texts()
    assert rig.arm() != 0


def test_sloping_ground_carries_and_is_landed_on() -> None:
    """A mine has ramps: the height that counts is that above the ground below."""
    ramp = Surroundings(lambda x, _y, _z: 0.25 * x)
    rig = flying(PX4, surroundings=ramp, parameters={"COM_OBL_RC_ACT": 5})
    rig.streaming = (0.5, 0.0, -0.12, 0.0)
    rig.run(8.0)
    assert rig.pose.z_m - 0.25 * rig.pose.x_m == pytest.approx(rig.height_m)
    assert rig.command(m.MAV_CMD_NAV_LAND) == 0
    rig.until(lambda: not rig.armed, 20.0)
    assert rig.pose.z_m == pytest.approx(0.25 * rig.pose.x_m, abs=1e-6)


def test_in_a_mine_it_stands_on_the_floor_and_ends_at_the_wall() -> None:
    """What `--world` gives the vehicle: the floor under its feet, and walls that stop it."""
    mine = load_world("room", 1, (2.0, 2.0, 1.0, 0.0))
    rig = flying(PX4, start=Pose(0.0, 2.0, 2.0, 1.0, 0.0), surroundings=inside(RayCaster(mine), 0.3, 0.15))
    floor_m = rig.vehicle.state.estimator.origin.z_m - 0.15
    assert abs(floor_m) < 0.3
    assert rig.pose.z_m - floor_m == pytest.approx(1.65, abs=0.2)
    rig.streaming = (-1.0, 0.0, 0.0, 0.0)
    rig.until(lambda: not rig.armed, 10.0)
    assert rig.vehicle.state.airframe.contacts == 1


def test_ardupilot_tells_a_distance_only_with_a_rangefinder_set_up() -> None:
    """RNGFND1_TYPE 10 takes DISTANCE_SENSOR; 0 is no rangefinder."""
    for kind, sent in ((0, False), (10, True)):
        rig = Rig(ARDUPILOT, parameters={"RNGFND1_TYPE": kind})
        assert rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 132, 100_000) == 0
        assert any(x.get_type() == "DISTANCE_SENSOR" for x in rig.run(0.5)) is sent
