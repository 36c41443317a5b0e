"""Faults of processes, of the application's logic, of senders on loopback, and of the computer."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import threading
from collections.abc import Callable

from companion.config.load import load
from companion.flight.request import module
from validation.fault_matrix.injection import Final, Injection
from validation.fault_matrix.processes import open_sockets
from validation.fault_matrix.scene import ROOT, Flight, SceneError
from validation.fault_matrix.stranger import YAW_RATE_RADPS

GATE_STOPPED_S = 3.0
OTHER_SPEED_MPS = 0.4
"""Not that of the flights."""
FULL_DISK_BYTES = 300_000
"""A recording with images is larger by now; what is said is not."""
RESTART_S = 40.0
"""Braked, held, landed, disarmed, started again, and time to take off if it were to."""

STOPPED = frozenset({Final.BRAKED, Final.HELD})
LANDED = frozenset({Final.LANDED})
STOPPED_OR_LANDED = STOPPED | LANDED
"""An application that wakes up may find that the autopilot was not heard for too long, and land."""
FLEW_ON = frozenset({Final.FLEW_ON})


def _tell(words: str) -> Callable[[Flight], None]:
    return lambda flight: flight.tell_flyer(words)


def _signal_flyer(number: signal.Signals) -> Callable[[Flight], None]:
    return lambda flight: os.kill(flight.flyer_pid, number)


def _signal_mapper(number: signal.Signals) -> Callable[[Flight], None]:
    return lambda flight: os.kill(flight.mapper_pid, number)


def _stop_gate_for_a_while(flight: Flight) -> None:
    flight.gate.send_signal(signal.SIGSTOP)
    threading.Timer(GATE_STOPPED_S, flight.gate.send_signal, (signal.SIGCONT,)).start()


def _continue_gate(flight: Flight) -> None:
    flight.gate.send_signal(signal.SIGCONT)


def _take_memory_of_mapper(flight: Flight) -> None:
    """As if the computer had no more: the next thing that it wants to remember has no place."""
    resource.prlimit(flight.mapper_pid, resource.RLIMIT_AS, (1, resource.RLIM_INFINITY))


def _fill_disk(flight: Flight) -> None:
    resource.prlimit(flight.flyer_pid, resource.RLIMIT_FSIZE, (FULL_DISK_BYTES, resource.RLIM_INFINITY))


def _rewrite_and_kill(flight: Flight) -> None:
    # JSON is YAML.
    written = json.loads(flight.config.read_text(encoding="utf-8"))
    written["control"] = {**written.get("control", {}), "speed_mps": OTHER_SPEED_MPS}
    flight.config.write_text(json.dumps(written), encoding="utf-8")
    if load(flight.config).settings.control.speed_mps == flight.settings.control.speed_mps:
        raise SceneError("the settings file was not changed")
    os.kill(flight.flyer_pid, signal.SIGKILL)


def _old_settings_and_nothing_flies(flight: Flight) -> str | None:
    started = [line for line in flight.said().splitlines() if line.startswith("flyer: speed")]
    if len(started) != 2:
        return f"the application was started {len(started)} times"
    if len(set(started)) != 1:
        return f"other settings after the restart: {started}"
    if flight.witness.armed:
        return "armed after the restart"
    return None


def _stranger(what: str) -> Callable[[Flight], None]:
    """Somebody else on this computer speaks to every socket of the flight's processes; ends before it is judged."""

    def begin(flight: Flight) -> None:
        ports = sorted(port for _, port in _sockets(flight))
        command = [*module("validation.fault_matrix.stranger"), what, *map(str, ports)]
        # In a thread, which waits for its end: it has to be over when the flight is judged.
        threading.Thread(target=subprocess.run, args=(command,), kwargs={"cwd": ROOT, "check": True}).start()

    return begin


def _sockets(flight: Flight) -> set[tuple[str, int]]:
    """Of gate, application and map; but for the one by which this program hands its faults to the application."""
    return open_sockets(flight.gate.pid) - {("udp", flight.flyer_port)}


def _nothing_of_the_stranger(flight: Flight) -> str | None:
    found = _sockets(flight)
    if found != {("udp", flight.gate_port)}:
        return f"something listens that the configuration does not name: {sorted(found)}"
    passed = [seen for seen in flight.relay.seen.setpoints() if abs(seen.yaw_rate - YAW_RATE_RADPS) < 1e-6]
    return f"{len(passed)} setpoints of the second application passed" if passed else None


