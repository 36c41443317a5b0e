"""How either autopilot flies, against what was measured on the real ones."""

from __future__ import annotations

import math

import pytest

from companion.model import Pose
from sitl.autopilot import ARDUPILOT, PX4, Personality
from sitl.autopilot.mavlink import dialect as m
from tests.sitl.autopilot.rig import flying, ready, still, travelled

BOTH = pytest.mark.parametrize("personality", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])


def test_px4_take_off_holds_early_and_creeps_up() -> None:
    """HOLD at 0.9 m is not "height reached": that takes 7 to 9 s."""
    rig = ready(PX4, parameters={"MIS_TAKEOFF_ALT": 1.5})
    assert rig.arm() == 0
    assert rig.command(m.MAV_CMD_NAV_TAKEOFF, *[math.nan] * 7) == 0
    begun_s = rig.t_s
    rig.until(lambda: rig.mode == "AUTO.LOITER", 10.0)
    assert rig.height_m == pytest.approx(0.9, abs=0.1)
    rig.until(lambda: rig.height_m > 1.4, 10.0)
    assert 6.5 < rig.t_s - begun_s < 9.0


def test_ardupilot_take_off_takes_under_five_seconds() -> None:
    """4.7 s to 1.5 m, and the mode stays GUIDED."""
    rig = ready(ARDUPILOT)
    assert rig.set_mode("GUIDED") == 0
    assert rig.arm() == 0
    assert rig.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.5) == 0
    assert 4.0 < rig.until(lambda: rig.height_m > 1.43, 10.0) < 5.4
    assert rig.mode == "GUIDED"


@pytest.mark.parametrize("before", [True, False])
def test_ardupilot_velocity_setpoints_before_the_take_off_suppress_it(before: bool) -> None:
    """They do not lift it either, and it disarms after 10 s."""
    rig = ready(ARDUPILOT)
    rig.set_mode("GUIDED")
    rig.arm()
    rig.streaming = (0.0, 0.0, -0.5, 0.0)
    if before:
        rig.run(0.5)
    assert rig.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.5) == 0
    taken = rig.until(lambda: not rig.armed, 12.0)
    assert taken == pytest.approx(10.0, abs=0.6)
    assert rig.height_m == 0.0


@BOTH
def test_armed_on_the_ground_it_disarms_after_ten_seconds(personality: Personality) -> None:
    """Whoever waits too long has to arm again."""
    rig = ready(personality)
    if personality is ARDUPILOT:
        rig.set_mode("GUIDED")
    assert rig.arm() == 0
    assert rig.until(lambda: not rig.armed, 12.0) == pytest.approx(10.0, abs=0.2)


@BOTH
def test_landing_disarms_by_itself(personality: Personality) -> None:
    """6 to 14 s from 1.5 m."""
    rig = ready(personality)
    rig.fly()
    assert rig.command(m.MAV_CMD_NAV_LAND) == 0
    assert 5.5 < rig.until(lambda: not rig.armed, 20.0) < 14.0
    assert rig.height_m == 0.0


@BOTH
def test_commanded_speed_and_turn_are_not_quite_reached(personality: Personality) -> None:
    """0.5 m/s gave 0.42 along the nose, 17 degrees/s gave 16 to 17, clockwise."""
    rig = flying(personality, start=Pose(0.0, 0.0, 0.0, 0.0, 1.0))
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(3.0)
    since, begun_s = rig.pose, rig.t_s
    rig.run(10.0)
    assert travelled(rig, since) / (rig.t_s - begun_s) == pytest.approx(0.42, abs=0.03)
    assert math.atan2(rig.pose.y_m - since.y_m, rig.pose.x_m - since.x_m) == pytest.approx(1.0, abs=0.25)
    rig.streaming = (0.0, 0.0, 0.0, math.radians(17.0))
    rig.run(2.0)
    assert -17.0 < math.degrees(rig.pose.yaw_rate_radps) < -16.0


