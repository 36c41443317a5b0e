"""Whose the vehicle is, and whether it is armed, by the commands that passed and what the autopilot says."""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.gate.vehicle import NOWHERE_S, Vehicle
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.mode_monitor import DISARMED
from companion.mavlink.modes import personality, px4_mode
from tests.gate.built import PLAN

PX4 = personality(AutopilotKind.PX4)
POSITION = px4_mode(3)
APPLICATION, GATE = 191, 192
NUMBER = {AutopilotKind.PX4: 12, AutopilotKind.ARDUPILOT: 3}


def heartbeat(vehicle: Vehicle, mode: int, now_s: float, *, armed: bool = True, autopilot: int = 12) -> None:
    fields = {"autopilot": autopilot, "base_mode": 128 | 1 if armed else 127, "custom_mode": mode, "system_status": 4}
    vehicle.on_message("HEARTBEAT", fields, now_s)


def mode(vehicle: Vehicle, number: int, component: int = APPLICATION) -> None:
    _, main, sub = vehicle.personality.set_mode_parameters(number)
    vehicle.on_command_sent(176, {"param2": main, "param3": sub}, component)


def acknowledge(vehicle: Vehicle, command: int, result: int, now_s: float, component: int = APPLICATION) -> None:
    vehicle.on_message("COMMAND_ACK", {"command": command, "result": result, "target_component": component}, now_s)


def is_armed(vehicle: Vehicle) -> bool:
    return vehicle.armed


def is_airborne(vehicle: Vehicle) -> bool:
    return vehicle.airborne


def is_steered(vehicle: Vehicle) -> bool:
    return vehicle.steered


def estimates(vehicle: Vehicle) -> bool | None:
    return vehicle.estimator_good


def ours(at: int = PX4.offboard) -> Vehicle:
    """Armed by the application, in a mode that it asked for."""
    vehicle = Vehicle(PLAN.thresholds)
    heartbeat(vehicle, PX4.hold, 1.0, armed=False)
    vehicle.on_command_sent(400, {"param1": 1.0}, APPLICATION)
    heartbeat(vehicle, PX4.hold, 2.0)
    mode(vehicle, at)
    heartbeat(vehicle, at, 3.0)
    assert is_airborne(vehicle)
    assert vehicle.taken_over is None
    return vehicle


def test_nothing_is_believed_before_it_is_said() -> None:
    """Protects the start from assumptions."""
    vehicle = Vehicle(PLAN.thresholds)
    assert (vehicle.kind, vehicle.battery.percent, vehicle.estimator_good) == (None, None, None)
    assert (vehicle.heard_s, vehicle.heartbeat_s) == (-math.inf, -math.inf)
    assert (vehicle.armed, vehicle.airborne, vehicle.taken_over, vehicle._mode_monitor.mode) == (
        False,
        False,
        None,
        None,
    )
    assert vehicle.asked_modes == frozenset()
    assert vehicle.personality is PX4
    assert not vehicle.confirms(PX4.hold)


def test_anything_is_a_sign_of_life_but_only_a_heartbeat_is_a_heartbeat() -> None:
    """Protects the two times apart: a link that lives, and an autopilot that does."""
    vehicle = Vehicle(PLAN.thresholds)
    vehicle.on_message(None, {}, 5.0)
    assert (vehicle.heard_s, vehicle.heartbeat_s) == (5.0, -math.inf)
    heartbeat(vehicle, POSITION, 6.0, armed=False)
    assert (vehicle.heard_s, vehicle.heartbeat_s) == (6.0, 6.0)
    assert (vehicle._mode_monitor.mode, vehicle.armed) == (POSITION, False)
    vehicle.on_message("SYSTEM_TIME", {}, 7.0)
    assert (vehicle.heard_s, vehicle.heartbeat_s) == (7.0, 6.0)
    heartbeat(vehicle, POSITION, 8.0)
    assert is_armed(vehicle)
    assert not is_airborne(vehicle), "who was armed by a pilot is a pilot's"


