"""What the real ArduCopter answers, when its estimator gives up, and what it does with its battery and transmitter."""

from __future__ import annotations

import math

import pytest

from companion.model import Pose
from sitl.autopilot import ARDUPILOT
from sitl.autopilot.airframe import Surroundings
from sitl.autopilot.mavlink import dialect as m
from tests.sitl.autopilot.rig import Rig, command_long, flying, ready, travelled

EKF_REPORT = 193


def pause(rig: Rig, to_continue: bool, component: int = 1) -> list[int]:
    """DO_PAUSE_CONTINUE, as the button of a ground station sends it."""
    values = [float(to_continue), *[0.0] * 6]
    message = m.MAVLink_command_long_message(1, component, m.MAV_CMD_DO_PAUSE_CONTINUE, 0, *values)
    return rig.results(message, (255, 190))


def without_gps() -> Rig:
    """Fed with odometry, at its height in guided, with reports of its estimator."""
    rig = Rig(ARDUPILOT, gps=False)
    rig.feeding = "frd"
    rig.send(m.MAVLink_set_gps_global_origin_message(1, 473977420, 85455940, 489400))
    rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, EKF_REPORT, 100_000)
    rig.run(3.0)
    rig.fly()
    rig.offboard()
    return rig


@pytest.mark.parametrize("component", [1, 0, 191, 192], ids=["itself", "all", "191", "192"])
def test_a_pause_freezes_guided_silently_and_on_continue_it_flies_at_once(component: int) -> None:
    """ACK 0, no text, mode still GUIDED; the same for one to a component that it has heard nowhere."""
    rig = flying(ARDUPILOT)
    rig.streaming = (0.42, 0.0, 0.0, 0.0)
    rig.run(3.0)
    texts = len(rig.texts())
    assert pause(rig, False, component) == [m.MAV_RESULT_ACCEPTED]
    rig.run(2.0)
    since = rig.pose
    rig.run(5.0)
    assert travelled(rig, since) < 0.1
    assert (rig.mode, len(rig.texts())) == ("GUIDED", texts)
    assert pause(rig, True, component) == [m.MAV_RESULT_ACCEPTED]
    rig.run(2.0)
    assert rig.vehicle.state.airframe.speed_mps > 0.35


def test_what_is_for_a_component_that_was_heard_is_not_carried_out() -> None:
    """It goes on there instead; PX4 never carries it out."""
    rig = flying(ARDUPILOT)
    message = m.MAVLink_command_long_message(1, 191, m.MAV_CMD_NAV_LAND, 0, *[0.0] * 7)
    assert rig.vehicle.receive(message, rig.t_s, routed=True) == []
    assert rig.mode == "GUIDED"


def test_another_mode_ends_a_pause_and_cannot_be_paused() -> None:
    """Result 4 outside guided; guided anew follows setpoints."""
    rig = flying(ARDUPILOT)
    assert pause(rig, False) == [0]
    assert rig.set_mode("LOITER") == 0
    assert pause(rig, False) == [m.MAV_RESULT_FAILED]
    assert rig.set_mode("GUIDED") == 0
    rig.streaming = (0.42, 0.0, 0.0, 0.0)
    rig.run(2.0)
    assert rig.vehicle.state.airframe.speed_mps > 0.35


def test_a_mode_that_there_is_not_fails_with_a_text() -> None:
    """Result 4 and "No such mode 99"."""
    rig = ready(ARDUPILOT)
    assert rig.results(command_long(m.MAV_CMD_DO_SET_MODE, 1.0, 99.0)) == [m.MAV_RESULT_FAILED]
    rig.run(0.1)
    assert "No such mode 99" in rig.texts()


def test_a_heartbeat_leaves_at_once_with_a_mode_change() -> None:
    """Not with the next second."""
    rig = ready(ARDUPILOT)
    rig.run(0.35)
    assert rig.set_mode("GUIDED") == 0
    beats = [x for x in rig.run(0.02) if x.get_type() == "HEARTBEAT"]
    assert [x.custom_mode for x in beats] == [4]


def test_base_modes() -> None:
    """89 guided, 217 armed in it, 209 in ALT_HOLD, 81 in STABILIZE."""
    rig = ready(ARDUPILOT)
    assert ARDUPILOT.base_mode(rig.vehicle.state) == 81
    rig.set_mode("GUIDED")
    rig.run(0.1)
    assert rig.newest("HEARTBEAT").base_mode == 89
    rig.fly()
    assert rig.newest("HEARTBEAT").base_mode == 217
    assert rig.set_mode("ALT_HOLD") == 0
    rig.run(0.1)
    assert rig.newest("HEARTBEAT").base_mode == 209