def test_px4_brakes_as_measured() -> None:
    """Zero velocity: below 0.1 m/s after 0.75 to 1 s, 0.15 m travelled; the slow drift adds some."""
    rig = flying(PX4)
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(4.0)
    since = rig.pose
    rig.streaming = (0.0, 0.0, 0.0, 0.0)
    rig.setpoint(0.0)
    assert 0.6 < rig.until(lambda: still(rig), 3.0) < 1.0
    assert 0.1 < travelled(rig, since) < 0.22


@BOTH
def test_height_drifts_in_velocity_mode(personality: Personality) -> None:
    """The height loop is the application's."""
    rig = flying(personality)
    heights = []
    for _ in range(30):
        rig.run(1.0)
        heights.append(rig.height_m)
    assert 0.05 < max(heights) - min(heights) < 1.5


def test_px4_takes_offboard_only_from_a_stream() -> None:
    """Above 2 Hz before the mode is taken."""
    rig = ready(PX4)
    rig.fly()
    assert rig.set_mode("OFFBOARD") == m.MAV_RESULT_TEMPORARILY_REJECTED
    rig.streaming, rig.period_s = (0.0, 0.0, 0.0, 0.0), 0.7
    rig.run(3.0)
    assert rig.set_mode("OFFBOARD") == m.MAV_RESULT_TEMPORARILY_REJECTED
    rig.period_s = 0.1
    rig.run(0.5)
    assert rig.set_mode("OFFBOARD") == 0


def test_px4_holds_when_setpoints_stop_and_comes_back_by_itself() -> None:
    """COM_OF_LOSS_T 0.5 and hold: stopped 1.25 s after the loss, 0.4 m on; back within 20 ms."""
    rig = flying(PX4, parameters={"COM_OBL_RC_ACT": 5, "COM_OF_LOSS_T": 0.5})
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(4.0)
    rig.streaming = None
    rig.setpoint(0.5)
    since, lost_s = rig.pose, rig.t_s
    late_s = rig.until(lambda: rig.mode == "AUTO.LOITER", 2.0) - 0.5
    assert 0.02 < late_s < 0.14
    rig.until(lambda: still(rig), 3.0)
    assert rig.t_s - lost_s == pytest.approx(1.25, abs=0.3)
    assert travelled(rig, since) == pytest.approx(0.4, abs=0.12)
    rig.run(5.0)
    assert rig.mode == "AUTO.LOITER"
    rig.setpoint(0.3)
    rig.run(0.02)
    assert rig.mode == "OFFBOARD"


def test_px4_without_transmitter_descends_by_default_and_still_shows_offboard() -> None:
    """COM_OBL_RC_ACT 0: it descends and hardly brakes; after the landing: offboard, disarmed."""
    rig = flying(PX4)
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(4.0)
    rig.streaming = None
    since = rig.pose
    assert 0.9 < rig.until(lambda: rig.mode == "AUTO.LAND", 2.0) < 1.2
    rig.run(1.5)
    assert rig.height_m < 1.3
    assert rig.vehicle.state.airframe.speed_mps > 0.2
    rig.until(lambda: not rig.armed, 20.0)
    assert rig.mode == "OFFBOARD"
    assert travelled(rig, since) > 0.8


@pytest.mark.parametrize(("timeout_s", "stopped_s", "way_m"), [(3.0, 4.1, None), (0.5, 1.7, 0.54)])
def test_ardupilot_flies_on_and_turns_on_until_guid_timeout(
    timeout_s: float, stopped_s: float, way_m: float | None
) -> None:
    """The last earth velocity, while it keeps yawing; the mode does not change."""
    rig = flying(ARDUPILOT, parameters={"GUID_TIMEOUT": timeout_s})
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(4.0)
    rig.streaming = None
    rig.setpoint(0.5, yaw_rate=0.4)
    since, lost_s = rig.pose, rig.t_s
    rig.run(timeout_s - 0.1)
    assert rig.pose.yaw_rate_radps == pytest.approx(-0.39, abs=0.03)
    assert rig.pose.vx_mps == pytest.approx(0.42, abs=0.12)
    assert abs(rig.pose.vy_mps) < 0.1
    rig.until(lambda: still(rig), 3.0)
    assert rig.t_s - lost_s == pytest.approx(stopped_s, abs=0.3)
    if way_m is not None:
        assert travelled(rig, since) == pytest.approx(way_m, abs=0.1)
    rig.run(2.0)
    assert rig.mode == "GUIDED"
    assert rig.pose.yaw_rate_radps == pytest.approx(0.0, abs=0.01)


