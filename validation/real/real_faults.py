"""The faults that are tried on the real autopilots: those of the matrix that need no stub, and their own."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from sitl.autopilot.mavlink import dialect as m
from validation.fault_matrix.faults import BY_NAME as OF_THE_MATRIX
from validation.fault_matrix.injection import Final, Injection
from validation.fault_matrix.scene import Flight
from validation.fault_matrix.vehicle_faults import hands_off
from validation.real.station import Station

STOPPED = frozenset({Final.BRAKED, Final.HELD, Final.LANDED, Final.FAILSAFE})
"""Which of them it is the table shows; that it stands, and how far it went, is what counts."""
PILOT = STOPPED | {Final.PILOT, Final.FLYING}
"""Whoever flies it may also let it drift, as PX4's simulator does in position mode."""
ANY = frozenset(Final)
JUMP_M, DIVERGING_MPS = 1.0, 0.2
LOST_S = 1.5
"""Until an autopilot has noticed that the transmitter is gone: COM_RC_LOSS_T 0.5 s, ArduCopter 1 s."""
LOW_V, SMALL_MAH, FEW_PERCENT = 10.0, 60.0, 3.0
"""Below the limits of four or three cells; less than a flight has taken by then; less than every limit."""
FAILURE_UNIT_BATTERY, FAILURE_UNIT_GPS, FAILURE_OFF = 100.0, 4.0, 1.0
PILOTS_TRIGGER_M = 2.3
"""A pilot's mode that coasts needs its room; who selects it, flies."""
MODES: dict[str, dict[str, tuple[float, float, float]]] = {
    "px4": {"hold": (1.0, 4.0, 3.0), "position": (1.0, 3.0, 0.0), "altitude": (1.0, 2.0, 0.0)},
    "ardupilot": {"hold": (1.0, 17.0, 0.0), "loiter": (1.0, 5.0, 0.0), "altitude": (1.0, 2.0, 0.0)},
}
"""Parameters of DO_SET_MODE."""

Act = Callable[[Flight], None]


def station(flight: Flight) -> Station:
    """The ground station of a flight on a real autopilot."""
    assert isinstance(flight.witness, Station)
    return flight.witness


def _signal(which: str, number: signal.Signals) -> Act:
    def act(flight: Flight) -> None:
        os.kill(getattr(flight, which).process.pid, number)

    return act


def _odometry(words: str) -> Act:
    return lambda flight: flight.tell_world(f"odometry {words}")


def _kill_application(flight: Flight) -> None:
    os.kill(flight.flyer_pid, signal.SIGKILL)


def _transmitter_on(flight: Flight) -> None:
    """ArduCopter's simulator has one of its own, with the throttle down, without which it does not arm."""
    if flight.personality == "px4":
        station(flight).sticks = True
        time.sleep(LOST_S)


def _sticks_in_the_middle(flight: Flight) -> None:
    station(flight).sticks = True


def _transmitter_off(flight: Flight) -> None:
    station(flight).sticks = False
    if flight.personality == "ardupilot":
        station(flight).set_parameters({"SIM_RC_FAIL": 1})


def _transmitter_on_and_off(flight: Flight) -> None:
    _transmitter_on(flight)
    _transmitter_off(flight)
    time.sleep(LOST_S)


def _ground_station_off(flight: Flight) -> None:
    station(flight).beating = False


def _battery_percent(flight: Flight) -> None:
    if flight.personality == "px4":
        station(flight).set_parameters({"SIM_BAT_MIN_PCT": FEW_PERCENT, "SIM_BAT_DRAIN": 1.0})
    else:
        station(flight).set_parameters({"BATT_CAPACITY": SMALL_MAH})


def _battery_voltage(flight: Flight) -> None:
    if flight.personality == "px4":
        station(flight).command(m.MAV_CMD_INJECT_FAILURE, FAILURE_UNIT_BATTERY, FAILURE_OFF)
    else:
        station(flight).set_parameters({"SIM_BATT_VOLTAGE": LOW_V})


def _gps_off(flight: Flight) -> None:
    if flight.personality == "px4":
        station(flight).command(m.MAV_CMD_INJECT_FAILURE, FAILURE_UNIT_GPS, FAILURE_OFF)
    else:
        station(flight).set_parameters({"SIM_GPS1_ENABLE": 0})


def _stop(component: int) -> Act:
    return lambda flight: station(flight).command(m.MAV_CMD_DO_PAUSE_CONTINUE, 0.0, component=component)


def _mode(name: str) -> Act:
    return lambda flight: station(flight).set_mode(MODES[flight.personality][name])


def _restart_autopilot(flight: Flight) -> None:
    flight.autopilot.restart()


def _own(name: str, group: str, what: str, inject: Act, expects: frozenset[Final] = STOPPED, **more: Any) -> Injection:
    return Injection(name, group, what, inject, expects, needs_stop=False, **more)


def _of_the_matrix(name: str) -> Injection:
    """As the stub has it; who stops it, and when, may differ from the stub's."""
    found = OF_THE_MATRIX[name]
    return replace(found, expects=found.expects | STOPPED, needs_stop=False)