@pytest.mark.parametrize(("first", "later"), [(12, 3), (3, 12), (12, 8), (3, 0)])
def test_the_first_firmware_that_we_know_is_the_firmware(first: int, later: int) -> None:
    """Protects against other components' heartbeats with the vehicle's number."""
    vehicle = Vehicle(PLAN.thresholds)
    vehicle.on_command_sent(21, {}, APPLICATION)
    heartbeat(vehicle, 1, 1.0, autopilot=8)
    assert (vehicle.kind, vehicle.heartbeat_s) == (None, -math.inf)
    assert vehicle.asked_modes == {PX4.land}, "nor forgets it for their sake what was asked for"
    heartbeat(vehicle, 2, 2.0, armed=False, autopilot=first)
    assert NUMBER[vehicle.kind or AutopilotKind.PX4] == first
    assert vehicle.personality.kind is vehicle.kind
    heartbeat(vehicle, 4, 3.0, autopilot=later)
    assert (vehicle._mode_monitor.mode, vehicle.heartbeat_s, vehicle.armed) == (2, 2.0, False)
    assert NUMBER[vehicle.kind or AutopilotKind.PX4] == first


def test_a_strange_mode_is_named_as_its_firmware_names_it() -> None:
    """Protects what the pilot reads when hands go off."""
    vehicle = Vehicle(PLAN.thresholds)
    heartbeat(vehicle, 4, 1.0, autopilot=3)
    mode(vehicle, 4)
    heartbeat(vehicle, 5, 2.0, autopilot=3)
    assert vehicle.taken_over == "loiter"


@pytest.mark.parametrize(("result", "armed"), [(0, True), (5, True), (1, False), (4, False)])
def test_an_accepted_arming_counts_until_a_heartbeat_could_know_of_it(result: int, armed: bool) -> None:
    """Protects the first second in the air, of which the last heartbeat knows nothing yet."""
    vehicle = Vehicle(PLAN.thresholds)
    heartbeat(vehicle, PX4.hold, 9.0, armed=False)
    acknowledge(vehicle, 400, 0, 9.5)
    assert not is_armed(vehicle), "nobody of ours asked for it"
    vehicle.on_command_sent(400, {"param1": 1.0}, APPLICATION)
    acknowledge(vehicle, 22, 0, 9.75)
    assert not is_armed(vehicle), "another command"
    acknowledge(vehicle, 400, result, 10.0)
    assert (vehicle.armed, vehicle.airborne) == (armed, armed)
    heartbeat(vehicle, PX4.hold, 11.0, armed=False)
    assert is_armed(vehicle) is armed, "this one may have been on its way"
    heartbeat(vehicle, PX4.hold, 11.25, armed=False)
    assert not is_armed(vehicle)


def test_a_heartbeat_knows_of_the_arming_from_its_own_moment_on() -> None:
    """Protects the end of that first second; and a refusal means no arming at any time, also of a clock at zero."""
    vehicle = Vehicle(PLAN.thresholds)
    vehicle.on_command_sent(400, {"param1": 1.0}, APPLICATION)
    acknowledge(vehicle, 400, 0, 0.0)
    heartbeat(vehicle, PX4.hold, 1.1875, armed=False)
    assert is_armed(vehicle)
    heartbeat(vehicle, PX4.hold, 1.2, armed=False)
    assert not is_armed(vehicle)
    refused = Vehicle(PLAN.thresholds)
    heartbeat(refused, PX4.hold, 0.5, armed=False)
    refused.on_command_sent(400, {"param1": 1.0}, APPLICATION)
    acknowledge(refused, 400, 4, 0.625)
    assert not is_armed(refused)


def test_an_arming_that_is_refused_later_is_refused() -> None:
    """Protects the ground: "in progress" first, and then no."""
    vehicle = Vehicle(PLAN.thresholds)
    heartbeat(vehicle, PX4.hold, 9.0, armed=False)
    vehicle.on_command_sent(400, {"param1": 1.0}, APPLICATION)
    acknowledge(vehicle, 400, 5, 10.0)
    acknowledge(vehicle, 400, 4, 10.5)
    assert not is_armed(vehicle)


def test_an_acknowledgement_in_the_air_arms_nothing_anew() -> None:
    """Protects the end of a flight: what is told of a vehicle that is armed says nothing after it was disarmed."""
    vehicle = ours()
    acknowledge(vehicle, 400, 0, 3.5)
    heartbeat(vehicle, PX4.offboard, 3.75, armed=False)
    assert not is_armed(vehicle)


