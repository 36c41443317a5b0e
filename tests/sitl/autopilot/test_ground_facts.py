"""When either autopilot arms, and what is around it, against what was measured."""

from __future__ import annotations

import math

import pytest

from companion.model import Pose
from sitl.autopilot import ARDUPILOT, PX4, Personality
from sitl.autopilot.airframe import Surroundings, inside
from sitl.autopilot.events import event_id
from sitl.autopilot.mavlink import dialect as m
from sitl.mines import load_world
from sitl.scene.raycast import RayCaster
from tests.sitl.autopilot.rig import Rig, flying, odometry, travelled

BOTH = pytest.mark.parametrize("personality", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])
START = Pose(0.0, 3.0, 4.0, 0.0, 0.7)


def set_origin(rig: Rig) -> None:
    rig.send(m.MAVLink_set_gps_global_origin_message(1, 473977420, 85455940, 489400))


def without_gps(personality: Personality, feed: str = "frd", **options: object) -> Rig:
    """Fed, with an origin, and ready to arm."""
    rig = Rig(personality, START, gps=False, **options)
    rig.feeding = feed
    set_origin(rig)
    rig.run(3.0)
    return rig


def arms_after(rig: Rig, limit_s: float) -> tuple[float, list[str]]:
    """When it can be armed first, asked twice a second, and the different texts with which it refused until then."""
    while (result := rig.arm()) != 0:
        assert result == m.MAV_RESULT_FAILED
        rig.run(0.5)
        assert rig.t_s < limit_s
        if rig.mode == "STABILIZE":
            rig.set_mode("GUIDED")
    return rig.t_s, list(dict.fromkeys(text for text in rig.texts() if text.startswith("Arm: ")))


def test_ardupilot_arms_42_s_after_boot_with_gps_and_says_why_not_before() -> None:
    """Refusals have result 4 and texts, several at a time; position and arming come together."""
    rig = Rig(ARDUPILOT, boot_s=None)
    rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 193, 100_000)
    taken_s, reasons = arms_after(rig, 60.0)
    assert taken_s == pytest.approx(42.0, abs=1.0)
    assert reasons == [
        "Arm: System not initialised",
        "Arm: Accels inconsistent",
        "Arm: AHRS: waiting for home",
        "Arm: Need Position Estimate",
        "Arm: Gyros inconsistent",
    ]
    flags = list(dict.fromkeys(x.flags for _, x in rig.received if x.get_type() == "EKF_STATUS_REPORT"))
    assert flags == [0xA7, 0x33F]


def test_ardupilot_has_a_position_3_s_and_arms_21_s_after_ready_with_external_navigation() -> None:
    """Without GPS, and only with an origin; "Ready" is 2.3 s after boot."""
    rig = Rig(ARDUPILOT, START, gps=False, boot_s=None)
    rig.feeding = "frd"
    set_origin(rig)
    rig.until(lambda: ARDUPILOT.position_valid(rig.vehicle.state), 10.0)
    assert rig.t_s == pytest.approx(5.3, abs=0.2)
    taken_s, reasons = arms_after(rig, 40.0)
    assert taken_s == pytest.approx(23.3, abs=0.6)
    assert reasons == ["Arm: Accels inconsistent", "Arm: Gyros inconsistent"]


def test_ardupilot_without_origin_or_odometry_never_arms() -> None:
    """SET_GPS_GLOBAL_ORIGIN is needed, and so is the feed."""
    no_origin, no_feed = Rig(ARDUPILOT, gps=False), Rig(ARDUPILOT, gps=False)
    no_origin.feeding = "frd"
    set_origin(no_feed)
    for rig in (no_origin, no_feed):
        rig.set_mode("GUIDED")
        rig.run(60.0)
        assert rig.arm() == m.MAV_RESULT_FAILED


