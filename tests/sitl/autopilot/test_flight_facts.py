"""How either autopilot flies, against what was measured on the real ones."""

from __future__ import annotations

import math

import pytest

from sitl.autopilot import ARDUPILOT, PX4, Personality
from sitl.autopilot.mavlink import dialect as m
from tests.sitl.autopilot.rig import flying, ready, still, travelled

BOTH = pytest.mark.parametrize("personality", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])


def test_px4_take_off_holds_early_and_creeps_up() -> None:
    """0.05 m 4.2 s after arming, 0.5 m after 5 s; HOLD at 0.9 m is not "height reached", 1.2 m takes 8.6 s."""
    rig = ready(PX4, parameters={"MIS_TAKEOFF_ALT": 1.5})
    assert rig.command(m.MAV_CMD_NAV_TAKEOFF, *[math.nan] * 7) == 0
    assert rig.arm() == 0
    begun_s = rig.t_s
    assert rig.until(lambda: rig.height_m > 0.05, 10.0) == pytest.approx(4.2, abs=0.3)
    rig.until(lambda: rig.height_m > 0.5, 10.0)
    assert rig.t_s - begun_s == pytest.approx(5.0, abs=0.3)
    rig.until(lambda: rig.mode == "AUTO.LOITER", 10.0)
    assert rig.height_m == pytest.approx(0.9, abs=0.1)
    rig.until(lambda: rig.height_m > 1.2, 10.0)
    assert 7.0 < rig.t_s - begun_s < 9.0
    rig.until(lambda: rig.height_m > 1.4, 10.0)


def test_px4_needs_5_s_to_lift_off_in_offboard_and_thinks_that_it_flies_before() -> None:
    """A climb setpoint of 0.3 m/s: "Takeoff detected" 1.9 s after arming, 0.05 m 5.4 s, 0.5 m 7.4 s, 1.2 m 9.7 s."""
    rig = ready(PX4)
    rig.streaming = (0.0, 0.0, -0.3, 0.0)
    rig.run(0.5)
    assert rig.set_mode("OFFBOARD") == 0
    assert rig.arm() == 0
    begun_s = rig.t_s
    assert rig.until(lambda: "Takeoff detected\t" in rig.texts(), 5.0) == pytest.approx(1.9, abs=0.1)
    for height_m, after_s in ((0.05, 5.4), (0.5, 7.4), (1.2, 9.7)):
        rig.until(lambda height_m=height_m: rig.height_m > height_m, 10.0)
        assert rig.t_s - begun_s == pytest.approx(after_s, abs=0.4)


def test_px4_spools_up_and_ramps_as_its_parameters_say() -> None:
    """COM_SPOOLUP_TIME and MPC_TKO_RAMP_T together can take longer than COM_DISARM_PRFLT leaves."""
    rig = ready(PX4, parameters={"COM_SPOOLUP_TIME": 5.0, "MPC_TKO_RAMP_T": 5.0})
    rig.streaming = (0.0, 0.0, -0.3, 0.0)
    rig.run(0.5)
    assert rig.set_mode("OFFBOARD") == 0
    assert rig.arm() == 0
    assert rig.until(lambda: not rig.armed, 12.0) == pytest.approx(10.0, abs=0.2)
    assert rig.height_m == 0.0


def test_ardupilot_take_off_takes_under_five_seconds() -> None:
    """Moves after 2.7 s, 1.5 m at 4.75 s, 1.57 at most; "on the ground" and STANDBY until 3.1 s; stays GUIDED."""
    rig = ready(ARDUPILOT)
    assert rig.set_mode("GUIDED") == 0
    assert rig.arm() == 0
    assert rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 245, 10_000) == 0
    assert rig.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.5) == 0
    begun_s = rig.t_s
    assert rig.until(lambda: rig.height_m > 0.01, 5.0) == pytest.approx(2.7, abs=0.1)
    rig.until(lambda: rig.newest("EXTENDED_SYS_STATE").landed_state != m.MAV_LANDED_STATE_ON_GROUND, 5.0)
    assert rig.t_s - begun_s == pytest.approx(3.1, abs=0.2)
    assert ARDUPILOT.system_status(rig.vehicle.state) == m.MAV_STATE_ACTIVE
    assert {x.system_status for t, x in rig.received if t < rig.t_s - 0.01 and x.get_type() == "HEARTBEAT"} == {3}
    rig.until(lambda: rig.height_m >= 1.5, 10.0)
    assert rig.t_s - begun_s == pytest.approx(4.75, abs=0.3)
    heights = []
    for _ in range(200):
        rig.run(0.01)
        heights.append(rig.height_m)
    assert max(heights) == pytest.approx(1.57, abs=0.03)
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
    """COM_OF_LOSS_T 0.5 and hold: 0.42 m after 1.3 s, 0.5 in the end; back within 20 ms."""
    rig = flying(PX4, parameters={"COM_OBL_RC_ACT": 5, "COM_OF_LOSS_T": 0.5})
    rig.streaming = (0.41, 0.0, 0.0, 0.0)
    rig.run(4.0)
    rig.streaming = None
    rig.setpoint(0.41)
    since, lost_s = rig.pose, rig.t_s
    late_s = rig.until(lambda: rig.mode == "AUTO.LOITER", 2.0) - 0.5
    assert 0.02 < late_s < 0.14
    rig.run(lost_s + 1.3 - rig.t_s)
    assert travelled(rig, since) == pytest.approx(0.42, abs=0.04)
    rig.run(5.0)
    assert travelled(rig, since) == pytest.approx(0.5, abs=0.05)
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


@pytest.mark.parametrize(("timeout_s", "stopped_s", "way_m"), [(3.0, 4.1, None), (0.5, 1.5, 0.54)])
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
    assert rig.pose.vx_mps == pytest.approx(0.507, abs=0.03)
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
    [(PX4, 8, 1.2), (PX4, 12, 0.05), (ARDUPILOT, 8, 1.2), (ARDUPILOT, 9, 1.2), (ARDUPILOT, 12, 0.6)],
)
def test_body_frames(personality: Personality, frame: int, moves: float) -> None:
    """Frames 8 and 9 behave alike on ArduPilot; in frame 12 it does not fly what is asked, and drifts at 0.25 m/s."""
    rig = flying(personality)
    rig.streaming, since = None, rig.pose
    for _ in range(30):
        rig.setpoint(0.5, frame=frame)
        rig.run(0.1)
    assert travelled(rig, since) == pytest.approx(moves, abs=0.15)


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
