"""The checks of what the autopilot knows about where it is."""

from __future__ import annotations

from companion.autopilot.vehicle_state import VehicleState
from companion.config.autopilot import AutopilotSettings
from companion.flight.preflight.result import CheckResult, age
from companion.mavlink.estimator import ESTIMATOR, not_known
from companion.mavlink.firmware import AutopilotKind

POSE_AGE_S = 0.25
STANDING = "standing"
STANDING_MPS = 0.1
"""A healthy estimate is wrong by 0.01 to 0.03 m/s; one with 0.11 drifted into walls on zero velocity."""


def estimator(kind: AutopilotKind, state: VehicleState, autopilot: AutopilotSettings) -> CheckResult:
    """Whether it knows attitude, velocity and position, and if not: what of them, and what to do about that."""
    flags = state.estimator_flags
    lacking = () if flags is None else not_known(kind, flags)
    fresh = state.pose_age_s <= 2.0 * POSE_AGE_S
    if flags is None:
        found = f"no {ESTIMATOR[kind]} comes"
        fix = "it is asked for five times a second: look at the link, and at the rates that this port may send"
    elif lacking:
        found = f"{_listed(lacking)} {'is' if len(lacking) == 1 else 'are'} not known (flags {flags})"
        fix = _what_to_do(kind, lacking, autopilot)
    else:
        found = f"attitude, velocity and position are known (flags {flags}), pose {age(state.pose_age_s)}"
        fix = (
            ""
            if fresh
            else "its estimate is good, but its messages come late: look at the checks attitude and position"
        )
    return CheckResult(
        "estimator",
        flags is not None and not lacking and fresh,
        found,
        f"attitude, velocity and position known, not older than {2.0 * POSE_AGE_S:g} s",
        "A velocity means nothing to an autopilot that does not know its own.",
        fix,
    )


def standing(kind: AutopilotKind, state: VehicleState) -> CheckResult:
    """Whether an autopilot that stands says that it stands."""
    speed_mps = state.speed_mps
    ok = speed_mps is not None and speed_mps < STANDING_MPS
    fix = "stand it still, and see that its odometry or its GPS does not drift and that nothing shakes it"
    if kind is AutopilotKind.PX4:
        fix += "; PX4's simulator SIH needs EKF2_ACC_NOISE 1.0 and EKF2_GYR_NOISE 0.1, which its noise really has"
    return CheckResult(
        STANDING,
        ok,
        "its velocity is not known" if speed_mps is None else f"it says to move at {speed_mps:.2f} m/s",
        f"below {STANDING_MPS:g} m/s while it stands (median of 3 s)",
        "An estimator that does not know that it stands makes zero velocity a drift: every stop rests on it.",
        "" if ok else fix,
    )


def _listed(words: tuple[str, ...]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _what_to_do(kind: AutopilotKind, lacking: tuple[str, ...], autopilot: AutopilotSettings) -> str:
    if "acceleration" in lacking:
        return "its accelerometers disagree with what it flies: calibrate them, and look for vibration"
    if "attitude" in lacking:
        return "stand it level and still until its gyroscopes are calibrated; if it stays so, reboot the autopilot"
    if lacking == ("vertical velocity",):
        source = "EKF2_HGT_REF" if kind is AutopilotKind.PX4 else "EK3_SRC1_POSZ and EK3_SRC1_VELZ"
        return f"look at what its height comes from ({source})"
    if autopilot.gps:
        return (
            "its GPS has no fix that it takes: go where it sees the sky; an autopilot without GPS needs autopilot.gps: "
            "false and external odometry"
        )
    how = "EKF2_EV_CTRL 15 and a reboot" if kind is AutopilotKind.PX4 else "VISO_TYPE 1, EK3_SRC1_... 6 and a reboot"
    return (
        "no odometry that it takes reaches it: start the program that sends ODOMETRY to the autopilot, see that the "
        f"address and the frame are right (docs/flying.md, Without GPS), and that the autopilot fuses it ({how})"
    )