@pytest.mark.parametrize("param1", [0.0, 2.0, math.nan])
def test_only_to_arm_is_to_arm(param1: float) -> None:
    """Protects against taking a disarming for the beginning of a flight; after an arming it does not undo it."""
    vehicle = Vehicle(PLAN.thresholds)
    heartbeat(vehicle, PX4.hold, 1.0)
    vehicle.on_command_sent(400, {"param1": param1}, APPLICATION)
    assert not is_airborne(vehicle)
    vehicle.on_command_sent(400, {"param1": 1.0}, APPLICATION)
    vehicle.on_command_sent(400, {"param1": param1}, APPLICATION)
    assert is_airborne(vehicle), "until a heartbeat says that it was obeyed"
    vehicle.end_flight()
    assert not is_airborne(vehicle)
    assert is_armed(vehicle)


def test_what_was_accepted_for_the_last_flight_arms_nothing_in_the_next() -> None:
    """Protects the ground between two flights."""
    vehicle = Vehicle(PLAN.thresholds)
    heartbeat(vehicle, PX4.hold, 9.0, armed=False)
    vehicle.on_command_sent(400, {"param1": 1.0}, APPLICATION)
    acknowledge(vehicle, 400, 0, 10.0)
    vehicle.end_flight()
    assert not is_armed(vehicle)


def test_a_mode_is_obeyed_when_it_shows_after_it_was_asked_for() -> None:
    """Protects against taking a mode from before for an answer."""
    vehicle = ours()
    assert vehicle.confirms(PX4.offboard)
    assert not vehicle.confirms(PX4.hold)
    mode(vehicle, PX4.offboard)
    assert not vehicle.confirms(PX4.offboard), "asked for again: what shows is older"
    heartbeat(vehicle, PX4.offboard, 4.0)
    assert vehicle.confirms(PX4.offboard)
    mode(vehicle, PX4.hold)
    assert vehicle.asked_modes == {PX4.hold}
    heartbeat(vehicle, PX4.offboard, 5.0)
    assert not vehicle.confirms(PX4.hold)
    heartbeat(vehicle, PX4.hold, 6.0)
    assert vehicle.confirms(PX4.hold)
    assert not vehicle.confirms(PX4.offboard)
    vehicle.on_command_sent(22, {}, APPLICATION)
    heartbeat(vehicle, PX4.hold, 7.0)
    assert vehicle.asked_modes == PX4.taking_off
    assert not vehicle.confirms(PX4.hold), "in the take-off it is one of two"
    mode(vehicle, PX4.hold)
    heartbeat(vehicle, PX4.hold, 8.0)
    heartbeat(vehicle, POSITION, 9.0)
    assert not vehicle.confirms(PX4.hold), "no longer"


@pytest.mark.parametrize("order", [21, 176])
def test_a_landing_of_ours_ends_disarmed_and_passes_through_hold(order: int) -> None:
    """Protects the end of each flight from being taken for a takeover, by NAV_LAND or by the mode."""
    vehicle = ours()
    if order == 21:
        vehicle.on_command_sent(21, {}, APPLICATION)
    else:
        mode(vehicle, PX4.land)
    assert vehicle.asked_modes == {PX4.land}
    heartbeat(vehicle, PX4.hold, 4.0)
    assert vehicle.taken_over is None, "setpoints stopped before the mode was taken: the autopilot's failsafe holds"
    heartbeat(vehicle, PX4.land, 5.0)
    heartbeat(vehicle, PX4.land, 6.0, armed=False)
    assert vehicle.taken_over is None


@pytest.mark.parametrize("number", [PX4.hold, PX4.offboard])
def test_who_disarms_elsewhere_was_disarmed_by_somebody(number: int) -> None:
    """Protects from going on with a vehicle that somebody stopped by hand."""
    vehicle = ours(number)
    heartbeat(vehicle, number, 4.0, armed=False)
    assert vehicle.taken_over == DISARMED


def test_a_hold_on_the_way_to_offboard_is_somebodys() -> None:
    """Protects a failsafe: offboard is not reached through hold."""
    vehicle = ours(PX4.land)
    mode(vehicle, PX4.offboard)
    heartbeat(vehicle, PX4.hold, 4.0)
    assert vehicle.taken_over == "hold"


def test_a_hold_on_the_way_to_hold_is_ours() -> None:
    """Protects ArduPilot and PX4 alike while a request for hold is on its way."""
    vehicle = ours()
    mode(vehicle, PX4.hold)
    heartbeat(vehicle, PX4.offboard, 4.0)
    assert vehicle.taken_over is None


