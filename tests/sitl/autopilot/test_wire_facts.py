"""What either autopilot says without flying: heartbeat, parameters, rates, answers."""

from __future__ import annotations

import math
import struct
from collections import Counter

import pytest

from companion.errors import InputError
from companion.frames import pose_to_ned
from companion.model import Pose
from sitl.autopilot import ARDUPILOT, PX4, Personality
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.origin import to_world
from tests.sitl.autopilot.rig import Rig, odometry

BOTH = pytest.mark.parametrize("personality", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])


@BOTH
def test_heartbeat_names_the_autopilot_and_its_mode_once_a_second(personality: Personality) -> None:
    """MAVSDK finds out from it what it talks to."""
    rig = Rig(personality)
    beats = [x for x in rig.run(10.0) if x.get_type() == "HEARTBEAT"]
    assert len(beats) in (10, 11)
    expected = {"px4": (12, 4 << 16 | 3 << 24), "ardupilot": (3, 0)}[personality.name]
    assert (beats[-1].autopilot, beats[-1].custom_mode) == expected
    assert beats[-1].type == m.MAV_TYPE_QUADROTOR
    assert not beats[-1].base_mode & m.MAV_MODE_FLAG_SAFETY_ARMED


def test_px4_sends_what_was_measured_unasked() -> None:
    """As on port 14540; the truth comes at 50 Hz, where the real one sends it on another port only."""
    rig = Rig(PX4)
    rig.run(2.0)
    counted = Counter(x.get_type() for x in rig.run(10.0))
    for name, rate in {
        "LOCAL_POSITION_NED": 30, "ATTITUDE": 99, "DISTANCE_SENSOR": 10, "GLOBAL_POSITION_INT": 50, "GPS_RAW_INT": 8,
        "SYS_STATUS": 5, "EXTENDED_SYS_STATE": 5, "ODOMETRY": 30, "HIGHRES_IMU": 50, "ATTITUDE_QUATERNION": 50,
        "GPS_GLOBAL_ORIGIN": 1,
    }.items():  # fmt: skip
        assert counted[name] == pytest.approx(10 * rate, abs=2), name
    assert counted["HIL_STATE_QUATERNION"] == pytest.approx(500, abs=2)
    assert counted["TIMESYNC"] == pytest.approx(100, abs=2)


def test_ardupilot_sends_only_three_unasked() -> None:
    """An application that does not ask must not find its telemetry here and miss it on the vehicle."""
    rig = Rig(ARDUPILOT)
    rig.run(1.0)
    rig.arm()
    counted = Counter(x.get_type() for x in rig.run(20.0))
    assert set(counted) == {"HEARTBEAT", "STATUSTEXT", "TIMESYNC"}
    assert counted["TIMESYNC"] == 4


@BOTH
def test_interval_is_kept_exactly_and_can_be_taken_back(personality: Personality) -> None:
    """50 Hz came exactly; 0 is the default again, -1 is off."""
    rig = Rig(personality)
    rig.run(2.0)
    assert rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 20_000) == 0
    assert sum(x.get_type() == "ATTITUDE" for x in rig.run(4.0)) == pytest.approx(200, abs=1)
    assert rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 30, -1) == 0
    assert not any(x.get_type() == "ATTITUDE" for x in rig.run(1.0))
    assert rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 0) == 0
    default = 99 if personality is PX4 else 0
    assert sum(x.get_type() == "ATTITUDE" for x in rig.run(1.0)) == pytest.approx(default, abs=2)


def test_odometry_comes_from_px4_and_is_denied_by_ardupilot() -> None:
    """`set_rate_odometry` denied, as measured."""
    px4, ardupilot = Rig(PX4), Rig(ARDUPILOT)
    assert px4.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 331, 33_333) == 0
    assert any(x.get_type() == "ODOMETRY" for x in px4.run(0.2))
    assert ardupilot.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 331, 33_333) == m.MAV_RESULT_DENIED
    ardupilot.run(0.1)
    assert "No ap_message for mavlink id (331)" in ardupilot.texts()
    assert px4.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 9_999, 33_333) == m.MAV_RESULT_FAILED
    assert not any(x.get_type() == "ODOMETRY" for x in ardupilot.run(0.2))


