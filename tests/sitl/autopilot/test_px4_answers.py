"""What the real PX4 answers, on which connections and how often, and what of it the application cannot hear."""

from __future__ import annotations

import math
from typing import Any

import pytest

from sitl.autopilot import PX4
from sitl.autopilot.events import event_id
from sitl.autopilot.mavlink import dialect as m
from tests.sitl.autopilot.rig import Rig, command_long, flying, ready

ORIGIN = m.MAVLink_set_gps_global_origin_message(1, 473977420, 85455940, 489400)


def flags(rig: Rig) -> int:
    """Of the newest ESTIMATOR_STATUS."""
    rig.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 230, 20_000)
    rig.run(0.1)
    return int(rig.newest("ESTIMATOR_STATUS").flags)


def fed(kind: str, origin: bool, **options: Any) -> Rig:
    """Without GPS, with odometry in these axes, and an origin or none."""
    rig = Rig(PX4, gps=False, **options)
    rig.feeding = kind
    if origin:
        rig.send(ORIGIN)
    rig.run(6.0)
    return rig


def offboard_in_the_air(rig: Rig) -> None:
    """By a climb setpoint, as without a hold."""
    rig.streaming = (0.0, 0.0, -0.5, 0.0)
    rig.run(0.5)
    assert rig.set_mode("OFFBOARD") == 0
    assert rig.arm() == 0
    rig.until(lambda: rig.height_m > 1.5, 12.0)
    rig.streaming = (0.0, 0.0, 0.0, 0.0)
    rig.run(1.0)


def test_estimator_flag_128_says_that_it_is_at_rest() -> None:
    """1023 with GPS, 511 with odometry, 229 without either; in the air 895 and 383."""
    rig = ready(PX4)
    assert flags(rig) == 1023
    rig.fly()
    assert flags(rig) == 895
    assert flags(Rig(PX4, gps=False)) == 229
    rig = fed("frd", origin=False)
    assert flags(rig) == 511
    offboard_in_the_air(rig)
    assert flags(rig) == 383


@pytest.mark.parametrize(
    ("kind", "origin", "flies_off"), [("frd", True, True), ("frd", False, False), ("ned", True, False)]
)
@pytest.mark.parametrize("by", ["LAND", "its own failsafe"])
def test_landing_flies_to_latitude_zero_with_an_origin_but_axes_of_its_own(
    kind: str, origin: bool, flies_off: bool, by: str
) -> None:
    """At 4 m/s, whoever orders it: there is no place to land at but the one that was never written."""
    rig = fed(kind, origin, parameters={"COM_OBL_RC_ACT": 4, "COM_OF_LOSS_T": 0.5})
    offboard_in_the_air(rig)
    since = rig.pose
    if by == "LAND":
        assert rig.command(m.MAV_CMD_NAV_LAND) == 0
    else:
        rig.streaming = None
    fastest_mps = 0.0
    while rig.armed:
        rig.run(0.1)
        fastest_mps = max(fastest_mps, rig.vehicle.state.airframe.speed_mps)
        assert rig.t_s < 60.0
    way_m = math.hypot(rig.pose.x_m - since.x_m, rig.pose.y_m - since.y_m)
    if flies_off:
        assert way_m > 5.0
        assert fastest_mps == pytest.approx(4.0, abs=0.4)
        # Seen from Europe 0/0 is south and a little west, by axes whose north is the nose at the start: backwards.
        assert rig.pose.x_m < since.x_m - 4.0
    else:
        assert way_m < 0.3


def test_mpc_xy_cruise_slows_the_flight_to_latitude_zero() -> None:
    """A second line of defence."""
    rig = fed("frd", origin=True, parameters={"MPC_XY_CRUISE": 0.5})
    offboard_in_the_air(rig)
    since = rig.pose
    assert rig.command(m.MAV_CMD_NAV_LAND) == 0
    rig.until(lambda: not rig.armed, 20.0)
    assert 0.5 < math.hypot(rig.pose.x_m - since.x_m, rig.pose.y_m - since.y_m) < 3.0


def test_an_origin_alone_is_no_global_position() -> None:
    """GPS_GLOBAL_ORIGIN comes once a second then, GLOBAL_POSITION_INT not at all: so it can be told before a flight."""
    rig = fed("frd", origin=True)
    names = [x.get_type() for x in rig.run(5.0)]
    assert names.count("GPS_GLOBAL_ORIGIN") == 5
    assert "GLOBAL_POSITION_INT" not in names
    assert rig.command(m.MAV_CMD_REQUEST_MESSAGE, 49) == 0
    assert "GPS_GLOBAL_ORIGIN" not in {x.get_type() for x in fed("frd", origin=False).run(3.0)}
    assert "GLOBAL_POSITION_INT" in {x.get_type() for x in fed("ned", origin=True).run(1.0)}


def test_a_second_origin_of_another_altitude_shifts_the_height_at_once() -> None:
    """The altitude stays, the height above the origin does not."""
    rig = fed("frd", origin=True)
    before_m = rig.newest("LOCAL_POSITION_NED").z
    rig.send(m.MAVLink_set_gps_global_origin_message(1, 473977420, 85455940, 489400 + 1390))
    rig.run(1.0)
    assert rig.newest("LOCAL_POSITION_NED").z - before_m == pytest.approx(1.39, abs=0.06)