def test_a_mode_that_is_refused_leaves_the_one_before() -> None:
    """Protects the application from losing its vehicle to a refusal."""
    vehicle = ours()
    mode(vehicle, PX4.hold)
    acknowledge(vehicle, 176, 0, 3.25)
    assert vehicle.asked_modes == {PX4.hold}
    acknowledge(vehicle, 176, 1, 3.5, component=77)
    assert vehicle.asked_modes == {PX4.hold}, "somebody else's"
    acknowledge(vehicle, 22, 1, 3.5)
    assert vehicle.asked_modes == {PX4.hold}, "another command"
    acknowledge(vehicle, 176, 1, 3.75)
    assert PX4.offboard in vehicle.asked_modes
    heartbeat(vehicle, PX4.offboard, 4.0)
    assert vehicle.taken_over is None


@pytest.mark.parametrize("refused", [APPLICATION, GATE])
def test_only_the_newest_request_can_be_refused(refused: int) -> None:
    """Protects the gate's own hold from the refusal of what the application asked for before."""
    vehicle = ours()
    mode(vehicle, PX4.hold)
    mode(vehicle, PX4.land, GATE)
    acknowledge(vehicle, 176, 4, 3.5, component=refused)
    assert (vehicle.asked_modes == {PX4.land}) is (refused == APPLICATION)


def test_a_mode_that_is_no_number_is_not_asked_for() -> None:
    """Protects what was asked for before."""
    vehicle = ours()
    vehicle.on_command_sent(176, {"param2": math.nan, "param3": 0.0}, APPLICATION)
    assert vehicle.asked_modes == {PX4.offboard}


def test_a_new_application_knows_what_shows_and_has_asked_for_nothing() -> None:
    """Protects it from the requests of the last one, and the gate from forgetting that something is armed."""
    vehicle = ours()
    vehicle.reset()
    assert (vehicle._mode_monitor.mode, vehicle.armed, vehicle.airborne) == (PX4.offboard, True, False)
    assert vehicle.asked_modes == frozenset()
    mode(vehicle, PX4.land, GATE)
    acknowledge(vehicle, 176, 4, 4.0)
    assert vehicle.asked_modes == {PX4.land}, "a refusal of what the last one asked for"
    heartbeat(vehicle, PX4.land, 5.0)
    vehicle.reset()
    vehicle.on_command_sent(400, {"param1": 1.0}, APPLICATION)
    assert is_airborne(vehicle)


def test_a_new_application_judges_by_the_same_firmware() -> None:
    """Protects the names of modes after a restart, and a takeover from being carried over."""
    vehicle = Vehicle(PLAN.thresholds)
    heartbeat(vehicle, 4, 1.0, autopilot=3)
    mode(vehicle, 4)
    heartbeat(vehicle, 5, 2.0, autopilot=3)
    vehicle.reset()
    assert vehicle.taken_over is None
    mode(vehicle, 4)
    heartbeat(vehicle, 16, 3.0, autopilot=3)
    assert vehicle.taken_over == "poshold"


@pytest.mark.parametrize(("said", "percent"), [(-1, None), (0, 0), (1, 1), (100, 100), (101, None)])
def test_a_battery_says_a_percentage_or_nothing(said: int, percent: int | None) -> None:
    """Protects against an unknown charge being taken for an empty one; and it forgets what it knew."""
    vehicle = Vehicle(PLAN.thresholds)
    vehicle.on_message("SYS_STATUS", {"battery_remaining": 50, "voltage_battery": 65535}, 1.0)
    vehicle.on_message("SYS_STATUS", {"battery_remaining": said, "voltage_battery": 65535}, 2.0)
    assert vehicle.battery.percent == percent


@pytest.mark.parametrize(
    ("autopilot", "name", "other"),
    [(12, "ESTIMATOR_STATUS", "EKF_STATUS_REPORT"), (3, "EKF_STATUS_REPORT", "ESTIMATOR_STATUS")],
)
def test_each_firmware_speaks_of_its_estimator_in_its_own_message(autopilot: int, name: str, other: str) -> None:
    """Protects from flags that mean something else."""
    figures = dict.fromkeys(("vel_ratio", "pos_horiz_ratio", "velocity_variance", "pos_horiz_variance"), 0.1)
    good: dict[str, Any] = figures | {"flags": 0x1F}
    vehicle = Vehicle(PLAN.thresholds)
    vehicle.on_message(name, good, 1.0)
    assert estimates(vehicle) is None, "nobody knows yet what they mean"
    heartbeat(vehicle, 4, 1.5, autopilot=autopilot)
    vehicle.on_message(other, good, 2.0)
    assert estimates(vehicle) is None
    vehicle.on_message(name, good, 3.0)
    assert estimates(vehicle) is True
    vehicle.on_message(name, good | {"flags": 0x1E}, 4.0)
    assert estimates(vehicle) is False
    # ArduPilot: not initialized. PX4: a GPS glitch.
    vehicle.on_message(name, good | {"flags": 0x1F | 1024}, 5.0)
    assert estimates(vehicle) is (autopilot == 12)


