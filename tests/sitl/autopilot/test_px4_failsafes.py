"""A transmitter, a ground station or a battery that PX4 misses: hold first, then what the parameters say."""

from __future__ import annotations

import math

import pytest

from sitl.autopilot import PX4
from sitl.autopilot.events import event_id
from sitl.autopilot.mavlink import dialect as m
from tests.sitl.autopilot.rig import Rig, command_long, flying, ready

DELAY_TEXT = "Failsafe activated: entering Hold for 5 seconds\t"


def ground_station(rig: Rig) -> None:
    """One heartbeat of it."""
    rig.send(m.MAVLink_heartbeat_message(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3), (255, 190))


def events(rig: Rig) -> set[int]:
    """The numbers of all that it told."""
    return {x.id for _, x in rig.received if x.get_type() == "EVENT"}


def in_offboard(transmitter: bool = True, **parameters: float) -> Rig:
    """Hovering in offboard, with a transmitter on since before it was armed."""
    rig = ready(PX4, parameters={"COM_OBL_RC_ACT": 5, "COM_OF_LOSS_T": 0.5} | parameters)
    rig.vehicle.set_transmitter(transmitter)
    rig.fly()
    rig.offboard()
    return rig


def test_a_transmitter_lost_in_offboard_is_a_hold_and_then_a_return_that_climbs() -> None:
    """By default: 5 s, then RTL climbs to RTL_RETURN_ALT at more than 1 m/s, flies home and lands."""
    rig = in_offboard()
    rig.streaming = (0.5, 0.0, 0.0, 0.0)
    rig.run(4.0)
    rig.vehicle.set_transmitter(False)
    assert rig.until(lambda: rig.mode == "AUTO.LOITER", 2.0) == pytest.approx(0.5, abs=0.1)
    rig.run(0.1)
    assert rig.texts()[-1] == DELAY_TEXT
    assert event_id("commander_failsafe_enter_hold") in events(rig)
    assert rig.until(lambda: rig.mode == "AUTO.RTL", 10.0) == pytest.approx(5.0, abs=0.3)
    before_m = rig.height_m
    rig.run(5.0)
    assert 4.5 < rig.height_m - before_m < 10.0
    rig.until(lambda: rig.height_m > 28.0, 40.0)
    rig.until(lambda: not rig.armed, 90.0)
    assert math.hypot(rig.pose.x_m, rig.pose.y_m) < 0.6


@pytest.mark.parametrize(("excepted", "returns"), [(4, True), (6, False)])
def test_an_exception_for_offboard_alone_does_not_cover_the_hold_after_it(excepted: int, returns: bool) -> None:
    """COM_RCL_EXCEPT: lost in offboard it is ignored, but a hold that is ordered then is another mode."""
    rig = in_offboard(COM_RCL_EXCEPT=excepted)
    rig.vehicle.set_transmitter(False)
    rig.run(8.0)
    assert rig.mode == "OFFBOARD"
    assert rig.set_mode("AUTO.LOITER") == 0
    rig.run(7.0)
    assert (rig.mode == "AUTO.RTL") is returns
    assert (DELAY_TEXT in rig.texts()) is returns


@pytest.mark.parametrize(("action", "mode"), [(0, "OFFBOARD"), (1, "AUTO.LOITER"), (2, "AUTO.RTL"), (3, "AUTO.LAND")])
def test_nav_rcl_act_says_what_follows_the_hold(action: int, mode: str) -> None:
    """0 nothing, 1 hold, 2 return, 3 land."""
    rig = in_offboard(NAV_RCL_ACT=action)
    rig.vehicle.set_transmitter(False)
    rig.run(6.5)
    assert rig.mode == mode


def test_a_transmitter_that_was_off_at_arming_is_not_missed() -> None:
    """As in the simulator, which has none."""
    rig = in_offboard(transmitter=False)
    rig.run(10.0)
    assert rig.mode == "OFFBOARD"


def test_a_transmitter_that_is_back_does_not_give_the_vehicle_back() -> None:
    """Somebody has to choose a mode."""
    rig = in_offboard(NAV_RCL_ACT=1)
    rig.vehicle.set_transmitter(False)
    rig.run(1.0)
    rig.vehicle.set_transmitter(True)
    rig.run(3.0)
    assert rig.mode == "AUTO.LOITER"
    assert rig.set_mode("AUTO.LAND") == 0
    assert rig.set_mode("OFFBOARD") == 0
    rig.run(1.0)
    assert rig.mode == "OFFBOARD"


def test_a_landing_is_not_turned_into_a_return() -> None:
    """Lost on the way down it goes on down."""
    rig = in_offboard()
    assert rig.command(m.MAV_CMD_NAV_LAND) == 0
    rig.run(0.5)
    rig.vehicle.set_transmitter(False)
    rig.until(lambda: not rig.armed, 15.0)
    assert rig.vehicle.state.airframe.height_m == 0.0
    assert DELAY_TEXT not in rig.texts()


def test_without_a_global_position_it_lands_instead_of_returning() -> None:
    """And does not hold first: hold is not available."""
    rig = Rig(PX4, gps=False)
    rig.feeding = "frd"
    rig.run(2.0)
    rig.vehicle.set_transmitter(True)
    rig.streaming = (0.0, 0.0, -0.5, 0.0)
    rig.run(0.5)
    assert rig.set_mode("OFFBOARD") == 0
    assert rig.arm() == 0
    rig.run(8.0)
    rig.streaming = (0.0, 0.0, 0.0, 0.0)
    rig.vehicle.set_transmitter(False)
    rig.until(lambda: rig.mode == "AUTO.LAND", 1.0)
    rig.run(0.1)
    assert "Failsafe activated\t" in rig.texts()