PROCESSES = (
    *map(_of_the_matrix, ("SIGKILL application", "SIGSTOP application", "SIGKILL gate", "SIGSTOP gate")),
    _own("SIGKILL world", "processes", "sensors and odometry end at once", _signal("world", signal.SIGKILL)),
    _own("SIGSTOP world", "processes", "sensors and odometry stop, and stay so", _signal("world", signal.SIGSTOP)),
    _own(
        "autopilot restarted",
        "processes",
        "its process is killed and started again: the vehicle is at the start again, disarmed, and stays so",
        _restart_autopilot,
        frozenset({Final.LANDED}),
        watch_s=15.0,
    ),
)
_ODOMETRY = (
    _own("odometry lost", "odometry", "no estimate comes any more", _odometry("lost"), watch_s=12.0),
    _own("odometry frozen", "odometry", "the last estimate again and again", _odometry("frozen"), watch_s=10.0),
    _own(
        "odometry diverging",
        "odometry",
        f"the tracker believes to fall behind at {DIVERGING_MPS:g} m/s",
        _odometry(f"diverging {DIVERGING_MPS:g}"),
        STOPPED | {Final.FLEW_ON, Final.FLYING},
        watch_s=10.0,
    ),
    _own(
        "odometry jumping",
        "odometry",
        f"the position leaps {JUMP_M:g} m to the side, unannounced",
        _odometry(f"jump {JUMP_M:g}"),
        STOPPED | {Final.FLEW_ON},
        watch_s=10.0,
    ),
)
ODOMETRY = (
    *_ODOMETRY,
    *(
        replace(fault, name=f"{fault.name}, through the gate", guarded=True)
        for fault in _ODOMETRY
        if fault.name != "odometry diverging"  # which nobody can tell from flying
    ),
)
GPS = (_own("GPS lost", "gps", "the antenna is covered", _gps_off, watch_s=12.0),)
LINK = tuple(map(_of_the_matrix, ("link cut", "link cut for 3 s", "autopilot not heard", "autopilot hears nothing")))
PEOPLE_FAR = (
    _own(
        "transmitter lost",
        "transmitter and ground station",
        "the transmitter is gone in flight: ArduCopter lands, as it was told to; PX4 flies on, as it was told to",
        _transmitter_off,
        STOPPED | {Final.FLEW_ON},
        before=_transmitter_on,
        watch_s=12.0,
    ),
    # ArduCopter does not arm without a transmitter, and lands at once when it loses one.
    _own(
        "transmitter lost before, then SIGKILL application",
        "transmitter and ground station",
        "a transmitter was there and is lost before the take-off; then the application is killed",
        _kill_application,
        before=_transmitter_on_and_off,
        watch_s=12.0,
        personalities=("px4",),
    ),
    _own(
        "transmitter lost in flight, then SIGKILL application",
        "transmitter and ground station",
        "a transmitter is there until the flight towards the wall begins; then the application is killed",
        _kill_application,
        before=_transmitter_on,
        exploring=_transmitter_off,
        watch_s=12.0,
        personalities=("px4",),
    ),
    _own(
        "ground station lost, then SIGKILL application",
        "transmitter and ground station",
        "no heartbeat of a ground station comes since the flight towards the wall has begun; then the application is "
        "killed",
        _kill_application,
        exploring=_ground_station_off,
        watch_s=12.0,
    ),
)
VEHICLE = (
    _own("battery low by percent", "vehicle", f"{FEW_PERCENT:g} % or less are left", _battery_percent, watch_s=12.0),
    _own("battery low by voltage", "vehicle", "the voltage falls below every limit", _battery_voltage, watch_s=16.0),
)
PEOPLE = (
    _own("stop to the gate", "people", "DO_PAUSE_CONTINUE to component 192", _stop(192)),
    _own("stop to the application", "people", "DO_PAUSE_CONTINUE to component 191", _stop(191)),
    _own(
        "pause of the autopilot",
        "people",
        "DO_PAUSE_CONTINUE to component 1: the pause button of a ground station",
        _stop(1),
        STOPPED | {Final.FLEW_ON},
    ),
    _own("pilot selects hold", "people", "hold, BRAKE", _mode("hold"), PILOT, verify=hands_off),
    _own(
        "pilot selects position",
        "people",
        "position mode, with the sticks in the middle",
        _mode("position"),
        PILOT,
        before=_transmitter_on,
        exploring=_sticks_in_the_middle,
        verify=hands_off,
        personalities=("px4",),
    ),
    _own(
        "pilot selects loiter",
        "people",
        "LOITER, with the sticks in the middle",
        _mode("loiter"),
        PILOT,
        before=_transmitter_on,
        exploring=_sticks_in_the_middle,
        verify=hands_off,
        personalities=("ardupilot",),
    ),
    _own(
        "pilot selects altitude",
        "people",
        "altitude mode, ALT_HOLD, with the sticks in the middle: it coasts",
        _mode("altitude"),
        ANY,
        before=_transmitter_on,
        exploring=_sticks_in_the_middle,
        verify=hands_off,
        trigger_m=PILOTS_TRIGGER_M,
    ),
)

FAULTS: tuple[Injection, ...] = (*PROCESSES, *ODOMETRY, *GPS, *LINK, *PEOPLE_FAR, *VEHICLE, *PEOPLE)
"""In the order of the table."""

BY_NAME = {fault.name: fault for fault in FAULTS}
CELLS = tuple((fault.name, one) for fault in FAULTS for one in fault.personalities)


def with_gps(fault: Injection) -> bool:
    """Whether the fault needs a vehicle with GPS."""
    return fault in GPS