PROCESS_FAULTS = (
    Injection(
        "SIGSTOP application",
        "processes",
        "the application is stopped by a signal, and stays so",
        _signal_flyer(signal.SIGSTOP),
        STOPPED,
    ),
    Injection(
        "SIGKILL application",
        "processes",
        "the application is killed",
        _signal_flyer(signal.SIGKILL),
        frozenset({Final.HELD}),
    ),
    Injection(
        "SIGTERM application",
        "processes",
        "the application is told to end: it lands in its own time",
        _signal_flyer(signal.SIGTERM),
        LANDED,
        needs_stop=False,
    ),
    Injection(
        "SIGKILL gate",
        "processes",
        "the gate is killed: silence, and the autopilot's own failsafe",
        lambda flight: flight.gate.kill(),
        frozenset({Final.FAILSAFE}),
    ),
    Injection(
        "SIGSTOP gate",
        "processes",
        f"the gate is stopped for {GATE_STOPPED_S:g} s: silence, the autopilot's failsafe, and then it finds a vehicle "
        "that it left",
        _stop_gate_for_a_while,
        # What comes after depends on when heartbeats were heard: the application may take the autopilot for lost.
        frozenset({Final.FAILSAFE, Final.BRAKED, Final.HELD, Final.LANDED, Final.FLEW_ON}),
        undo=_continue_gate,
        needs_stop=False,
    ),
    Injection(
        "SIGKILL map",
        "processes",
        "the process of the map is killed: it is started again, and the flight goes on",
        _signal_mapper(signal.SIGKILL),
        FLEW_ON,
        needs_stop=False,
    ),
    Injection(
        "SIGSTOP map",
        "processes",
        "the process of the map is stopped: nothing waits for it",
        _signal_mapper(signal.SIGSTOP),
        FLEW_ON,
        needs_stop=False,
    ),
    Injection(
        "map out of memory",
        "processes",
        "the process of the map gets no more memory",
        _take_memory_of_mapper,
        FLEW_ON,
        needs_stop=False,
    ),
    Injection(
        "configuration changed",
        "processes",
        "the settings file is rewritten, then the application killed: it starts again with the old settings",
        _rewrite_and_kill,
        LANDED,
        watch_s=RESTART_S,
        settings={"safety": {"reactions": {"application": {"first": "brake", "hold_after_s": 2, "land_after_s": 4}}}},
        verify=_old_settings_and_nothing_flies,
    ),
)

APPLICATION_FAULTS = (
    Injection(
        "event loop blocked",
        "application",
        "a call in the event loop takes 5 s",
        _tell("block"),
        STOPPED_OR_LANDED,
    ),
    Injection(
        "GIL held",
        "application",
        "a call in C keeps the interpreter's lock for 5 s",
        _tell("hold"),
        STOPPED_OR_LANDED,
    ),
    Injection(
        "exception in the tick",
        "application",
        "an error is raised in the middle of a tick: the application lands and ends",
        _tell("raise"),
        LANDED,
    ),
    Injection(
        "application ignores the wall",
        "application",
        "full speed ahead whatever it sees: the gate alone stops at its hard limit",
        _tell("careless"),
        STOPPED,
        needs_stop=False,
    ),
    Injection("setpoint NaN", "application", "the forward speed of every setpoint is NaN", _tell("nan"), STOPPED),
    Injection("setpoint 10x", "application", "the forward speed of every setpoint is ten times too much",
              _tell("tenfold"), STOPPED),
    Injection("setpoint in another frame", "application", "velocities meant for the body are called north and east",
              _tell("frame"), STOPPED),
    Injection("setpoint with another type mask", "application", "positions count besides the velocities",
              _tell("mask"), STOPPED),
    Injection("setpoint to another vehicle", "application", "setpoints are addressed to system 7",
              _tell("other vehicle"), STOPPED),
    Injection("flood", "application", "10,000 setpoints a second at full speed, from the application's own socket",
              _tell("flood"), STOPPED),
)  # fmt: skip

COMPUTER_FAULTS = (
    Injection(
        "garbage on loopback",
        "computer",
        "1,000 datagrams of noise a second to every socket of the flight's processes",
        _stranger("garbage"),
        FLEW_ON,
        needs_stop=False,
        verify=_nothing_of_the_stranger,
    ),
    Injection(
        "forged telemetry",
        "computer",
        "another process says to every socket of the flight's processes that the vehicle is elsewhere, disarmed, in "
        "another mode, and orders it to land",
        _stranger("telemetry"),
        FLEW_ON,
        needs_stop=False,
        verify=_nothing_of_the_stranger,
    ),
    Injection(
        "second application",
        "computer",
        "another process sends valid setpoints at full speed to every socket of the flight's processes",
        _stranger("setpoints"),
        FLEW_ON,
        needs_stop=False,
        verify=_nothing_of_the_stranger,
    ),
    Injection(
        "disk full",
        "computer",
        "nothing more can be written: the recording ends, the flight goes on",
        _fill_disk,
        FLEW_ON,
        needs_stop=False,
    ),
    Injection(
        "clock stepped",
        "computer",
        "the time of day leaps by an hour in the application, as NTP may do it",
        _tell("clock"),
        FLEW_ON,
        needs_stop=False,
    ),
)
