"""Rules and check of the autopilot's parameters: what happens when we fall silent, and what could hurt underground."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from companion.autopilot.interface import Link, LinkError
from companion.config.settings import Settings
from companion.flight.preflight.result import CheckResult
from companion.mavlink.firmware import AutopilotKind

Value = float | int
SAME = 1e-6
"""Parameters are 32-bit floats on the wire."""
SETPOINTS_MISSED = 3
"""A failsafe that acts on fewer missed setpoints than this acts on the jitter of a healthy link."""

CRUISE_MPS = 1.0


@dataclass(frozen=True, slots=True)
class Demand:
    """What one parameter must be: one of ``values``, or from ``low`` to ``high``, or with the bit of ``bit`` set."""

    name: str
    wanted: str
    set_to: Value
    values: tuple[Value, ...] = ()
    low: float = -math.inf
    high: float = math.inf
    bit: int | None = None

    def met_by(self, value: Value) -> bool:
        """Whether a value will do."""
        if not math.isfinite(value):
            return False
        if self.bit is not None:
            return bool(int(value) & self.bit)
        if self.values:
            return any(math.isclose(value, one, rel_tol=SAME, abs_tol=SAME) for one in self.values)
        slack = SAME * max(1.0, abs(value))
        return self.low - slack <= value <= self.high + slack

    def fixed(self, value: Value) -> Value:
        """What to set it to when it is ``value``."""
        return int(value) | self.bit if self.bit is not None else self.set_to


@dataclass(frozen=True, slots=True)
class Rule:
    """One check of parameters.

    Attributes:
        either: the rule holds when all demands of one of these groups are met; the first is what --fix sets.
        reason: why, in one sentence with the measured fact.
        required: whether the check fails when the autopilot has no such parameter.
        reboot: whether the autopilot obeys a new value only after a reboot.
    """

    either: tuple[tuple[Demand, ...], ...]
    reason: str
    required: bool = False
    reboot: bool = False

    @property
    def name(self) -> str:
        """Of the check: that of its first parameter."""
        return self.either[0][0].name

    @property
    def wanted(self) -> str:
        """In words."""
        return ", or ".join(" and ".join(f"{one.name} {one.wanted}" for one in group) for group in self.either)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The names of all that are looked at."""
        return tuple(dict.fromkeys(one.name for group in self.either for one in group))


def rules(kind: AutopilotKind, settings: Settings) -> tuple[Rule, ...]:
    """The rules for an autopilot, flown as configured."""
    if kind is AutopilotKind.PX4:
        return _px4(settings) + (() if settings.autopilot.gps else _px4_without_gps())
    return _ardupilot(settings) + (() if settings.autopilot.gps else _ardupilot_without_gps())


def parameter_check_names(settings: Settings) -> tuple[str, ...]:
    """The names of the checks of both autopilots."""
    return tuple(rule.name for kind in AutopilotKind for rule in rules(kind, settings))


def _exactly(name: str, value: Value) -> Demand:
    return Demand(name, f"{value:g}", value, values=(value,))


def _one_of(name: str, values: tuple[Value, ...], meaning: str) -> Demand:
    return Demand(name, f"{' or '.join(f'{value:g}' for value in values)} ({meaning})", values[0], values=values)


def _at_least(name: str, low: float) -> Demand:
    return Demand(name, f"at least {low:g}", low, low=low)


def _bit(name: str, bit: int, meaning: str) -> Demand:
    return Demand(name, f"with bit value {bit} ({meaning})", bit, bit=bit)


def _silence(name: str, settings: Settings) -> Demand:
    high_s = settings.autopilot.silence_s
    low_s = min(SETPOINTS_MISSED * settings.control.period_s, high_s)
    return Demand(name, f"{low_s:g} to {high_s:g} s", high_s, low=low_s, high=high_s)


