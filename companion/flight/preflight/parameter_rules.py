"""The rules of the autopilot's parameters: what happens when we fall silent, and what could hurt underground."""

from __future__ import annotations

from functools import partial

from companion.config.settings import Settings
from companion.flight.preflight.parameter_check import Demand, Rule, at_least, between, bits, exactly, one_of
from companion.mavlink.firmware import AutopilotKind

SETPOINTS_MISSED = 3
"""A failsafe that acts on fewer missed setpoints than this acts on the jitter of a healthy link."""
CRUISE_MPS = 1.0
LIFT_OFF_S = 15.0
"""From arming until PX4 may disarm a vehicle that has not left the ground: nearly three times the measured 5.4 s."""
_HOLD_AND_OFFBOARD = (2 | 4, "hold and offboard go on")
"""Of COM_RCL_EXCEPT and COM_DLL_EXCEPT: the modes that application, gate and failsafes fly. LAND needs none: what is
landing does not return."""
ARDUPILOT_ACCEL_CMPSS, ARDUPILOT_JERK_MPSSS = 250.0, 5.0
"""WPNAV_ACCEL / PSC_JERK_XY is the time constant of its braking: 0.5 s with the defaults, which were measured."""


def rules(kind: AutopilotKind, settings: Settings) -> tuple[Rule, ...]:
    """The rules for an autopilot, flown as configured."""
    if kind is AutopilotKind.PX4:
        return _px4(settings) + (() if settings.autopilot.gps else _px4_without_gps())
    return _ardupilot(settings) + (() if settings.autopilot.gps else _ardupilot_without_gps())


def parameter_check_names(settings: Settings) -> tuple[str, ...]:
    """The names of the checks of both autopilots."""
    return tuple(rule.name for kind in AutopilotKind for rule in rules(kind, settings))


def _silence(name: str, settings: Settings) -> Demand:
    high_s = settings.autopilot.silence_s
    low_s = min(SETPOINTS_MISSED * settings.control.period_s, high_s)
    return Demand(name, f"{low_s:g} to {high_s:g} s", high_s, low=low_s, high=high_s)


def _px4(settings: Settings) -> tuple[Rule, ...]:
    control = settings.control
    cruise_mps = max(CRUISE_MPS, control.speed_mps)
    critical_share = max(0.07, settings.mission.battery_low_percent / 100.0)
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
            ((exactly("COM_OBL_RC_ACT", 5),),),
            f"What PX4 does when setpoints stop: with 5 it {then}; the default 0 (position mode) cannot run without a "
            "transmitter, and then it descends and hardly brakes.",
            required=True,
        ),
        Rule(
            ((bits("COM_RCL_EXCEPT", *_HOLD_AND_OFFBOARD),), (one_of("NAV_RCL_ACT", (3,), "land"),)),
            "Underground the transmitter is soon out of reach. With offboard alone excepted PX4 flies on without it, "
            "but the next hold, the gate's or a failsafe's, ends after 5 s in a return: it climbed 6 m and flew home. "
            "Hold as action (1) hovers where nobody reaches it until the battery is empty.",
        ),
        Rule(
            (
                (one_of("NAV_DLL_ACT", (0, 3), "nothing, land"),),
                (bits("COM_DLL_EXCEPT", *_HOLD_AND_OFFBOARD),),
            ),
            "Underground the ground station is soon out of reach: as for the transmitter, a return would first climb.",
        ),
        Rule(
            ((exactly("COM_LOW_BAT_ACT", 2),),),
            "The last line when application and gate are dead and the vehicle holds: at BAT_CRIT_THR 2 lands; 3 "
            "returns, which first climbs, and 0 only warns and hovers until it falls.",
        ),
        Rule(
            ((between("BAT_CRIT_THR", 0.05, critical_share, min(0.07, critical_share)),),),
            "There PX4 lands by itself: above nothing, and below mission.battery_low_percent, at which the application "
            "ends the flight.",
        ),
        Rule(
            ((between("BAT_LOW_THR", 0.1, 0.5, 0.15),),),
            "From there on PX4 calls the battery low, and the application ends the flight whatever percent is shown.",
        ),
        Rule(
            (
                (
                    Demand(
                        "COM_DISARM_PRFLT",
                        f"at least {LIFT_OFF_S:g} s, or at most 0 (never)",
                        LIFT_OFF_S,
                        low=LIFT_OFF_S,
                    ),
                ),
                (Demand("COM_DISARM_PRFLT", "at most 0", 0.0, high=0.0),),
            ),
            "So long after arming PX4 disarms a vehicle that has not left the ground. By our setpoints it was measured "
            f"to leave it after 5.4 s; {LIFT_OFF_S:g} s lets a heavier one take nearly three times as long, the "
            "default of 10 s leaves 4.6 s.",
        ),
        Rule(
            ((Demand("EKF2_NOAID_TOUT", "at most 1000000 µs", 1_000_000, low=0.0, high=1e6),),),
            "Without position PX4 flies by dead reckoning for 5 s by default, and reached 1.75 m/s; with 1 s it "
            "descends after 0.75 s.",
        ),
        Rule(
            ((between("MPC_XY_CRUISE", 0.1, cruise_mps, cruise_mps),),),
            "So fast PX4 flies to a place that it has to hold or to land at, which is never further away than the way "
            "of a stop. Should it ever take a wrong place (0°/0°), the default of 5 m/s was in a wall before anybody "
            f"could act; {cruise_mps:g} m/s is no more than a brisk walk, and leaves seconds to take it away.",
        ),
        Rule(
            ((at_least("MPC_XY_VEL_MAX", control.speed_mps),),),
            "The vehicle would be slower than control.speed_mps, and the law would wait for it.",
        ),
        Rule(
            ((at_least("MPC_Z_VEL_MAX_UP", control.max_climb_mps),),),
            "The vehicle would climb slower than control.max_climb_mps, and rising ground would come nearer.",
        ),
        Rule(
            ((at_least("MPC_Z_VEL_MAX_DN", control.max_climb_mps),),),
            "The vehicle would sink slower than control.max_climb_mps, and a falling roof would come nearer.",
        ),
    )


