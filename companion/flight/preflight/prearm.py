"""The check of what the autopilot itself has against being armed."""

from __future__ import annotations

from collections.abc import Sequence

from companion.autopilot.vehicle_state import PrearmState, StatusText, VehicleState
from companion.flight.preflight.result import CheckResult
from companion.mavlink.firmware import AutopilotKind

PREARM = "prearm"
BEGINS = "PreArm: "
RECENT_S = 35.0
"""ArduPilot says all its reasons at least every 30 s ..."""
TOGETHER_S = 2.0
"""... one after the other: those that are older than the newest by more than this may be over."""

_FIXES = {
    PrearmState.UNKNOWN: "SYS_STATUS is asked for once a second: look at the link",
    PrearmState.OFF: "switch them on (ARMING_CHECK 1): what they would find is found in the air else",
    PrearmState.FAILING: "see to what it says; its sensors need up to 45 s after it was switched on, standing still",
}


def prearm(kind: AutopilotKind, state: VehicleState, texts: Sequence[StatusText], now_s: float) -> CheckResult:
    """Whether it can be armed, with its own reasons.

    PX4 says it of the mode that it is in, not of the one in which it is armed: there it is shown and refuses nothing.

    Args:
        kind: of the firmware.
        state: of the vehicle.
        texts: that it said, oldest first.
        now_s: time.
    """
    passed = state.prearm is PrearmState.PASSED
    if kind is AutopilotKind.PX4:
        found, wanted = f"{state.prearm.value} (in the mode {state.mode})", "shown only: PX4 decides by the mode"
        return CheckResult(PREARM, True, found, wanted, "It is armed in another mode than it may be in now.")
    said = reasons(texts, now_s) if state.prearm is PrearmState.FAILING else ()
    found = f"{state.prearm.value}: {'; '.join(said)}" if said else state.prearm.value
    reason = "What its own checks have against arming would be said at the take-off, when everybody has stepped back."
    return CheckResult(PREARM, passed, found, PrearmState.PASSED.value, reason, _FIXES.get(state.prearm, ""))


def reasons(texts: Sequence[StatusText], now_s: float) -> tuple[str, ...]:
    """What it said last is in the way, each once, in its own words."""
    recent = [one for one in texts if one.text.startswith(BEGINS) and now_s - one.received_s <= RECENT_S]
    newest_s = recent[-1].received_s if recent else now_s
    last = [one.text.removeprefix(BEGINS) for one in recent if newest_s - one.received_s <= TOGETHER_S]
    return tuple(dict.fromkeys(last))
