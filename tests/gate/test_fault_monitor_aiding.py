"""Faults of an autopilot that says that all is well: nothing tells it where it is, or it does not obey."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from companion.gate.faults import Fault
from companion.gate.obedience import FOR_S, STAND_AFTER_S
from companion.gate.plan import Plan
from tests.gate.test_fault_monitor import FRESH, JUST_S, NOW_S, PLAN, flying, moved, only, watching

GPS = replace(PLAN, gps=True)
LIMIT = PLAN.thresholds


@pytest.mark.parametrize(("stands_s", "words"), [(0.5, None), (0.5 + JUST_S, "for 0.5 s"), (2.25, "for 2.2 s")])
def test_figures_of_merit_that_stand_still(stands_s: float, words: str | None) -> None:
    """Protects the seconds until the estimator says so itself: ArduCopter drifts 1.7 m in them."""
    assert LIMIT.aiding_s == 0.5
    monitor = watching()
    for now_s in (NOW_S, NOW_S + stands_s):
        figures = {"vel_ratio": 0.1, "pos_horiz_ratio": 0.1, "flags": 0x1F}
        monitor._vehicle.on_message("ESTIMATOR_STATUS", figures, now_s)
    assert only(monitor, Fault.AIDING_LOST, NOW_S + stands_s) == words


@pytest.mark.parametrize(
    ("plan", "fixes", "words"),
    [
        (GPS, [3], "1.12 s, fix 3"),
        (GPS, [3, 1], "1.12 s, fix 1"),
        (GPS, [], None),
        (GPS, [1], None),
        (PLAN, [3], None),
    ],
)
def test_a_position_fix_that_is_gone(plan: Plan, fixes: list[int], words: str | None) -> None:
    """Protects a flight by GPS, and no other: what never came in this flight is not missed."""
    assert LIMIT.gps_s == 1.0
    monitor = watching(plan=plan)
    for fix in fixes:
        monitor._vehicle.on_message("GPS_RAW_INT", {"fix_type": fix}, NOW_S)
    assert only(monitor, Fault.GPS_LOST, NOW_S + 1.0) is None
    assert only(monitor, Fault.GPS_LOST, NOW_S + 1.125) == words


def test_odometry_that_stops() -> None:
    """Protects where it passes through the gate: its silence is heard before the autopilot feels it."""
    monitor = watching()
    assert only(monitor, Fault.ODOMETRY_SILENT, NOW_S + 9.0) is None, "where none passes nobody misses it"
    monitor._vehicle.odometry.on_place("ODOMETRY", {"x": 0.0, "y": 0.0, "z": 0.0, "reset_counter": 0}, NOW_S)
    assert only(monitor, Fault.ODOMETRY_SILENT, NOW_S + LIMIT.odometry_s) is None
    assert only(monitor, Fault.ODOMETRY_SILENT, NOW_S + LIMIT.odometry_s + JUST_S) == "0.25 s"


@pytest.mark.parametrize(
    ("name", "fields", "words"),
    [
        ("SYS_STATUS", {"battery_remaining": 15, "voltage_battery": 0}, None),
        ("SYS_STATUS", {"battery_remaining": 14, "voltage_battery": 0}, "14 %"),
        ("SYS_STATUS", {"battery_remaining": -1, "voltage_battery": 9_990}, None),
        ("BATTERY_STATUS", {"id": 0, "charge_state": 3}, "critical, says the autopilot"),
        ("BATTERY_STATUS", {"id": 0, "charge_state": 2}, None),
    ],
)
def test_a_battery_with_too_little(name: str, fields: dict[str, Any], words: str | None) -> None:
    """Protects the landing while there is something left to land with."""
    monitor = watching()
    monitor._vehicle.on_message(name, fields, NOW_S)
    assert only(monitor, Fault.BATTERY) == words


def test_the_bounds_of_the_battery_are_those_of_the_plan() -> None:
    """Protects whoever has set a voltage, and the heartbeat's own warning."""
    monitor = watching(plan=PLAN)
    monitor._vehicle.battery._least_v = 10.0
    monitor._vehicle.on_message("SYS_STATUS", {"battery_remaining": 100, "voltage_battery": 9_990}, NOW_S)
    assert only(monitor, Fault.BATTERY, NOW_S + 5.0) == "9.99 V"
    monitor = watching()
    critical = {"autopilot": 12, "base_mode": 128, "custom_mode": 6 << 16, "system_status": 5}
    monitor._vehicle.on_message("HEARTBEAT", critical, NOW_S)
    monitor._vehicle.on_message("BATTERY_STATUS", {"id": 0, "charge_state": 2}, NOW_S)
    assert only(monitor, Fault.BATTERY) == "low, says the autopilot"


