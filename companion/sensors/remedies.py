"""What to do when readings come and are refused: every integrator of a sensor meets this first."""

from __future__ import annotations

from collections.abc import Mapping

from companion.sensors import sink
from companion.sensors.statistics import StreamStatistics

REMEDIES: Mapping[str, str] = {
    sink.FROM_THE_FUTURE: "stamp in seconds of the clock that the driver is handed: not in ms, nor in the time of day",
    sink.NOT_NEWER: "stamp each reading when it is measured: a stamp must be later than that of the reading before it",
    sink.NOT_A_TIME: "stamp in seconds, as a finite Python float: one of 32 bits is off by milliseconds after hours",
    sink.WRONG_SHAPE: "the image's rows and columns must be its camera's height_px and width_px",
    sink.WRONG_TYPE: "depth is float32 in m: an image of 16 bits in mm is to be divided by 1000, its zeros made NaN",
    sink.WRONG_CAMERA: "look at the camera's focal lengths, centre, mounting and 0 <= min_range_m < max_range_m",
    sink.WRONG_LIMIT: "give max_range_m, in m, as a number above 0",
    sink.WRONG_BEARINGS: "bearings are in rad, counter-clockwise from the heading, ascending from -π to below π",
    sink.NOT_POSITIVE: "what was not measured is NaN in an image and None for a beam, never 0 or less",
    sink.NO_SURFACE: "uncover the lens; look at the units (depth is in m: mm lie beyond max_range_m) and at the ranges",
    sink.FROZEN: "the sensor, or its driver, repeats one reading: start it anew",
}
"""By reason of the refusal; a driver's own reasons say it themselves."""


def told(found: StreamStatistics) -> str:
    """How many came and how many were refused, and why, the commonest reason first; empty when none was refused."""
    if not found.dropped:
        return ""
    reasons = sorted(found.reasons.items(), key=lambda reason: -reason[1])
    why = reasons[0][0] if len(reasons) == 1 else "; ".join(f"{count}: {reason}" for reason, count in reasons[:3])
    return f"{found.count + found.dropped} came, {found.dropped} refused: {why}"


def remedy(found: StreamStatistics) -> str:
    """What to do about the commonest reason; empty when none was refused, or the reason says it itself."""
    commonest = max(found.reasons, key=lambda reason: found.reasons[reason], default="")
    return REMEDIES.get(commonest, "")
