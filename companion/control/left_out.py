"""Places that were seen and not explored, and why. Pure."""

from __future__ import annotations

import enum
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.model import FloatArray

SAME_M = 2.0
"""What is left out so near to each other, or inside of a larger one, is one place: ground and map both tell of it."""

MOST_LISTED = 64
"""So many places are listed, the largest of each reason first."""


class Why(enum.StrEnum):
    """Reason for which a place was left out; where two hold, the one further up is told."""

    TOO_LOW = "too low"
    """It goes on below a roof under which the vehicle does not fit at its height."""
    TOO_NARROW = "too narrow"
    """The only ways there are narrower than what it keeps from walls allows."""
    BLOCKED = "blocked"
    """A way leads there over known ground, but its straights were not confirmed by the scan."""
    GIVEN_UP = "given up"
    """The vehicle was there, and the camera did not see it from there."""
    OUT_OF_RANGE = "out of range"
    """A roof or a floor that is further off than the camera sees from the height of flight."""
    NOT_REACHED = "not reached"
    """A way leads there; the flight ended before."""


@dataclass(frozen=True, slots=True)
class LeftOut:
    """One place.

    Attributes:
        x_m: its middle.
        y_m: the same along y.
        z_m: its height, of the ground or of the flight over it.
        extent_m: how long it is in the plan, along x or y, whichever is more.
        why: it was left out.
    """

    x_m: float
    y_m: float
    z_m: float
    extent_m: float
    why: Why

    @classmethod
    def over(cls, points_m: FloatArray, cell_m: float, why: Why) -> LeftOut:
        """The place that some cells (n, 3), n > 0, given by their middles, make up."""
        middle, span = points_m.mean(axis=0), np.ptp(points_m[:, :2], axis=0)
        return cls(float(middle[0]), float(middle[1]), float(middle[2]), float(span.max()) + cell_m, why)

    def as_json(self) -> dict[str, object]:
        """As it stands in ``summary.json``."""
        numbers = ("x_m", "y_m", "z_m", "extent_m")
        return {**{name: round(float(getattr(self, name)), 2) for name in numbers}, "why": self.why.value}


def pieces(points_m: FloatArray, apart_m: float, level_m: float) -> Iterator[NDArray[np.int64]]:
    """Which of some points (n, 3) belong together.

    Args:
        points_m: the points.
        apart_m: two whose cells of this size are beside each other in the plan, or meet at a corner, do.
        level_m: the same for their heights.

    Returns:
        the (k,) indices of each piece.
    """
    cells = np.floor(points_m / (apart_m, apart_m, level_m)).astype(np.int64)
    members: dict[tuple[int, int, int], list[int]] = {}
    for index, (a, b, c) in enumerate(cells.tolist()):
        members.setdefault((a, b, c), []).append(index)
    around = [(a, b, c) for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1)]
    while members:
        first, found = members.popitem()
        waiting = [first]
        while waiting:
            x, y, z = waiting.pop()
            for a, b, c in around:
                beside = members.pop((x + a, y + b, z + c), None)
                if beside is not None:
                    found += beside
                    waiting.append((x + a, y + b, z + c))
        yield np.array(sorted(found))


def merged(places: Iterable[LeftOut]) -> tuple[LeftOut, ...]:
    """Each place once, for its first reason; by reasons, large ones first, at most `MOST_LISTED`."""
    order = {why: number for number, why in enumerate(Why)}
    kept: list[LeftOut] = []
    for place in sorted(places, key=lambda place: (order[place.why], -place.extent_m, place.x_m, place.y_m)):
        near = (
            math.hypot(place.x_m - other.x_m, place.y_m - other.y_m) <= max(SAME_M, other.extent_m / 2.0)
            and abs(place.z_m - other.z_m) <= SAME_M
            for other in kept
        )
        if not any(near):
            kept.append(place)
    return tuple(kept[:MOST_LISTED])


def to_explore(places: Iterable[LeftOut]) -> int:
    """How many of them another flight gets to: those that were not reached, and to which a way leads."""
    return sum(place.why is Why.NOT_REACHED for place in places)


def so_many(number: int) -> str:
    """So many places, in words."""
    return "1 place" if number == 1 else f"{number} places"


def in_words(places: Iterable[LeftOut]) -> str:
    """One short line: how many for which reason."""
    counted = Counter(place.why for place in places)
    return ", ".join(f"{counted[why]} {why.value}" for why in Why if why in counted) or "nothing"