def runaway(*, steered: bool = True) -> tuple[Any, float]:
    """Asked to stand it flies on; the moment at which that is certain."""
    monitor = watching()
    watched = monitor._vehicle
    if steered:
        offboard = {"autopilot": 12, "base_mode": 128, "custom_mode": 6 << 16, "system_status": 4}
        watched.on_message("HEARTBEAT", offboard, NOW_S)
    ticks = round(STAND_AFTER_S * 16)
    for tick in range(ticks + 1):
        now_s = NOW_S + tick / 16
        monitor.obedience.on_setpoint(0.0, 0.0, now_s)
        watched.on_message("LOCAL_POSITION_NED", moved(time_boot_ms=2e3 + tick, x=0.02 * tick, vx=0.3), now_s)
        monitor.on_position(now_s)
    return monitor, NOW_S + ticks / 16


def test_who_does_not_obey() -> None:
    """Protects from a vehicle that flies on under zero velocity, heartbeats and mode as they should be."""
    monitor, now_s = runaway()
    assert only(monitor, Fault.NOT_OBEYED, now_s) == "asked to stand, flies 0.30 m/s"
    monitor._vehicle.on_command_sent(21, {}, 191)
    assert only(monitor, Fault.NOT_OBEYED, now_s) is None, "on its own way it is asked for nothing"
    monitor, now_s = runaway()
    monitor.reset()
    assert only(monitor, Fault.NOT_OBEYED, now_s) is None, "nor by an application that has just begun"


def test_who_is_not_steered_has_nothing_to_obey() -> None:
    """Protects the change of modes, in which setpoints go out that are not taken yet."""
    monitor, now_s = runaway(steered=False)
    assert only(monitor, Fault.NOT_OBEYED, now_s + FOR_S) is None


def test_without_a_heading_nobody_knows_which_way_it_flies() -> None:
    """Protects from a verdict without a measurement."""
    monitor = watching()
    monitor._vehicle.motion._yaw_rad = None
    monitor.on_position(NOW_S)
    assert monitor.obedience._flown_s == -math.inf


@pytest.mark.parametrize(("age_s", "found"), [(0.125, True), (0.125 + JUST_S, False)])
def test_what_a_silent_application_asked_for_is_asked_for_no_more(age_s: float, found: bool) -> None:
    """Protects the pilot from "distance 2.1 m ahead" of a vehicle that stands, after the application's death."""
    monitor = flying(0.0, 0.5, 1.0)
    assert (only(monitor, Fault.DISTANCE, NOW_S + age_s) is not None) is found
    blind = flying(None, 0.5, 1.0)
    assert only(blind, Fault.DISTANCE, NOW_S + age_s) is not None, "where nobody knows what is flown it counts on"


def test_the_creep_after_a_stop_counts_towards_the_distance() -> None:
    """Protects the hard limit: PX4 goes on by a decimetre after it has braked."""
    creeping = replace(PLAN, stopping=replace(PLAN.stopping, creep_m=0.125))
    for ahead_m, found in ((1.375, False), (1.375 - JUST_S, True)):
        monitor = watching(replace(FRESH, ahead_m=ahead_m), creeping)
        monitor._vehicle.motion._state = (0.0, 0.0, 0.0, 0.5, 0.0, 0.0)
        assert (only(monitor, Fault.DISTANCE) is not None) is found