def test_guided_that_is_set_before_ready_falls_back() -> None:
    """ACK 0, then the switch's mode."""
    rig = Rig(ARDUPILOT, boot_s=None)
    rig.run(1.0)
    assert rig.set_mode("GUIDED") == 0
    assert rig.mode == "GUIDED"
    rig.run(2.0)
    assert rig.mode == "STABILIZE"
    assert "ArduPilot Ready" in rig.texts()


def test_refusals_without_a_word() -> None:
    """A take-off disarmed or in the air, disarming in the air: result 4, no text."""
    rig = ready(ARDUPILOT)
    rig.set_mode("GUIDED")
    rig.run(0.1)
    before = len(rig.texts())
    assert rig.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.5) == m.MAV_RESULT_FAILED
    rig.fly()
    assert rig.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.5) == m.MAV_RESULT_FAILED
    assert rig.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0.0) == m.MAV_RESULT_FAILED
    rig.run(0.1)
    assert rig.texts()[before:] == ["Arming motors"]


def test_the_pre_arm_bit_is_false_until_it_would_arm() -> None:
    """SYS_STATUS bit 28; its own texts say why, every 30 s."""
    rig = Rig(ARDUPILOT, boot_s=None)
    rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 1, 500_000)
    rig.run(40.0)
    assert not rig.newest("SYS_STATUS").onboard_control_sensors_health & m.MAV_SYS_STATUS_PREARM_CHECK
    assert {"PreArm: Gyros inconsistent", "PreArm: Need Position Estimate"} <= set(rig.texts())
    rig.run(4.0)
    assert rig.newest("SYS_STATUS").onboard_control_sensors_health & m.MAV_SYS_STATUS_PREARM_CHECK


@pytest.mark.parametrize("what", ["odometry", "GPS"])
def test_aiding_lost_shows_7_s_late_and_lands_at_8_s(what: str) -> None:
    """Flags stay, variances freeze to the bit, it drifts meanwhile; then texts, LAND, CRITICAL."""
    if what == "odometry":
        rig = without_gps()
        rig.feeding = None
    else:
        rig = flying(ARDUPILOT)
        rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, EKF_REPORT, 100_000)
        rig.run(1.0)
        rig.vehicle.set_gps(False)
    lost_s, since = rig.t_s, rig.pose
    aided = {x.velocity_variance for _, x in rig.received if x.get_type() == "EKF_STATUS_REPORT"}
    assert len(aided) > 5
    rig.run(0.5)
    frozen = {(x.velocity_variance, x.pos_horiz_variance, x.flags) for x in rig.run(6.4) if hasattr(x, "flags")}
    assert len(frozen) == 1
    assert rig.newest("EKF_STATUS_REPORT").flags == 0x33F
    assert 0.5 < travelled(rig, since) < 1.3
    rig.until(lambda: rig.newest("EKF_STATUS_REPORT").flags == 0x25, 2.0)
    assert rig.t_s - lost_s == pytest.approx(7.15, abs=0.15)
    assert rig.mode == "GUIDED"
    rig.until(lambda: rig.mode == "LAND", 2.0)
    assert rig.t_s - lost_s == pytest.approx(8.0, abs=0.1)
    rig.run(0.1)
    assert rig.texts()[-4:] == ["EKF3 lane switch 1", "EKF primary changed:1", "EKF variance", "EKF Failsafe"]
    beat = rig.newest("HEARTBEAT")
    assert (beat.base_mode, beat.system_status) == (209, m.MAV_STATE_CRITICAL)
    rig.until(lambda: not rig.armed, 20.0)


