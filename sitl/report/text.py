"""Values in words: what stands on the cards and in the table of a report."""

from __future__ import annotations

import math
import numbers
from collections.abc import Iterator, Mapping

UNKNOWN = "-"
_LISTED = 12


def number(summary: Mapping[str, object], key: str) -> float | None:
    """The finite number under ``key``, or ``None``."""
    value = summary.get(key)
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not math.isfinite(value):
        return None
    return float(value)


def shown(value: object) -> str:
    """Any value of a summary for people: six digits, and what is not known as `UNKNOWN`."""
    if value is None:
        return UNKNOWN
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, numbers.Integral):
        return str(int(value))
    if isinstance(value, numbers.Real):
        return f"{float(value):.6g}" if math.isfinite(value) else UNKNOWN
    if isinstance(value, (list, tuple)):
        parts = [shown(part) for part in value[:_LISTED]]
        more = f" ... ({len(value)} in all)" if len(value) > _LISTED else ""
        return ", ".join(parts) + more if parts else UNKNOWN
    return str(value)


def rows(summary: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Name and value of everything in a summary; what is nested gets names with dots."""
    for key, value in summary.items():
        if isinstance(value, Mapping):
            yield from rows(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", shown(value)


def seconds(value_s: float) -> str:
    """A duration: seconds, and from two minutes on minutes too."""
    if value_s < 10.0:
        return f"{value_s:.1f} s"
    return f"{value_s:.0f} s" if value_s < 120.0 else f"{value_s:.0f} s ({minutes(value_s)})"


def minutes(value_s: float) -> str:
    """A duration in minutes and seconds."""
    whole, rest = divmod(round(value_s), 60)
    return f"{whole} min {rest:02d} s"
