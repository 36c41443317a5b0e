"""The checks before a flight, in the order in which they are read. None of them arms anything."""

from __future__ import annotations

import math
import shutil
import tempfile
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from companion.autopilot.interface import Link
from companion.autopilot.rc_switch import RcSwitch
from companion.autopilot.telemetry import Telemetry
from companion.autopilot.vehicle_state import VehicleState
from companion.clock import Clock, MonotonicClock
from companion.config.settings import Settings
from companion.errors import InputError
from companion.flight.preflight.battery import battery
from companion.flight.preflight.clock_check import check_clock
from companion.flight.preflight.origin import ORIGIN, origin
from companion.flight.preflight.parameter_check import check_rule
from companion.flight.preflight.parameter_rules import parameter_check_names, rules
from companion.flight.preflight.position import POSE_AGE_S, STANDING, estimator, standing
from companion.flight.preflight.prearm import PREARM, prearm
from companion.flight.preflight.rc_switch_check import RC_SWITCH, check_switch
from companion.flight.preflight.result import CheckResult, age
from companion.mavlink.firmware import MEASURED_BRAKE_MPS2, MEASURED_HOLD_CREEP_M, AutopilotKind
from companion.model import Beam
from companion.sensors.remedies import remedy, told
from companion.sensors.statistics import StreamStatistics

HEARTBEAT_AGE_S = 2.5
"""Two heartbeats may be lost on a link that will do."""
SEVERAL_HZ = 1.75
"""An autopilot sends one heartbeat a second, and one more when its mode changes."""
RATE_SHARE = 0.6
"""Of a rate that was asked for: less is not the jitter of a link but a stream that is not what it should be."""
STANDING_M = 1.0
"""The beam that looks down cannot be higher than this above the ground on which the vehicle stands."""
MAP_MB = 200.0
MB = 1e6
BRAKING = "braking"
ON_THE_GROUND = ("height", STANDING, PREARM, "disarmed", "mode")
"""Checks of a vehicle that stands and is nobody's yet."""
_BUSY_MODES = frozenset(
    {"mission", "auto", "return", "rtl", "smart_rtl", "auto_rtl", "land", "precision land", "termination"}
)
_LANDED_IN = frozenset({"land", "precision land"})
"""Shown by a vehicle that has landed, until somebody chooses another: with the motors off it does nothing."""


def check_names(settings: Settings) -> tuple[str, ...]:
    """The names of all checks, as `run_checks` skips them, of both autopilots."""
    connection = ("link", "autopilot", "attitude", "position", "clock")
    vehicle = ("height", "estimator", STANDING, ORIGIN, PREARM, "battery", "storage", "disarmed", "mode", BRAKING)
    switch = () if settings.mission.rc_switch.channel is None else (RC_SWITCH,)
    return (*connection, *_sensor_names(settings), *vehicle, *switch, *parameter_check_names(settings))


async def run_checks(
    link: Link,
    telemetry: Telemetry,
    settings: Settings,
    inputs: Mapping[str, StreamStatistics],
    *,
    fix: bool = False,
    skip: Collection[str] = (),
    height_m: float | None = None,
    clock: Clock | None = None,
    link_problem: str = "",
    rc_switch: RcSwitch | None = None,
    started: bool = False,
) -> list[CheckResult]:
    """Look at everything that a flight needs. A check that fails is a result, not an error.

    Args:
        link: to the autopilot.
        telemetry: running for a few seconds already, so that rates mean something.
        settings: the whole configuration.
        inputs: statistics of the sensors' streams, by name: ``depth``, ``planar`` and the beams.
        fix: set parameters of the autopilot that are not as they should be. Nothing else is changed.
        skip: names of checks that are not made.
        height_m: the measured height above ground, None when it is not known.
        clock: what time it is; by default that of this computer.
        link_problem: what the gate says is wrong with the link; empty: nothing.
        rc_switch: the transmitter's switch; None: there is none.
        started: whether somebody has started the flight already.

    Raises:
        InputError: ``skip`` names a check that does not exist.
    """
    _refuse_unknown(skip, settings)
    clock = clock or MonotonicClock()
    # First, since it may wait: what the others look at is as it is after that.
    clock_result = _skipped("clock") if "clock" in skip else await check_clock(telemetry, clock)
    now_s = clock.now_s()
    state = telemetry.state(now_s)
    results = [
        *_connection(link, state, settings, now_s, link_problem),
        clock_result,
        *_sensors(inputs, settings),
        _height(height_m, settings),
        estimator(link.kind, state, settings.autopilot),
        standing(link.kind, state),
        *await origin(link, lambda: telemetry.state(clock.now_s()), settings.autopilot),
        prearm(link.kind, state, telemetry.texts, now_s),
        await battery(link, state, settings.mission),
        _storage(settings),
        _disarmed(state),
        _mode(state),
        *check_switch(rc_switch, started, now_s),
        braking(link.kind, settings),
    ]
    results = [_skipped(result.name) if result.name in skip else result for result in results]
    for rule in rules(link.kind, settings):
        results.append(_skipped(rule.name) if rule.name in skip else await check_rule(link, rule, fix))
    return results