def test_ardupilot_keeps_its_position_to_itself_until_it_has_one() -> None:
    """LOCAL_POSITION_NED is silent until there is a position."""
    rig = Rig(ARDUPILOT, gps=False)
    rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 32, 20_000)
    assert not any(x.get_type() == "LOCAL_POSITION_NED" for x in rig.run(2.0))
    rig.send(m.MAVLink_set_gps_global_origin_message(1, 473977420, 85455940, 489400))
    rig.feeding = "frd"
    assert sum(x.get_type() == "LOCAL_POSITION_NED" for x in rig.run(2.0)) > 90


@BOTH
def test_version_comes_when_asked_for_and_names_the_encoding(personality: Personality) -> None:
    """MAVSDK decides by it how integers travel."""
    rig = Rig(personality)
    ack, version = rig.send(m.MAVLink_command_long_message(1, 1, m.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0))
    assert ack.result == 0
    bytewise = bool(version.capabilities & m.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE)
    c_cast = bool(version.capabilities & m.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST)
    assert (bytewise, c_cast) == ((True, False) if personality is PX4 else (False, True))


@BOTH
def test_unknown_command_is_answered_as_unsupported(personality: Personality) -> None:
    """Silence would cost the caller its time-out."""
    rig = Rig(personality)
    assert rig.command(31_999) == m.MAV_RESULT_UNSUPPORTED
    answers = rig.send(m.MAVLink_command_int_message(1, 1, 0, 31_999, 0, 0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0))
    assert answers[0].result == m.MAV_RESULT_UNSUPPORTED


@BOTH
def test_commands_to_other_vehicles_get_no_answer(personality: Personality) -> None:
    """Several vehicles share a port range."""
    rig = Rig(personality)
    rig.run(2.0)
    assert rig.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1.0, system=2) == -1
    assert not rig.armed
    assert rig.vehicle.state.counts["for another system"] == 1


@BOTH
def test_timesync_is_answered_with_own_time(personality: Personality) -> None:
    """The application aligns its clock by it."""
    rig = Rig(personality)
    rig.run(1.5)
    (answer,) = rig.send(m.MAVLink_timesync_message(0, 123_456))
    assert answer.ts1 == 123_456
    assert answer.tc1 * 1e-9 == pytest.approx(1.5, abs=0.02)


@BOTH
def test_parameters_are_listed_completely_and_found_by_name_and_index(personality: Personality) -> None:
    """Pre-flight reads them by name, ground stations by list."""
    rig = Rig(personality)
    rig.send(m.MAVLink_param_request_list_message(1, 1))
    listed = [x for x in rig.run(2.0) if x.get_type() == "PARAM_VALUE"]
    assert [x.param_index for x in listed] == list(range(len(personality.parameters)))
    assert {x.param_count for x in listed} == {len(listed)}
    (by_name,) = rig.send(m.MAVLink_param_request_read_message(1, 1, listed[3].param_id.encode(), -1))
    (by_index,) = rig.send(m.MAVLink_param_request_read_message(1, 1, b"", 3))
    assert by_name.param_id == by_index.param_id == listed[3].param_id


@BOTH
def test_unknown_parameters_get_no_answer(personality: Personality) -> None:
    """As on the real ones: the caller runs into its time-out."""
    rig = Rig(personality)
    assert rig.send(m.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1)) == []
    assert rig.send(m.MAVLink_param_request_read_message(1, 1, b"", 9999)) == []
    assert rig.send(m.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9)) == []
    assert rig.vehicle.state.counts["unknown parameter"] == 3