@pytest.mark.parametrize(
    ("parameter", "value"), [("VISO_TYPE", 0), ("EK3_SRC1_POSXY", 3), ("EK3_SRC1_POSXY", 0)], ids=str
)
def test_ardupilot_needs_its_parameters_for_external_navigation(parameter: str, value: float) -> None:
    """Pre-flight checks these."""
    rig = without_gps(ARDUPILOT, parameters={parameter: value})
    rig.set_mode("GUIDED")
    assert rig.arm() == m.MAV_RESULT_FAILED


def test_ardupilot_vision_position_alone_is_not_enough_for_its_velocity() -> None:
    """VISION_POSITION_ESTIMATE + VISION_SPEED_ESTIMATE."""
    rig = Rig(ARDUPILOT, START, gps=False)
    set_origin(rig)
    rig.set_mode("GUIDED")
    for _ in range(150):
        rig.send(m.MAVLink_vision_position_estimate_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        rig.run(0.02)
    assert rig.arm() == m.MAV_RESULT_FAILED
    rig.feeding = "ned"
    rig.run(1.0)
    assert rig.arm() == 0


def test_px4_is_armable_5_s_after_the_origin_with_ned_feeds() -> None:
    """Hold needs a global origin."""
    rig = Rig(PX4, START, gps=False, boot_s=None)
    rig.feeding = "ned"
    rig.run(10.0)
    assert rig.arm() == m.MAV_RESULT_TEMPORARILY_REJECTED
    set_origin(rig)
    rig.run(4.5)
    assert rig.arm() == m.MAV_RESULT_TEMPORARILY_REJECTED
    rig.run(1.0)
    assert rig.arm() == 0


def test_px4_never_holds_with_frd_feeds_but_takes_off_before_arming() -> None:
    """Take-off, then arm; or arm in offboard. A failsafe hold becomes a landing."""
    rig = without_gps(PX4, parameters={"MIS_TAKEOFF_ALT": 1.5, "COM_OBL_RC_ACT": 5})
    rig.run(20.0)
    assert rig.arm() == m.MAV_RESULT_TEMPORARILY_REJECTED
    assert rig.command(m.MAV_CMD_NAV_TAKEOFF, *[math.nan] * 7) == 0
    assert rig.arm() == 0
    rig.run(9.0)
    assert rig.height_m == pytest.approx(1.5, abs=0.15)
    rig.offboard()
    rig.streaming = None
    rig.until(lambda: rig.mode == "AUTO.LAND", 2.0)


def test_px4_arms_in_offboard_with_frd_feeds() -> None:
    """And lifts off by a climbing setpoint."""
    rig = without_gps(PX4)
    rig.streaming = (0.0, 0.0, -0.5, 0.0)
    rig.run(0.5)
    assert rig.set_mode("OFFBOARD") == 0
    assert rig.arm() == 0
    rig.run(7.5)
    assert rig.height_m > 0.5


@pytest.mark.parametrize(
    ("kind", "options"),
    [("mocap", {}), ("frd", {"EKF2_EV_CTRL": 0}), ("frd", {"EKF2_EV_CTRL": 4})],
    ids=["MOCAP_NED", "EV_CTRL 0", "EV_CTRL 4"],
)
def test_px4_ignores_odometry_in_mocap_frame_or_without_its_parameter(kind: str, options: dict[str, float]) -> None:
    """`set_odometry`'s default frame goes nowhere."""
    rig = without_gps(PX4, feed=kind, parameters=options)
    assert not PX4.position_valid(rig.vehicle.state)


@BOTH
def test_without_gps_the_estimate_follows_the_odometry(personality: Personality) -> None:
    """In the odometry's frame: forward at the start is its north."""
    rig = without_gps(personality)
    rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 32, 20_000)
    rig.feeding = None
    for _ in range(40):
        rig.send(odometry(2.0, -1.0, -0.5))
        rig.run(0.03)
    at = rig.newest("LOCAL_POSITION_NED")
    assert (at.x, at.y, at.z) == pytest.approx((2.0, -1.0, -0.5), abs=0.06)


