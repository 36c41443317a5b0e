"""What the operator should know of a vehicle now, in plain words that say what to do."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from companion.ground.gate_words import in_plain_words
from companion.ground.station import VehicleView
from companion.link.words import Telemetry

STALE_S = 2.0
"""Telemetry older than this is shown as old: it comes about five times a second."""

LOST_S = 10.0
"""The link counts as lost after this."""

MAP_BEHIND_S = 30.0
"""A map that is this far behind is worth a word."""

ENDED = "ended"
WAITING = "waiting"


class Weight(enum.IntEnum):
    """How much a concern matters."""

    FINE = 0
    LOOK = 1
    ACT = 2


@dataclass(frozen=True, slots=True)
class Concern:
    """One thing that is not as it should be."""

    weight: Weight
    text: str


def concerns(vehicle: VehicleView) -> list[Concern]:
    """What is wrong with a vehicle or with its link, the gravest first."""
    telemetry, age_s = vehicle.telemetry, vehicle.age_s
    if telemetry is None:
        return [Concern(Weight.LOOK, "Nothing heard of it yet. Is it switched on, and is its link up?")]
    found = [Concern(Weight.ACT, text) for text in in_plain_words(telemetry.warnings)]
    if vehicle.doubt:
        found.append(
            Concern(
                Weight.ACT,
                f"Somebody claims to be {vehicle.name} and is not believed: {vehicle.doubt}. What is shown is the "
                "vehicle's own. Find who it is, and revoke that certificate.",
            )
        )
    over = telemetry.phase == ENDED
    if age_s > LOST_S and not over:
        found.append(
            Concern(
                Weight.ACT,
                f"No word for {duration(age_s)}. It goes on by itself; what is shown is how it was. Commands may not "
                "reach it: bring the antenna nearer to the drift, or wait until it is back.",
            )
        )
    elif age_s > STALE_S and not over:
        found.append(Concern(Weight.LOOK, f"No word for {duration(age_s)}. What is shown is how it was."))
    found += _of_battery(telemetry)
    if telemetry.d_m is not None and telemetry.margin_m is not None and telemetry.d_m < 0.75 * telemetry.margin_m:
        found.append(
            Concern(
                Weight.LOOK,
                f"Rock is {telemetry.d_m:.2f} m away, nearer than the {telemetry.margin_m:.2f} m that it keeps. "
                "It makes room by itself; press STOP if it does not.",
            )
        )
    if vehicle.map_age_s > MAP_BEHIND_S and age_s <= LOST_S:
        behind = "all" if math.isinf(vehicle.map_age_s) else f"the last {duration(vehicle.map_age_s)}"
        found.append(Concern(Weight.LOOK, f"The map here lacks {behind}: the link is thin. It comes when it can."))
    return sorted(found, key=lambda concern: -concern.weight)


def duration(span_s: float) -> str:
    """Seconds as a person says them."""
    if math.isinf(span_s):
        return "ever"
    whole = int(span_s)
    if whole < 120:
        return f"{whole} s"
    return f"{whole // 60} min" if whole < 7200 else f"{whole // 3600} h"


def _of_battery(telemetry: Telemetry) -> list[Concern]:
    left, reserve = telemetry.left_at_home_percent, telemetry.reserve_percent
    if left is None or reserve is None or telemetry.phase in (ENDED, WAITING, "leaving"):
        return []
    if left < 0.0:
        return [Concern(Weight.ACT, "The battery does not last for the way home. Land it where it can be fetched.")]
    if left < reserve and telemetry.phase != "homing":
        return [
            Concern(
                Weight.ACT,
                f"At home {left:.0f} % of the battery would be left, less than the {reserve:.0f} % that shall be. "
                "Send it home now.",
            )
        ]
    return []
