"""The check ``clock``: is it known well enough when the autopilot measured what it says, and why not."""

from __future__ import annotations

from companion.autopilot.telemetry import Telemetry
from companion.clock import Clock
from companion.flight.preflight.result import CheckResult

CLOCK_S = 0.03
"""Images are placed by the pose at their time: the two clocks have to agree at least so well."""
SECOND_LOOK_S = 5.0
"""So long it is looked again before a flight is refused: one slow or lost answer is no reason."""
LOOK_PERIOD_S = 0.2
NOTEWORTHY_PERCENT = 0.1
"""Crystals are not so far apart: a clock that is off by more is a simulation's."""


async def check_clock(telemetry: Telemetry, clock: Clock) -> CheckResult:
    """Whether the autopilot's clock is known to `CLOCK_S`, if need be after waiting for better TIMESYNC answers."""
    until_s = clock.now_s() + SECOND_LOOK_S
    while not _known(telemetry) and clock.now_s() < until_s:
        await clock.sleep(LOOK_PERIOD_S)
    residual_s, drift = telemetry.clock_residual_s, _drift(telemetry)
    found = "not aligned" if residual_s is None else f"known to {residual_s * 1e3:.1f} ms"
    ok = _known(telemetry)
    return CheckResult(
        "clock",
        ok,
        f"{found}; {drift}" if drift else found,
        f"to {CLOCK_S * 1e3:g} ms",
        f"{CLOCK_S * 1e3:g} ms between the clocks of autopilot and camera turn an image by a degree at 0.6 rad/s.",
        "" if ok else _what_to_do(telemetry, drift),
    )


def _known(telemetry: Telemetry) -> bool:
    residual_s = telemetry.clock_residual_s
    return residual_s is not None and residual_s <= CLOCK_S


def _drift(telemetry: Telemetry) -> str:
    """How far the autopilot's clock is from keeping time; empty when it does."""
    percent = 0.0 if telemetry.clock_rate is None else 100.0 * (telemetry.clock_rate - 1.0)
    if abs(percent) < NOTEWORTHY_PERCENT:
        return ""
    return f"the autopilot's clock runs {abs(percent):.1f} % {'slow' if percent < 0.0 else 'fast'}"


def _what_to_do(telemetry: Telemetry, drift: str) -> str:
    """The cause that stands in front, and the remedy."""
    round_trip_s = telemetry.clock_round_trip_s
    if round_trip_s is None:
        return (
            "TIMESYNC is not answered, or by another clock than that of the messages: let it pass both ways (a router "
            "or radio between may drop it), let only the autopilot answer it, and let a simulation run at speed 1"
        )
    half_s = 0.5 * round_trip_s
    if half_s > CLOCK_S or (half_s > 0.5 * CLOCK_S and not drift):
        return (
            f"the quickest TIMESYNC round trip takes {round_trip_s * 1e3:.0f} ms: a faster link (a cable instead of a "
            "radio, a higher baud rate), or lower autopilot.attitude_hz and position_hz"
        )
    if drift:
        return (
            f"{drift}: a simulation that does not keep real time; give it a computer that does nothing else, or "
            "real-time priority"
        )
    return (
        f"TIMESYNC answers are lost or contradict each other, though the quickest takes {round_trip_s * 1e3:.0f} ms: "
        "look at the link's load, and let a simulation run at speed 1"
    )