@pytest.mark.parametrize(("action", "excepted", "mode"), [(0, 0, "OFFBOARD"), (2, 0, "AUTO.RTL"), (2, 4, "OFFBOARD")])
def test_a_ground_station_that_falls_silent(action: int, excepted: int, mode: str) -> None:
    """After COM_DL_LOSS_T; by default nothing but a text."""
    rig = ready(PX4, parameters={"NAV_DLL_ACT": action, "COM_DLL_EXCEPT": excepted})
    ground_station(rig)
    rig.fly()
    rig.offboard()
    ground_station(rig)
    rig.run(1.0)
    before = len(rig.received)
    lost_s = rig.until(lambda: rig.vehicle.state.ground_station.lost, 12.0)
    assert lost_s == pytest.approx(9.0, abs=0.2)
    rig.run(6.0)
    assert "Connection to ground station lost\t" in [
        x.text for _, x in list(rig.received)[before:] if hasattr(x, "text")
    ]
    assert rig.mode == mode


def test_a_needed_ground_station_is_asked_for_before_arming() -> None:
    """NAV_DLL_ACT above 0."""
    rig = ready(PX4, parameters={"NAV_DLL_ACT": 2})
    assert rig.arm() == m.MAV_RESULT_TEMPORARILY_REJECTED
    ground_station(rig)
    assert rig.arm() == 0


def test_the_mission_computers_end_is_told() -> None:
    """10 s after its last heartbeat, once."""
    rig = ready(PX4)
    beat = m.MAVLink_heartbeat_message(m.MAV_TYPE_ONBOARD_CONTROLLER, m.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3)
    rig.send(beat)
    text = "Connection to mission computer lost\t"
    assert rig.until(lambda: text in rig.texts(), 12.0) == pytest.approx(10.0, abs=0.1)
    rig.run(15.0)
    assert rig.texts().count(text) == 1


@pytest.mark.parametrize(
    ("action", "percent", "mode"),
    [
        (3, 14.0, "OFFBOARD"),
        (3, 6.5, "AUTO.RTL"),
        (3, 4.5, "AUTO.LAND"),
        (2, 6.5, "AUTO.LAND"),
        (1, 4.5, "AUTO.RTL"),
        (0, 4.5, "OFFBOARD"),
    ],
)
def test_a_battery_that_runs_low(action: int, percent: float, mode: str) -> None:
    """COM_LOW_BAT_ACT, by the thresholds low, critical and emergency; low only warns, after a hold of 5 s it acts."""
    rig = ready(PX4, parameters={"COM_LOW_BAT_ACT": action})
    rig.fly()
    rig.offboard()
    rig.vehicle.state.battery.percent = percent
    rig.run(6.5)
    assert rig.mode == mode
    warned = event_id("commander_failsafe_enter_low_bat") in events(rig)
    assert warned is (percent > 7.0)
    rig.run(2.0)
    level = (percent < 15.0) + (percent < 7.0) + (percent < 5.0)
    assert rig.newest("BATTERY_STATUS").charge_state == m.MAV_BATTERY_CHARGE_STATE_OK + level


def test_a_battery_that_was_low_at_arming_only_warns() -> None:
    """Who arms with it has been told."""
    rig = ready(PX4, battery_percent=6.0, battery_minutes=60.0)
    rig.fly()
    rig.run(8.0)
    assert rig.mode == "AUTO.LOITER"
    rig.vehicle.state.battery.percent = 4.0
    rig.run(6.0)
    assert rig.mode == "AUTO.LAND"


def test_px4_reads_the_charge_off_the_voltage() -> None:
    """3.4 V a cell is empty."""
    rig = ready(PX4)
    rig.vehicle.state.battery.measured_v = 4 * 3.44
    rig.run(2.5)
    status = rig.newest("BATTERY_STATUS")
    assert (status.battery_remaining, status.charge_state) == (5, m.MAV_BATTERY_CHARGE_STATE_CRITICAL)
    assert rig.newest("SYS_STATUS").voltage_battery == 13_760


def test_somebody_who_chooses_a_mode_in_a_failsafe_is_obeyed() -> None:
    """A pilot's mode during the hold of 5 s: no return follows."""
    rig = in_offboard()
    rig.vehicle.set_transmitter(False)
    rig.run(1.0)
    assert rig.mode == "AUTO.LOITER"
    assert rig.results(command_long(m.MAV_CMD_DO_SET_MODE, 1.0, 4.0, 3.0)) == [0, 0]
    rig.run(10.0)
    assert rig.mode == "AUTO.LOITER"


def test_setpoints_that_come_back_end_only_their_own_failsafe() -> None:
    """A battery that is critical meanwhile keeps the vehicle."""
    rig = flying(PX4, parameters={"COM_OBL_RC_ACT": 5, "COM_OF_LOSS_T": 0.5})
    rig.streaming = None
    rig.run(1.0)
    assert rig.mode == "AUTO.LOITER"
    rig.vehicle.state.battery.percent = 6.0
    rig.run(1.0)
    rig.streaming = (0.0, 0.0, 0.0, 0.0)
    rig.run(6.0)
    assert rig.mode == "AUTO.RTL"