@pytest.mark.parametrize(("action", "mode"), [(0, "GUIDED"), (1, "LAND"), (2, "RTL")])
def test_a_low_battery_is_one_of_low_voltage(action: int, mode: str) -> None:
    """After 10 s below BATT_LOW_VOLT; by default the action is none."""
    rig = flying(ARDUPILOT, parameters={"BATT_FS_LOW_ACT": action}, battery_percent=50.0)
    rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 147, 100_000)
    rig.run(0.2)
    status = rig.newest("BATTERY_STATUS")
    assert status.charge_state == m.MAV_BATTERY_CHARGE_STATE_OK
    # It counts what is drawn, from 100 % at boot whatever was in it.
    assert status.battery_remaining > 95
    rig.vehicle.state.battery.measured_v = 10.2
    rig.run(9.0)
    assert rig.newest("BATTERY_STATUS").charge_state == m.MAV_BATTERY_CHARGE_STATE_OK
    rig.run(1.5)
    low, failsafe = rig.texts()[-2:]
    assert low.startswith("Battery 1 is low 10.20V used ")
    assert low.endswith(" mAh")
    assert failsafe == "Battery Failsafe"
    assert rig.newest("BATTERY_STATUS").charge_state == m.MAV_BATTERY_CHARGE_STATE_LOW
    assert rig.mode == mode
    rig.run(1.0)
    assert rig.newest("HEARTBEAT").system_status == m.MAV_STATE_CRITICAL


def test_percent_alone_triggers_nothing() -> None:
    """There is no threshold of it."""
    rig = flying(ARDUPILOT, parameters={"BATT_FS_LOW_ACT": 1})
    rig.vehicle.state.battery.measured_v = 12.0
    rig.vehicle.state.battery.percent = 5.0
    rig.run(15.0)
    assert rig.mode == "GUIDED"


@pytest.mark.parametrize(
    ("parameters", "mode", "text"),
    [
        ({}, "RTL", "Radio Failsafe"),
        ({"FS_THR_ENABLE": 3}, "LAND", "Radio Failsafe"),
        ({"FS_THR_ENABLE": 0}, "GUIDED", "Radio Failsafe"),
        ({"FS_OPTIONS": 4}, "GUIDED", "Radio Failsafe - Continuing Guided Mode"),
    ],
    ids=str,
)
def test_a_transmitter_that_is_lost(parameters: dict[str, float], mode: str, text: str) -> None:
    """Its simulator has one; by default the vehicle returns, which climbs first."""
    rig = flying(ARDUPILOT, parameters=parameters)
    rig.vehicle.set_transmitter(False)
    rig.run(1.0)
    assert (rig.mode, rig.texts()[-1]) == (mode, text)
    assert rig.newest("HEARTBEAT").system_status == m.MAV_STATE_CRITICAL
    rig.vehicle.set_transmitter(True)
    rig.run(1.1)
    assert rig.texts()[-1] == "Radio Failsafe Cleared"
    assert rig.newest("HEARTBEAT").system_status == m.MAV_STATE_ACTIVE
    assert rig.mode == mode


@pytest.mark.parametrize(("enable", "mode"), [(0, "GUIDED"), (1, "RTL"), (5, "LAND")])
def test_a_ground_station_that_falls_silent(enable: int, mode: str) -> None:
    """FS_GCS_ENABLE, after FS_GCS_TIMEOUT."""
    rig = flying(ARDUPILOT, parameters={"FS_GCS_ENABLE": enable})
    rig.send(m.MAVLink_heartbeat_message(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3), (255, 190))
    rig.run(4.9)
    assert rig.mode == "GUIDED"
    rig.run(0.5)
    assert rig.mode == mode


def test_a_return_climbs_to_rtl_alt_and_comes_home() -> None:
    """At 1.5 m/s to 15 m: through the roof of a mine."""
    rig = flying(ARDUPILOT)
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(8.0)
    rig.streaming = None
    assert rig.command(m.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    before_m = rig.height_m
    rig.run(4.0)
    assert rig.height_m - before_m == pytest.approx(5.4, abs=0.6)
    rig.until(lambda: rig.height_m > 14.0, 10.0)
    rig.until(lambda: not rig.armed, 60.0)
    assert math.hypot(rig.pose.x_m, rig.pose.y_m) < 0.6


def test_a_return_in_a_mine_hits_the_roof() -> None:
    """What there is to be feared."""
    roof = Surroundings(lambda _x, _y, _z: 0.0, lambda _x, _y, z: max(0.0, min(3.0 - z, 2.0)))
    rig = flying(ARDUPILOT, start=Pose(0.0, 0.0, 0.0, 0.0, 0.0), surroundings=roof)
    assert rig.command(m.MAV_CMD_NAV_RETURN_TO_LAUNCH) == 0
    rig.run(5.0)
    assert rig.vehicle.state.airframe.contacts == 1