def test_a_mode_is_acknowledged_when_it_is_received_and_again_with_the_result() -> None:
    """The last one counts; it comes 4 to 12 ms later."""
    rig = flying(PX4)
    rig.streaming = None
    rig.run(2.0)
    message = command_long(m.MAV_CMD_DO_SET_MODE, 1.0, 6.0)
    assert [x.result for x in rig.send(message)] == [m.MAV_RESULT_ACCEPTED]
    asked_s = rig.t_s
    later = [x for x in rig.run(0.05) if x.get_type() == "COMMAND_ACK"]
    assert [x.result for x in later] == [m.MAV_RESULT_TEMPORARILY_REJECTED]
    assert (later[0].target_system, later[0].target_component) == (1, 191)
    acknowledged_s = next(t for t, x in reversed(rig.received) if x.get_type() == "COMMAND_ACK")
    assert 0.004 <= acknowledged_s - asked_s <= 0.0121
    assert rig.results(command_long(m.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0)) == [0, 0]
    assert rig.results(command_long(m.MAV_CMD_NAV_LAND)) == [0]


def test_a_refused_mode_gets_words_only_where_mission_planner_asked() -> None:
    """Others hear a tone. A take-off that is refused gets them whoever asked."""
    rig = flying(PX4)
    position = command_long(m.MAV_CMD_DO_SET_MODE, 1.0, 3.0)
    assert rig.results(position) == [0, m.MAV_RESULT_TEMPORARILY_REJECTED]
    rig.run(0.1)
    assert not [text for text in rig.texts() if text.startswith("Switching")]
    assert rig.results(position, (255, 190)) == [0, m.MAV_RESULT_TEMPORARILY_REJECTED]
    rig.run(0.1)
    assert "Switching to Position is currently not available\t" in rig.texts()
    event = rig.newest("EVENT")
    assert event.id == event_id("commander_modeswitch_not_avail")
    assert bytes(event.arguments[:5]) == (3 << 16).to_bytes(4, "little") + b"\x02"
    assert event.log_levels == 6 << 4 | 2


def test_event_numbers_are_made_of_their_names() -> None:
    """24 bits of FNV-1a of the name, and the component above them; they count up, and wrap soon after boot."""
    # FNV-1a of "a" is 0xE40C292C.
    assert event_id("a") == 0x010C292C
    rig = Rig(PX4, gps=False)
    sequences = []
    for _ in range(12):
        rig.arm()
        sequences += [x.sequence for x in rig.run(0.1) if x.get_type() == "EVENT"]
    assert sequences == [*range(65525, 65536), 0]
    assert rig.newest("EVENT").id == event_id("commander_arm_denied_resolve_failures")


def test_arming_is_refused_with_an_event_and_with_texts_for_ground_stations() -> None:
    """The first text is one byte too long for one message; the reason follows."""
    rig = Rig(PX4, gps=False)
    rig.run(2.0)
    assert rig.arm() == m.MAV_RESULT_TEMPORARILY_REJECTED
    rig.run(0.1)
    first, rest, reason = rig.texts()
    assert (first, rest) == ("Arming denied: Resolve system health failures firs", "t\t")
    assert reason.startswith("Preflight Fail: ")


def test_while_disarmed_every_mode_is_taken() -> None:
    """Offboard without setpoints, position mode without sticks, hold and take-off without a position."""
    rig = Rig(PX4, gps=False)
    rig.run(2.0)
    for name, base_mode in {
        "OFFBOARD": 1,
        "AUTO.LOITER": 29,
        "AUTO.TAKEOFF": 29,
        "POSCTL": 81,
        "AUTO.LAND": 29,
    }.items():
        assert rig.set_mode(name) == 0
        rig.run(1.1)
        beat = rig.newest("HEARTBEAT")
        assert (rig.mode, beat.base_mode, beat.system_status) == (name, base_mode, m.MAV_STATE_UNINIT)
        assert rig.arm() != 0


def test_the_heartbeat_says_whether_it_would_arm_and_whether_a_failsafe_flies() -> None:
    """STANDBY, ACTIVE, CRITICAL; in offboard only the flags of an armed, stabilized vehicle."""
    rig = ready(PX4, parameters={"COM_OBL_RC_ACT": 5})
    rig.run(1.0)
    assert rig.newest("HEARTBEAT").system_status == m.MAV_STATE_STANDBY
    rig.fly()
    assert (rig.newest("HEARTBEAT").system_status, rig.newest("HEARTBEAT").base_mode) == (m.MAV_STATE_ACTIVE, 157)
    rig.offboard()
    rig.run(1.0)
    assert rig.newest("HEARTBEAT").base_mode == 145
    rig.streaming = None
    rig.run(3.0)
    assert rig.newest("HEARTBEAT").system_status == m.MAV_STATE_CRITICAL
    assert "Failsafe activated\t" in rig.texts()


def test_after_a_landing_it_is_back_in_the_mode_before() -> None:
    """Disarmed, in hold or in offboard: not in land, in which it could not be armed again."""
    rig = ready(PX4)
    rig.fly()
    assert rig.command(m.MAV_CMD_NAV_LAND) == 0
    rig.until(lambda: not rig.armed, 20.0)
    rig.run(0.1)
    assert rig.mode == "AUTO.LOITER"
    assert {"Takeoff detected\t", "Landing detected\t", "Disarmed by landing\t"} <= set(rig.texts())


def test_position_mode_needs_sticks() -> None:
    """Without a transmitter a pilot can take hold, land and return only."""
    rig = flying(PX4)
    assert rig.set_mode("POSCTL") == m.MAV_RESULT_TEMPORARILY_REJECTED
    rig.vehicle.set_transmitter(True)
    rig.run(0.1)
    assert rig.set_mode("POSCTL") == 0