def test_ardupilot_surges_below_two_hertz_with_a_short_timeout() -> None:
    """5 Hz is enough, 1.5 Hz surges."""
    rig = flying(ARDUPILOT, parameters={"GUID_TIMEOUT": 0.5})

    def slowest(period_s: float) -> float:
        rig.period_s, rig.streaming = period_s, (0.5, 0.0, 0.0, 0.0)
        rig.run(4.0)
        speeds = []
        for _ in range(400):
            rig.run(0.01)
            speeds.append(rig.vehicle.state.airframe.speed_mps)
        return min(speeds)

    assert slowest(1.0 / 1.5) < slowest(0.2) - 0.03


@pytest.mark.parametrize(
    ("personality", "frame", "moves"),
    [(PX4, 8, True), (PX4, 12, False), (ARDUPILOT, 8, True), (ARDUPILOT, 9, True), (ARDUPILOT, 12, False)],
)
def test_body_frames(personality: Personality, frame: int, moves: bool) -> None:
    """Frames 8 and 9 behave alike on ArduPilot, frame 12 only hovers."""
    rig = flying(personality)
    rig.streaming, since = None, rig.pose
    for _ in range(30):
        rig.setpoint(0.5, frame=frame)
        rig.run(0.1)
    assert (travelled(rig, since) > 0.7) is moves


@BOTH
@pytest.mark.parametrize(
    "wrong",
    [{"mask": 0xDC7}, {"mask": 0}, {"system": 2}, {"vx": math.nan}, {"vz": math.inf}, {"vx": 1e6}, {"frame": 3}],
    ids=str,
)
def test_unusable_setpoints_change_nothing(personality: Personality, wrong: dict[str, float]) -> None:
    """Another mask, another vehicle, no number: as if nothing had come."""
    rig = flying(personality)
    target = rig.vehicle.state.target
    rig.setpoint(**({"vx": 0.5} | wrong))  # type: ignore[arg-type]
    assert rig.vehicle.state.target is target
    assert rig.vehicle.state.counts.total() == 1


@BOTH
def test_a_pilot_takes_over_and_setpoints_do_not_take_it_back(personality: Personality) -> None:
    """The application obeys at once."""
    rig = flying(personality)
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(2.0)
    rig.vehicle.pilot_takes_over()
    rig.run(3.0)
    assert rig.mode == {"px4": "POSCTL", "ardupilot": "LOITER"}[personality.name]
    assert rig.armed
    assert still(rig)


def test_ardupilot_cannot_be_armed_in_brake() -> None:
    """After `hold` it must be set to guided first."""
    rig = ready(ARDUPILOT)
    assert rig.set_mode("BRAKE") == 0
    assert rig.arm() == m.MAV_RESULT_FAILED
    rig.run(0.1)
    assert "Arm: BRAKE mode not armable" in rig.texts()
    assert rig.set_mode("GUIDED") == 0
    assert rig.arm() == 0


@BOTH
def test_disarming_in_the_air_is_refused(personality: Personality) -> None:
    """Only landing stops the motors."""
    rig = flying(personality)
    assert rig.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) != 0
    assert rig.armed


@BOTH
def test_a_pause_of_the_process_is_not_flown(personality: Personality) -> None:
    """A stopped stub must not catch up on minutes of flight at once."""
    rig = flying(personality)
    since = rig.pose
    rig.streaming = None
    rig.t_s += 60.0
    rig.run(0.05)
    assert travelled(rig, since) < 0.5
    assert rig.pose.t_s == pytest.approx(rig.t_s, abs=0.02)