@BOTH
def test_without_gps_it_flies_along_its_nose(personality: Personality) -> None:
    """A body velocity means the same whatever direction the odometry calls north."""
    rig = without_gps(personality, parameters={"MIS_TAKEOFF_ALT": 1.5} if personality is PX4 else None)
    rig.fly()
    rig.offboard()
    since = rig.pose
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(5.0)
    # The sideways disturbance, 0.03 m/s (one sigma) beside 0.42 m/s, turns the track by 0.07.
    assert math.atan2(rig.pose.y_m - since.y_m, rig.pose.x_m - since.x_m) == pytest.approx(0.7, abs=0.25)


@BOTH
def test_holding_follows_a_drifting_odometry(personality: Personality) -> None:
    """It stays where it believes to be, not where it is."""
    rig = without_gps(personality)
    rig.fly()
    before = rig.pose
    rig.feeding = None
    q = [1.0, 0.0, 0.0, 0.0]
    for i in range(200):
        dx = (rig.pose.x_m - START.x_m) * math.cos(0.7) + (rig.pose.y_m - START.y_m) * math.sin(0.7)
        rig.send(odometry(dx + 0.005 * i, 0.0, -rig.height_m, q))
        rig.run(0.03)
    forward_m = (rig.pose.x_m - before.x_m) * math.cos(0.7) + (rig.pose.y_m - before.y_m) * math.sin(0.7)
    assert forward_m == pytest.approx(-1.0, abs=0.35)


@pytest.mark.parametrize(("tout_us", "after_s"), [(1_000_000, 0.75), (5_000_000, 4.75)])
def test_px4_dead_reckons_and_then_descends_blind(tout_us: int, after_s: float) -> None:
    """EKF2_NOAID_TOUT: 0.75 s with 1 s; by default long enough to gather speed."""
    rig = without_gps(PX4, feed="ned", parameters={"EKF2_NOAID_TOUT": tout_us})
    rig.run(6.0)
    rig.fly()
    rig.offboard()
    rig.feeding = None
    assert rig.until(lambda: rig.mode == "AUTO.LAND", 8.0) == pytest.approx(after_s, abs=0.1)
    assert "Failsafe activated\t" in rig.texts()
    assert rig.newest("EVENT").id == event_id("commander_failsafe_enter_autopilot_disengaged")
    assert (rig.vehicle.state.airframe.speed_mps > 0.2) is (tout_us > 2_000_000)
    rig.until(lambda: not rig.armed, 20.0)
    assert rig.height_m == 0.0


def test_ardupilot_does_nothing_for_8_s_and_then_lands() -> None:
    """Then "EKF variance" and LAND."""
    rig = without_gps(ARDUPILOT)
    rig.fly()
    rig.offboard()
    rig.feeding = None
    assert rig.until(lambda: rig.mode == "LAND", 10.0) == pytest.approx(8.0, abs=0.1)
    rig.run(0.1)
    assert "EKF variance" in rig.texts()
    rig.until(lambda: not rig.armed, 20.0)


@BOTH
def test_odometry_that_is_no_number_is_ignored(personality: Personality) -> None:
    """It must not reach the estimate."""
    rig = without_gps(personality)
    before = rig.vehicle.state.estimator.pose
    for bad in (odometry(math.nan, 0, 0), odometry(0, math.inf, 0), odometry(0, 0, 0, [math.nan] * 4)):
        rig.send(bad)
    rig.send(odometry(0, 0, 0, [0.0] * 4))
    rig.send(odometry(1e9, 0, 0))
    assert rig.vehicle.state.estimator.pose == before
    assert rig.vehicle.state.counts["odometry that is no number"] == 4


# What is around the vehicle: obstacles that are reported to it, ground that it stands on, walls that it hits.


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