def _px4(settings: Settings) -> tuple[Rule, ...]:
    control = settings.control
    cruise_mps = max(CRUISE_MPS, control.speed_mps)
    then = (
        "stops and holds"
        if settings.autopilot.gps
        else "stops and holds (without GPS, where hold may not be possible, it lands)"
    )
    return (
        Rule(
            ((_silence("COM_OF_LOSS_T", settings),),),
            "How long PX4 flies on when setpoints stop: by default 1 s; with 0.5 s it stood 1.25 s after the loss, "
            "0.4 m further at 0.5 m/s.",
            required=True,
        ),
        Rule(
            ((_exactly("COM_OBL_RC_ACT", 5),),),
            f"What PX4 does when setpoints stop: with 5 it {then}; the default 0 (position mode) cannot run without a "
            "transmitter, and then it descends and hardly brakes.",
            required=True,
        ),
        Rule(
            ((_bit("COM_RCL_EXCEPT", 4, "offboard goes on"),), (_one_of("NAV_RCL_ACT", (1, 3), "hold, land"),)),
            "Underground the transmitter is soon out of reach: the default action is to return, which first climbs.",
        ),
        Rule(
            (
                (_one_of("NAV_DLL_ACT", (0, 1, 3), "nothing, hold, land"),),
                (_bit("COM_DLL_EXCEPT", 4, "offboard goes on"),),
            ),
            "Underground the ground station is soon out of reach: to return would first climb.",
        ),
        Rule(
            ((_one_of("COM_LOW_BAT_ACT", (0, 2), "warn, land"),),),
            "On a low battery 3 returns, which first climbs; the application ends the flight before.",
        ),
        Rule(
            ((Demand("EKF2_NOAID_TOUT", "at most 1000000 µs", 1_000_000, low=0.0, high=1e6),),),
            "Without position PX4 flies by dead reckoning for 5 s by default, and reached 1.75 m/s; with 1 s it "
            "descends after 0.75 s.",
        ),
        Rule(
            ((Demand("MPC_XY_CRUISE", f"at most {cruise_mps:g} m/s", cruise_mps, low=0.1, high=cruise_mps),),),
            "So fast PX4 flies to a place that it has to hold or to land at, which is never further away than the way "
            "of a stop. Should it ever take a wrong place (0°/0°), the default of 5 m/s was in a wall before anybody "
            f"could act; {cruise_mps:g} m/s is no more than a brisk walk, and leaves seconds to take it away.",
        ),
        Rule(
            ((_at_least("MPC_XY_VEL_MAX", control.speed_mps),),),
            "The vehicle would be slower than control.speed_mps, and the law would wait for it.",
        ),
        Rule(
            ((_at_least("MPC_Z_VEL_MAX_UP", control.max_climb_mps),),),
            "The vehicle would climb slower than control.max_climb_mps, and rising ground would come nearer.",
        ),
        Rule(
            ((_at_least("MPC_Z_VEL_MAX_DN", control.max_climb_mps),),),
            "The vehicle would sink slower than control.max_climb_mps, and a falling roof would come nearer.",
        ),
    )


def _px4_without_gps() -> tuple[Rule, ...]:
    rule = partial(_without_gps, "PX4", reboot=True)
    return (
        rule(_exactly("SYS_HAS_GPS", 0)),
        rule(_exactly("SYS_HAS_MAG", 0)),
        rule(_exactly("EKF2_GPS_CTRL", 0)),
        rule(_one_of("EKF2_EV_CTRL", (15, 11), "ODOMETRY, VISION_POSITION_ESTIMATE"), required=True),
        rule(_exactly("EKF2_HGT_REF", 3), required=True),
        rule(_exactly("EKF2_MAG_TYPE", 5)),
        rule(_exactly("COM_ARM_WO_GPS", 1), reboot=False),
    )