def _refuse_unknown(skip: Collection[str], settings: Settings) -> None:
    known = check_names(settings)
    unknown = sorted(set(skip) - set(known))
    if unknown:
        raise InputError(
            f"cannot skip {', '.join(unknown)}: no such check. The checks are: {', '.join(dict.fromkeys(known))}"
        )


def _skipped(name: str) -> CheckResult:
    return CheckResult(name, False, "skipped", "", "", skipped=True)


def _connection(
    link: Link, state: VehicleState, settings: Settings, now_s: float, link_problem: str
) -> Iterator[CheckResult]:
    ok = state.heartbeat_age_s <= HEARTBEAT_AGE_S and not link_problem
    yield CheckResult(
        "link",
        ok,
        f"last heartbeat {age(state.heartbeat_age_s)}" + (f"; {link_problem}" if link_problem else ""),
        f"not older than {HEARTBEAT_AGE_S:g} s, and nothing wrong",
        "Heartbeats come once a second; a link that loses three in a row is not one to fly on. Of two vehicles of one "
        "number nobody knows which would be armed.",
        "" if ok else "mend what the gate names" if link_problem else "look at cable, radio and autopilot.url",
    )
    heartbeats_hz = link.watch("HEARTBEAT").rate_hz(now_s)
    several = heartbeats_hz >= SEVERAL_HZ
    found = f"{link.kind.value} {state.version or 'of unknown version'}, system {link.system_id}"
    if several:
        found += f"; {heartbeats_hz:g} heartbeats of it a second: two senders call themselves that"
    yield CheckResult(
        "autopilot",
        not several,
        found,
        "px4 or ardupilot, one of that number",
        "What is expected of an autopilot was measured on PX4 main of August 2025 and ArduCopter 4.7-dev. Of two with "
        "one number nobody knows which would be armed, and whose position that is.",
        "give each vehicle a system id of its own (MAV_SYS_ID, SYSID_THISMAV), or end the second way to the same one"
        if several
        else "",
    )
    for name, message, asked_hz in (
        ("attitude", "ATTITUDE", settings.autopilot.attitude_hz),
        ("position", "LOCAL_POSITION_NED", settings.autopilot.position_hz),
    ):
        stream = link.watch(message)
        rate_hz, age_s, least_hz = stream.rate_hz(now_s), stream.age_s(now_s), RATE_SHARE * asked_hz
        ok = rate_hz >= least_hz and age_s <= POSE_AGE_S
        yield CheckResult(
            name,
            ok,
            f"{message} at {rate_hz:.1f} Hz, newest {age(age_s)}",
            f"at least {least_hz:g} Hz, not older than {POSE_AGE_S:g} s",
            "Every depth image is placed by the pose at its own time, interpolated between these messages.",
            ""
            if ok
            else f"a faster link, or a lower autopilot.{name}_hz; LOCAL_POSITION_NED comes once there is a position",
        )


def _sensor_names(settings: Settings) -> tuple[str, ...]:
    planar = ("planar",) if settings.sensors.planar.enabled else ()
    return ("depth", *(beam.value for beam in settings.sensors.beams.directions), *planar)


