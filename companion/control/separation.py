"""How a vehicle stays apart from others: in height by the layers of (11), in the plane until those are reached. Pure.

The layers say where each vehicle is to fly, not where it is: a group that somebody joins or leaves moves all of them, a
roof may be too low, and a vehicle in between may be passed. So what is looked at is how far two of them truly are from
each other in height. As long as that is too little they do not come near in the plane, and as long as they are near in
the plane whoever is above stays above.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from companion.control.fleet import Fleet, Report
from companion.control.governor import braking_speed_mps
from companion.model import Setpoint

STAYS_APART = 0.9
"""Two that are apart in height count as that until they are nearer than this share of what it takes."""

LEVEL_M = 0.1
"""Two whose heights differ by less are at one height: who goes up is said by their numbers."""

RELEASED_M = 0.3
"""Who waits for another flies on when that one is so much further than it needs to be."""

PATIENCE_S = 15.0
"""Where two have not come apart in height after so long, the roof is too low for them: they go on by what they see, and
turn away from each other as from rock."""


@dataclass(frozen=True, slots=True)
class Spacing:
    """How far from each other vehicles are to be.

    Attributes:
        apart_m: in height: then they may pass above each other.
        keep_m: from middle to middle in the plane, as long as they are not.
        speed_mps: how fast one flies at most.
        reaction_s: from the wish to stand until it brakes.
        brake_mps2: how hard it brakes.
        slope: how steep ground may be, rise over run.
        body_height_m: of each.
        lowest_m: height of the lowest layer that there is.
        highest_m: and of the highest.
    """

    apart_m: float
    keep_m: float
    speed_mps: float
    reaction_s: float
    brake_mps2: float
    slope: float
    body_height_m: float
    lowest_m: float
    highest_m: float

    @property
    def stop_m(self) -> float:
        """How far a vehicle flies until it stands."""
        return self.speed_mps * self.reaction_s + self.speed_mps**2 / (2.0 * self.brake_mps2)

    @property
    def near_m(self) -> float:
        """From here on two vehicles that fly towards each other have to brake, in the plane."""
        return self.keep_m + 2.0 * self.stop_m


@dataclass(frozen=True, slots=True)
class Clearance:
    """What a vehicle may do, as far as the others are concerned.

    Attributes:
        height_m: H, at which it is to fly.
        holds: it waits where it is until others are apart from it in height.
        beside_m: towards east and north, how far from it those are to whom it keeps its distance in the plane.
        spacing: the distances.
    """

    height_m: float
    holds: bool
    beside_m: tuple[tuple[float, float], ...]
    spacing: Spacing

    def limited(self, setpoint: Setpoint, yaw_rad: float) -> Setpoint:
        """The same, no faster than it can stand before it is too near to any of them, who comes as fast.

        Whichever way it flies: away from a wall it also flies aside, or backward.

        Args:
            setpoint: what the law wants.
            yaw_rad: the heading, in the frame that the vehicles share.
        """
        wanted_mps = math.hypot(setpoint.speed_mps, setpoint.lateral_mps)
        if wanted_mps <= 0.0:
            return setpoint
        course_rad = yaw_rad + math.atan2(setpoint.lateral_mps, setpoint.speed_mps)
        most_mps = min((self._most_mps(*one, course_rad) for one in self.beside_m), default=math.inf)
        if most_mps >= wanted_mps:
            return setpoint
        share = most_mps / wanted_mps
        return replace(setpoint, speed_mps=share * setpoint.speed_mps, lateral_mps=share * setpoint.lateral_mps)

    def _most_mps(self, east_m: float, north_m: float, course_rad: float) -> float:
        spacing = self.spacing
        ahead_m = east_m * math.cos(course_rad) + north_m * math.sin(course_rad)
        aside_m = north_m * math.cos(course_rad) - east_m * math.sin(course_rad)
        if ahead_m <= 0.0 or abs(aside_m) >= spacing.keep_m:
            return math.inf
        way_m = ahead_m - math.sqrt(spacing.keep_m**2 - aside_m**2)
        # Half of the way is the other one's.
        return braking_speed_mps(way_m / 2.0, spacing.reaction_s, spacing.brake_mps2)


class Back(NamedTuple):
    """The upper side of a vehicle that flies below this one.

    Attributes:
        down_m: how far below the middle of this one it is.
        height_m: how high above the ground.
    """

    down_m: float
    height_m: float


class Separation:
    """Keeps one vehicle apart from the others.

    Args:
        fleet: what it knows of them.
        spacing: how far they are to be from each other.
        alone_m: H while nobody is near.
        stale_after_s: the age from which on a report says only where a vehicle was.
    """

    def __init__(self, fleet: Fleet, spacing: Spacing, alone_m: float, stale_after_s: float) -> None:
        self._fleet = fleet
        self._spacing = spacing
        self._alone_m = alone_m
        self._stale_after_s = stale_after_s
        self._apart: set[int] = set()
        self._waits_since_s: dict[int, float] = {}

    def report(
        self, t_s: float, at_m: tuple[float, float, float], height_m: float | None, flies: bool = True
    ) -> Report:
        """Note where this vehicle is; the report that it gives to the others.

        Args:
            t_s: now.
            at_m: x, y and z, in the frame that the vehicles share.
            height_m: as measured; None where it is not known.
            flies: whether it needs room in the air.
        """
        report = Report(t_s, *at_m, height_m, flies)
        self._fleet.on_report(self._fleet.own_id, report)
        return report

    def beneath(self) -> tuple[Back, ...]:
        """Whose backs the beam downward may meet."""
        own = self._fleet.own()
        if own is None:
            return ()
        half_m = self._spacing.body_height_m / 2.0
        found = []
        for there in self._fleet.others().values():
            up_m = own.z_m - there.z_m
            if up_m <= 0.0 or own.beside_m(there) >= self._spacing.keep_m:
                continue
            # Who has lost the ground says no height: what this one flew over a moment ago goes on below it.
            taken_m = None if own.height_m is None else own.height_m - up_m
            height_m = taken_m if there.height_m is None else there.height_m
            if height_m is not None:
                found.append(Back(up_m - half_m, height_m + half_m))
        return tuple(found)

    def clearance(self, t_s: float) -> Clearance:
        """What the vehicle may do now, by the newest reports of all, its own included."""
        wanted_m = self._fleet.height_m(t_s, self._alone_m)
        own = self._fleet.own()
        if own is None:
            return Clearance(wanted_m, False, (), self._spacing)
        spacing = self._spacing
        holds = False
        beside_m: list[tuple[float, float]] = []
        low_m, high_m = -math.inf, math.inf
        for vehicle_id, there in self._fleet.others().items():
            above_m = self._above_m(own, there, vehicle_id)
            is_apart = self._is_apart(vehicle_id, above_m)
            away_m = own.beside_m(there)
            if away_m > self._near_m(t_s, there) + (RELEASED_M if vehicle_id in self._waits_since_s else 0.0):
                self._waits_since_s.pop(vehicle_id, None)
                continue
            if is_apart:
                self._waits_since_s.pop(vehicle_id, None)
            else:
                beside_m.append((there.x_m - own.x_m, there.y_m - own.y_m))
                holds |= t_s - self._waits_since_s.setdefault(vehicle_id, t_s) < PATIENCE_S
            if own.height_m is not None and (is_apart or away_m < spacing.keep_m):
                # Nobody changes sides above or below another one.
                if above_m >= 0.0:
                    low_m = max(low_m, own.height_m + spacing.apart_m - above_m)
                else:
                    high_m = min(high_m, own.height_m - spacing.apart_m - above_m)
        return Clearance(self._between(wanted_m, low_m, high_m), holds, tuple(beside_m), spacing)

    def _between(self, wanted_m: float, low_m: float, high_m: float) -> float:
        """The height that is wanted, above who is below and below who is above; in the middle where both cannot be."""
        if low_m > high_m:
            low_m = high_m = (low_m + high_m) / 2.0
        bounded_m = max(low_m, min(high_m, wanted_m))
        if bounded_m == wanted_m:
            return wanted_m
        spacing = self._spacing
        return max(min(spacing.lowest_m, wanted_m), min(max(spacing.highest_m, wanted_m), bounded_m))

    def _near_m(self, t_s: float, there: Report) -> float:
        """Who is beyond this in the plane need not be waited for; by now one may be nearer than its report says."""
        age_s = max(0.0, t_s - there.t_s)
        return self._spacing.near_m + self._spacing.speed_mps * min(age_s, self._stale_after_s)

    def _above_m(self, own: Report, there: Report, vehicle_id: int) -> float:
        """How far this vehicle is above the other one, negative below; above the ground that both fly over.

        On a slope the difference of z is also that of the ground. Two on different levels of a mine have the same
        height above their grounds and are apart all the same.
        """
        up_m, rise_m = own.z_m - there.z_m, self._spacing.slope * own.beside_m(there)
        surely_m = max(0.0, abs(up_m) - rise_m)
        found_m = math.copysign(surely_m, up_m)
        if own.height_m is not None and there.height_m is not None:
            over_m = own.height_m - there.height_m
            may_be_m = max(0.0, min(abs(over_m), math.copysign(1.0, over_m) * up_m + rise_m))
            if may_be_m > surely_m:
                found_m = math.copysign(may_be_m, over_m)
        if abs(found_m) < LEVEL_M:
            found_m = math.copysign(abs(found_m), vehicle_id - self._fleet.own_id)
        return found_m

    def _is_apart(self, vehicle_id: int, above_m: float) -> bool:
        takes_m = self._spacing.apart_m * (STAYS_APART if vehicle_id in self._apart else 1.0)
        if abs(above_m) >= takes_m:
            self._apart.add(vehicle_id)
        else:
            self._apart.discard(vehicle_id)
        return vehicle_id in self._apart