def _ardupilot(settings: Settings) -> tuple[Rule, ...]:
    critical_m = settings.control.critical_margin_m
    below_m = round(critical_m - 0.1, 6)
    climbs = "returns, which first climbs"
    return (
        Rule(
            ((_silence("GUID_TIMEOUT", settings),),),
            "How long ArduPilot flies the last velocity over ground, and yaws, when setpoints stop: by default 3 s; "
            "with 0.5 s it stood after 1.7 s and 0.54 m.",
            required=True,
        ),
        Rule(
            ((_exactly("GUID_OPTIONS", 0),),),
            "Its options change what guided mode makes of a velocity; all measurements were made with 0.",
            required=True,
        ),
        Rule(
            (
                (_exactly("AVOID_ENABLE", 0),),
                (
                    Demand("AVOID_MARGIN", f"below {critical_m:g} m", below_m, low=0.0, high=below_m),
                    _exactly("AVOID_BACKUP_SPD", 0.0),
                ),
            ),
            "Its own avoidance acts in guided: with a wall at 1.2 m it flew backwards at 0.77 m/s on a zero command.",
        ),
        Rule(
            (
                (_one_of("FS_THR_ENABLE", (3, 0, 7), "land, nothing, brake"),),
                (_bit("FS_OPTIONS", 4, "guided goes on"),),
            ),
            f"Underground the transmitter is soon out of reach: by default ArduPilot then {climbs}.",
        ),
        Rule(
            ((_one_of("FS_GCS_ENABLE", (0, 5, 7), "nothing, land, brake"),),),
            f"Underground the ground station is soon out of reach: with 1 ArduPilot then {climbs}.",
        ),
        Rule(
            ((_one_of("FS_EKF_ACTION", (1, 3), "land"),),),
            "When the estimator fails, nothing but landing is possible underground.",
        ),
        Rule(
            ((_one_of("BATT_FS_LOW_ACT", (0, 1, 7), "nothing, land, brake"),),),
            f"On a low battery 2, 3 and 4 make that ArduPilot {climbs}; the application ends the flight before.",
        ),
        Rule(
            ((_one_of("BATT_FS_CRT_ACT", (1, 0, 7), "land, nothing, brake"),),),
            f"On a critical battery 2, 3 and 4 make that ArduPilot {climbs}.",
        ),
    )


def _ardupilot_without_gps() -> tuple[Rule, ...]:
    rule = partial(_without_gps, "ArduPilot")
    sources = ("EK3_SRC1_POSXY", "EK3_SRC1_VELXY", "EK3_SRC1_POSZ", "EK3_SRC1_VELZ", "EK3_SRC1_YAW")
    return (
        rule(_exactly("GPS1_TYPE", 0), reboot=True),
        rule(_exactly("VISO_TYPE", 1), required=True, reboot=True),
        *(rule(_exactly(name, 6), required=True) for name in sources),
        rule(_exactly("COMPASS_ENABLE", 0), reboot=True),
        *(rule(_exactly(name, 0)) for name in ("COMPASS_USE", "COMPASS_USE2", "COMPASS_USE3")),
    )


def _without_gps(autopilot: str, demand: Demand, required: bool = False, reboot: bool = False) -> Rule:
    why = f"Without GPS {autopilot} flew by external odometry with this value."
    return Rule(((demand,),), why, required, reboot)


async def check_rule(link: Link, rule: Rule, fix: bool) -> CheckResult:
    """Whether the autopilot's parameters are as a rule wants them; with ``fix`` they are made so. Never raises."""
    try:
        values = {name: await link.get_param(name) for name in rule.parameters}
    except LinkError as error:
        return CheckResult(rule.name, False, str(error), rule.wanted, rule.reason, "ask again on a better link")
    if all(value is None for value in values.values()):
        found = "the autopilot has no such parameter"
        return CheckResult(rule.name, not rule.required, found, rule.wanted, rule.reason)
    found = ", ".join(f"{name} {_value(value)}" for name, value in values.items())
    if _holds(rule, values):
        return CheckResult(rule.name, True, found, rule.wanted, rule.reason)
    group = next((group for group in rule.either if all(values[one.name] is not None for one in group)), ())
    changes = {one.name: one.fixed(value) for one in group if (value := values[one.name]) is not None}
    commands = " and ".join(f"param set {name} {_value(value)}" for name, value in changes.items())
    after = ", then reboot the autopilot" if rule.reboot else ""
    if not fix or not changes:
        return CheckResult(rule.name, False, found, rule.wanted, rule.reason, f"{commands}{after}, or --fix")
    try:
        for name, value in changes.items():
            await link.set_param(name, value)
    except LinkError as error:
        return CheckResult(rule.name, False, found, rule.wanted, rule.reason, f"--fix failed: {error}")
    done = f"set by --fix: {commands}"
    if rule.reboot:
        return CheckResult(rule.name, False, found, rule.wanted, rule.reason, f"{done}; reboot the autopilot to apply")
    return CheckResult(rule.name, True, f"was {found}", rule.wanted, rule.reason, done)


def _holds(rule: Rule, values: Mapping[str, Value | None]) -> bool:
    return any(
        all((value := values[one.name]) is not None and one.met_by(value) for one in group) for group in rule.either
    )


def _value(value: Value | None) -> str:
    return "(none)" if value is None else f"{value:.7g}"