def _px4_without_gps() -> tuple[Rule, ...]:
    rule = partial(_without_gps, "PX4", reboot=True)
    return (
        rule(exactly("SYS_HAS_GPS", 0)),
        rule(exactly("SYS_HAS_MAG", 0)),
        rule(exactly("EKF2_GPS_CTRL", 0)),
        rule(one_of("EKF2_EV_CTRL", (15, 11), "ODOMETRY, VISION_POSITION_ESTIMATE"), required=True),
        rule(exactly("EKF2_HGT_REF", 3), required=True),
        rule(exactly("EKF2_MAG_TYPE", 5)),
        rule(exactly("COM_ARM_WO_GPS", 1), reboot=False),
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
            ((exactly("GUID_OPTIONS", 0),),),
            "Its options change what guided mode makes of a velocity; all measurements were made with 0.",
            required=True,
        ),
        Rule(
            (
                (exactly("AVOID_ENABLE", 0),),
                (
                    Demand("AVOID_MARGIN", f"below {critical_m:g} m", below_m, low=0.0, high=below_m),
                    exactly("AVOID_BACKUP_SPD", 0.0),
                ),
            ),
            "Its own avoidance acts in guided: with a wall at 1.2 m it flew backwards at 0.77 m/s on a zero command.",
        ),
        Rule(
            (
                (one_of("FS_THR_ENABLE", (3, 0, 7), "land, nothing, brake"),),
                (bits("FS_OPTIONS", 4, "guided goes on"),),
            ),
            f"Underground the transmitter is soon out of reach: by default ArduPilot then {climbs}.",
        ),
        Rule(
            ((one_of("FS_GCS_ENABLE", (0, 5, 7), "nothing, land, brake"),),),
            f"Underground the ground station is soon out of reach: with 1 ArduPilot then {climbs}.",
        ),
        Rule(
            ((one_of("FS_EKF_ACTION", (1, 3), "land"),),),
            "When the estimator fails, nothing but landing is possible underground.",
        ),
        Rule(
            ((exactly("BATT_FS_LOW_ACT", 1),),),
            "The last line when application and gate are dead and the vehicle hovers in guided. By default nothing is "
            f"done; 2, 3, 4 and 6 make that ArduPilot {climbs}; brake (7) needs twice the way of a stop by zero "
            "velocity, and then hovers on until the battery is empty. Land (1) is what the application does as well.",
        ),
        Rule(
            ((exactly("BATT_FS_CRT_ACT", 1),),),
            f"On a critical battery nothing is left but to land: 0 hovers until it falls, 2, 3, 4 and 6 make that "
            f"ArduPilot {climbs}.",
        ),
        Rule(
            ((Demand("BATT_LOW_VOLT", "above 0 V", None, low=0.1),),),
            "Percent is a coulomb count that begins at 100 % at each boot, whatever the battery has left: only a "
            "voltage tells that it is low. At BATT_LOW_VOLT ArduPilot was measured to say so, and to act.",
            advice="param set BATT_LOW_VOLT to the voltage at which this battery has to be on the ground, about 3.5 V "
            "a cell; --fix does not know its cells",
        ),
        Rule(
            ((between("WPNAV_ACCEL", 50.0, ARDUPILOT_ACCEL_CMPSS, ARDUPILOT_ACCEL_CMPSS),),),
            "Braking rests on WPNAV_ACCEL / PSC_JERK_XY, 0.5 s with the defaults: from 0.5 m/s zero velocity then took "
            "0.29 m and silence 0.54 m; with WPNAV_ACCEL 500 it was 0.52 and 0.72 m.",
            required=True,
        ),
        Rule(
            ((at_least("PSC_JERK_XY", ARDUPILOT_JERK_MPSSS),),),
            "Braking rests on WPNAV_ACCEL / PSC_JERK_XY: from 0.5 m/s silence took 0.54 m with the default of 5, 0.84 "
            "m with 2, and 1.24 m (from 0.43 m/s) with 1.",
            required=True,
        ),
    )


def _ardupilot_without_gps() -> tuple[Rule, ...]:
    rule = partial(_without_gps, "ArduPilot")
    sources = ("EK3_SRC1_POSXY", "EK3_SRC1_VELXY", "EK3_SRC1_POSZ", "EK3_SRC1_VELZ", "EK3_SRC1_YAW")
    return (
        rule(exactly("GPS1_TYPE", 0), reboot=True),
        rule(exactly("VISO_TYPE", 1), required=True, reboot=True),
        *(rule(exactly(name, 6), required=True) for name in sources),
        rule(exactly("COMPASS_ENABLE", 0), reboot=True),
        *(rule(exactly(name, 0)) for name in ("COMPASS_USE", "COMPASS_USE2", "COMPASS_USE3")),
    )


def _without_gps(autopilot: str, demand: Demand, required: bool = False, reboot: bool = False) -> Rule:
    why = f"Without GPS {autopilot} flew by external odometry with this value."
    return Rule(((demand,),), why, required, reboot)