def test_px4_integers_travel_as_bytes() -> None:
    """5 is not the float 5.0 on the wire."""
    rig = Rig(PX4)
    field = struct.unpack("<f", struct.pack("<i", 5))[0]
    (answer,) = rig.send(m.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", field, m.MAV_PARAM_TYPE_INT32))
    assert struct.unpack("<i", struct.pack("<f", answer.param_value))[0] == 5
    assert rig.vehicle.state.parameters["COM_OBL_RC_ACT"] == 5
    assert rig.send(m.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", 4.0, m.MAV_PARAM_TYPE_REAL32)) == []
    assert rig.vehicle.state.parameters["COM_OBL_RC_ACT"] == 5


def test_ardupilot_integers_travel_as_numbers() -> None:
    """Whatever type the sender claims, and not beyond what the own type holds."""
    rig = Rig(ARDUPILOT)
    (answer,) = rig.send(m.MAVLink_param_set_message(1, 1, b"AVOID_ENABLE", 7.0, m.MAV_PARAM_TYPE_REAL32))
    assert (answer.param_value, answer.param_type) == (7.0, m.MAV_PARAM_TYPE_INT8)
    assert rig.send(m.MAVLink_param_set_message(1, 1, b"AVOID_ENABLE", 1e9, m.MAV_PARAM_TYPE_REAL32)) == []
    assert rig.send(m.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", math.nan, m.MAV_PARAM_TYPE_REAL32)) == []
    assert rig.vehicle.state.parameters["AVOID_ENABLE"] == 7
    kinds = {"FS_OPTIONS": 6, "GUID_OPTIONS": 6, "ARMING_CHECK": 6, "MAV_SYSID": 4, "PSC_JERK_XY": 9, "WPNAV_ACCEL": 9}
    for name, kind in kinds.items():
        (answer,) = rig.send(m.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
        assert answer.param_type == kind, name


@BOTH
def test_wrong_parameters_of_the_command_line_are_refused(personality: Personality) -> None:
    """A typing error must not leave a vehicle with its defaults."""
    with pytest.raises(InputError, match="NO_SUCH"):
        Rig(personality, parameters={"NO_SUCH": 1.0})


@BOTH
def test_truth_leads_back_to_world_metres(personality: Personality) -> None:
    """The process that renders the world flies by these messages."""
    rig = Rig(personality, Pose(0.0, 12.3, -4.5, 6.7, 0.8))
    number = m.MAVLINK_MSG_ID_HIL_STATE_QUATERNION if personality is PX4 else m.MAVLINK_MSG_ID_SIM_STATE
    assert rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, number, 20_000) == 0
    rig.run(0.1)
    if personality is PX4:
        truth = rig.newest("HIL_STATE_QUATERNION")
        found = to_world(truth.lat, truth.lon, truth.alt)
        q = truth.attitude_quaternion
    else:
        truth = rig.newest("SIM_STATE")
        found = to_world(truth.lat_int, truth.lon_int, truth.alt * 1e3)
        q = [truth.q1, truth.q2, truth.q3, truth.q4]
    assert found == pytest.approx((12.3, -4.5, 6.7), abs=0.012)
    assert 2.0 * math.atan2(q[3], q[0]) == pytest.approx(pose_to_ned(rig.pose).yaw_rad, abs=1e-6)


def test_local_frame_begins_where_the_vehicle_booted() -> None:
    """Not where the world's origin is."""
    rig = Rig(PX4, Pose(0.0, 50.0, 60.0, 7.0, 0.3))
    rig.run(2.0)
    at = rig.newest("LOCAL_POSITION_NED")
    assert math.dist((at.x, at.y, at.z), (0.0, 0.0, 0.0)) < 0.1


@BOTH
def test_reboot_is_refused_when_armed_and_begins_anew_else(personality: Personality) -> None:
    """The clock of the telemetry starts again: poses before and after must not be mixed."""
    rig = Rig(personality)
    rig.run(2.0)
    rig.fly()
    assert rig.command(m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) != 0
    assert rig.command(m.MAV_CMD_NAV_LAND) == 0
    rig.until(lambda: not rig.armed, 30.0)
    assert rig.command(m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == 0
    rig.run(0.5)
    assert rig.vehicle.state.since_boot_s == pytest.approx(0.5, abs=0.02)


@BOTH
def test_missions_are_tolerated(personality: Personality) -> None:
    """A ground station asks for one as soon as it connects."""
    (answer,) = Rig(personality).send(m.MAVLink_mission_request_list_message(1, 1))
    assert (answer.get_type(), answer.count) == ("MISSION_COUNT", 0)


def test_px4_ignores_odometry_stamped_with_another_clock_once_synchronised() -> None:
    """With timesync converged, the companion's monotonic clock was off by 2534 s."""
    rig = Rig(PX4, gps=False)
    rig.run(1.0)
    for _ in range(600):
        rig.send(m.MAVLink_timesync_message(round((rig.t_s + 2534.0) * 1e9), round(rig.t_s * 1e9)))
    rig.send(odometry(1.0, 0.0, 0.0, stamp_us=round(rig.t_s * 1e6)))
    assert rig.vehicle.state.counts["odometry stamped with another clock"] == 1
    assert rig.vehicle.state.estimator.fed_s is None
    rig.send(odometry(1.0, 0.0, 0.0, stamp_us=round((rig.t_s + 2534.0) * 1e6)))
    assert rig.vehicle.state.estimator.fed_s is not None