def _sensors(inputs: Mapping[str, StreamStatistics], settings: Settings) -> Iterator[CheckResult]:
    sensors = settings.sensors
    for name in _sensor_names(settings):
        if name == "depth":
            asked_hz, oldest_s = sensors.camera.rate_hz, sensors.scan.stale_after_s
            reason = "Without a look ahead that is fresh the vehicle stands still."
        elif name == "planar":
            asked_hz, oldest_s = sensors.planar.rate_hz, sensors.scan.stale_after_s
            reason = "It is configured, so the vehicle counts on it."
        else:
            asked_hz, oldest_s = sensors.beams.rate_hz, sensors.beams.stale_after_s
            reason = (
                "The height law holds the height above ground by it."
                if name == Beam.DOWN
                else "It is configured, so the vehicle counts on it where the camera does not look."
            )
        found = inputs.get(name)
        rate_hz, age_s = (0.0, math.inf) if found is None else (found.rate_hz, found.age_s)
        ok = rate_hz >= RATE_SHARE * asked_hz and age_s <= oldest_s
        refused = "" if found is None or ok else told(found)
        what_to_do = "" if found is None else remedy(found)
        yield CheckResult(
            name,
            ok,
            f"{rate_hz:.1f} Hz, newest {age(age_s)}" + (f"; {refused}" if refused else ""),
            f"at least {RATE_SHARE * asked_hz:g} Hz, not older than {oldest_s:g} s",
            reason,
            "" if ok else what_to_do or "look at the sensor and at sensors.drivers, or take it out of the settings",
        )


def _height(height_m: float | None, settings: Settings) -> CheckResult:
    most_m = min(STANDING_M, settings.control.height_m)
    ok = height_m is not None and 0.0 < height_m < most_m
    return CheckResult(
        "height",
        ok,
        "not measured" if height_m is None else f"{height_m:.2f} m",
        f"above 0 and below {most_m:g} m while it stands",
        "The take-off ends when this measurement says so.",
        "" if ok else "look at the beam that looks down; if it cannot see this near, --skip height",
    )


def _storage(settings: Settings) -> CheckResult:
    folder = Path(settings.record.folder).absolute()
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    need_mb = MAP_MB + (settings.record.largest_mb if settings.record.enabled else 0.0)
    try:
        with tempfile.TemporaryFile(dir=existing):
            free_mb = shutil.disk_usage(existing).free / MB
    except OSError as error:
        found, ok = f"{existing}: {error.strerror}", False
    else:
        found, ok = f"{free_mb:.0f} MB free in {existing}", free_mb >= need_mb
    return CheckResult(
        "storage",
        ok,
        found,
        f"writable, {need_mb:g} MB free",
        "The recording and the map are written during and after the flight.",
        "" if ok else "make room, lower record.largest_mb, or name another record.folder",
    )


def _disarmed(state: VehicleState) -> CheckResult:
    return CheckResult(
        "disarmed",
        not state.armed,
        "armed" if state.armed else "disarmed",
        "disarmed",
        "A vehicle that is armed already is in somebody's hands.",
        "land and disarm it" if state.armed else "",
    )


def _mode(state: VehicleState) -> CheckResult:
    stands = state.mode in _LANDED_IN and not state.armed
    ok = state.mode != "unknown" and (stands or state.mode not in _BUSY_MODES)
    return CheckResult(
        "mode",
        ok,
        state.mode,
        "known, and not one that flies or lands by itself",
        "A mode like this says that a mission or a failsafe of the autopilot is at work.",
        "" if ok else "choose hold (PX4) or guided (ArduPilot) at the ground station",
    )


def braking(kind: AutopilotKind, settings: Settings) -> CheckResult:
    """The check of ``control.governor.brake_mps2`` and ``safety.hold_creep_m``.

    It does not ask for ``control.speed_law``: without the governor the gate still counts on them: in the stopping
    budget, before its hard limit and before the fence.
    """
    counted_mps2, counted_m = settings.control.governor.brake_mps2, settings.safety.hold_creep_m
    needed_m = MEASURED_HOLD_CREEP_M[kind]
    wrong = []
    if counted_mps2 > MEASURED_BRAKE_MPS2:
        wrong.append(f"control.governor.brake_mps2: {MEASURED_BRAKE_MPS2:g}")
    if counted_m < needed_m:
        wrong.append(f"safety.hold_creep_m: {needed_m:g}")
    return CheckResult(
        BRAKING,
        not wrong,
        f"counted on: {counted_mps2:g} m/s², then {counted_m:g} m in hold",
        f"at most {MEASURED_BRAKE_MPS2:g} m/s², at least {needed_m:g} m",
        f"It was measured to brake with {MEASURED_BRAKE_MPS2:g} m/s², and to wander in its hold by up to "
        f"{needed_m:g} m: with more braking or less wandering in the settings the law slows down too late, and the "
        "stopping budget does not hold.",
        f"set {' and '.join(wrong)} in the settings file (--fix changes only parameters); if this vehicle was measured "
        f"to do better, --skip {BRAKING}"
        if wrong
        else "",
    )
