"""The check of the transmitter's switch: it is heard, and it does not stand where it would start the flight."""

from __future__ import annotations

from companion.autopilot.rc_switch import Position, RcSwitch
from companion.flight.preflight.result import CheckResult

RC_SWITCH = "rc_switch"


def check_switch(switch: RcSwitch | None, started: bool, now_s: float) -> tuple[CheckResult, ...]:
    """The check, where a switch is configured.

    Args:
        switch: of the transmitter; None: there is none.
        started: whether the flight was started, by which it may stand high.
        now_s: when.
    """
    if switch is None:
        return ()
    position = switch.position(now_s)
    on = position is Position.HIGH and not started
    heard = position is not None
    what_to_do = "" if heard else "switch the transmitter on, and look at mission.rc_switch.channel and the receiver"
    return (
        CheckResult(
            RC_SWITCH,
            heard and not on,
            f"stands {position.value}" if position is not None else f"not heard: {switch.problem(now_s)}",
            "heard, and not high before the start",
            "The pilot counts on it; one that is on already would start a flight that nobody has just asked for.",
            "switch it off" if on else what_to_do,
        ),
    )