def test_positions_are_believed_by_whether_it_is_armed() -> None:
    """Protects against an autopilot's restart in the air, which no position can explain away."""
    still = dict.fromkeys(("x", "y", "z", "vx", "vy", "vz"), 0.0)
    vehicle = ours()
    vehicle.on_message("LOCAL_POSITION_NED", still | {"time_boot_ms": 9e3}, 4.0)
    vehicle.on_message("ATTITUDE", {"yaw": math.pi}, 4.0)
    assert vehicle.motion.after(1.0, 0.0, 0.0) == pytest.approx((-1.0, 0.0, 0.0))
    vehicle.on_message("LOCAL_POSITION_NED", still | {"time_boot_ms": 1e3}, 5.0)
    assert vehicle.motion.fresh_s == 4.0
    heartbeat(vehicle, PX4.offboard, 6.0, armed=False)
    vehicle.on_message("LOCAL_POSITION_NED", still | {"time_boot_ms": 1e3}, 7.0)
    assert vehicle.motion.fresh_s == 7.0


ORIGIN: dict[str, Any] = {"latitude": 1, "longitude": 1, "altitude": 1}


def test_where_an_origin_is_no_place_px4_lands_elsewhere() -> None:
    """Protects from PX4's landing with LOCAL_FRD and an origin: it takes 0/0 for where it is, and flies there."""
    vehicle = ours()
    assert not vehicle.lands_elsewhere(99.0), "without an origin it lands in place"
    vehicle.on_message("GPS_GLOBAL_ORIGIN", ORIGIN, 4.0)
    vehicle.on_message("GPS_GLOBAL_ORIGIN", ORIGIN, 6.0)
    assert not vehicle.lands_elsewhere(4.0 + NOWHERE_S), "the position may follow yet"
    assert vehicle.lands_elsewhere(4.0 + NOWHERE_S + 0.0625)
    vehicle.on_message("GLOBAL_POSITION_INT", {}, 8.0)
    assert not vehicle.lands_elsewhere(99.0)


def test_ardupilot_lands_where_it_is() -> None:
    """Protects ArduCopter's own landing, which needs no place on the globe."""
    vehicle = Vehicle(PLAN.thresholds)
    heartbeat(vehicle, 4, 1.0, autopilot=3)
    vehicle.on_message("GPS_GLOBAL_ORIGIN", ORIGIN, 1.0)
    assert not vehicle.lands_elsewhere(99.0)


@pytest.mark.parametrize(("status", "by_failsafe"), [(3, False), (4, False), (5, True), (6, True)])
def test_a_failsafe_of_the_autopilot_is_told_from_a_person(status: int, by_failsafe: bool) -> None:
    """Protects what the pilot reads: PX4 and ArduCopter are CRITICAL in a failsafe, EMERGENCY in a worse one."""
    vehicle = ours()
    fields = {"autopilot": 12, "base_mode": 128, "custom_mode": PX4.hold, "system_status": status}
    vehicle.on_message("HEARTBEAT", fields, 4.0)
    assert (vehicle.taken_over, vehicle.by_failsafe) == ("hold", by_failsafe)


def test_it_is_steered_once_the_mode_of_setpoints_shows() -> None:
    """Protects from comparing what is flown with setpoints that nobody takes."""
    vehicle = ours()
    assert is_steered(vehicle)
    mode(vehicle, PX4.hold)
    assert not is_steered(vehicle)
    heartbeat(vehicle, PX4.hold, 4.0)
    assert not is_steered(vehicle)
    mode(vehicle, PX4.offboard)
    assert not is_steered(vehicle)
    heartbeat(vehicle, PX4.offboard, 5.0)
    assert is_steered(vehicle)


def test_a_new_flight_misses_nothing_of_the_last() -> None:
    """Protects it from the odometry, the fix and the estimator that the one before had."""
    vehicle = ours()
    vehicle.on_message("GPS_RAW_INT", {"fix_type": 3}, 4.0)
    assert vehicle.aiding.gps_s == 4.0
    vehicle.end_flight()
    assert vehicle.aiding.gps_s == -math.inf
