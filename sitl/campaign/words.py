"""Figures of groups in words: shares with their bounds, times that some missions never reach, distances."""

from __future__ import annotations

import math

from sitl.campaign.bounds import CONFIDENCE, at_most, between
from sitl.report.cards import UNKNOWN, seconds

NOT_REACHED = "not reached"
_NONE = "none was flown"


def sure() -> str:
    """How sure the bounds of `within` and `below` are."""
    return f"at {percent(CONFIDENCE, 0)}"


def share(count: int, of: int) -> str:
    """A share, rounded down: one of thousands that is missing must not read as 100 %."""
    return percent(math.floor(1000.0 * count / of) / 1000.0) if of else UNKNOWN


def within(count: int, of: int) -> str:
    """The bounds of a share from both sides, rounded away from it."""
    if not of:
        return _NONE
    low, high = between(count, of)
    low, high = math.floor(1000.0 * low) / 1000.0, math.ceil(1000.0 * high) / 1000.0
    return f"{percent(low)} to {percent(high)}"


def below(count: int, of: int) -> str:
    """The upper bound of a share of what must not happen, rounded up."""
    if not of:
        return _NONE
    return f"in at most {percent(math.ceil(1e4 * at_most(count, of)) / 1e4, 2)}"


def percent(value: float, digits: int = 1) -> str:
    """A share in per cent."""
    return f"{100.0 * value:.{digits}f} %"


def time(time_s: float) -> str:
    """A time in which a map became complete; endless where it never did."""
    return seconds(time_s) if math.isfinite(time_s) else NOT_REACHED


def metres(value_m: float | None, digits: int = 2) -> str:
    """A distance; endless where it ended at nothing."""
    return unit(value_m, "m", digits)


def unit(value: float | None, name: str, digits: int = 2) -> str:
    """A figure with its unit, where it is known and was reached."""
    if value is None:
        return UNKNOWN
    return f"{value:.{digits}f} {name}".rstrip() if math.isfinite(value) else NOT_REACHED
