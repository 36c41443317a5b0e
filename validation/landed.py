"""Where a whole flight has landed, by the trajectory that the world writes; and what it said last, when it did not."""

from __future__ import annotations

import csv
import itertools
import math
from pathlib import Path

from sitl.launch.program import CrewError

LAST_WORDS = 1500


def off_start_m(truth: Path) -> float:
    """True horizontal distance from the first to the last place of a flight.

    Args:
        truth: the trajectory that the world writes.

    Raises:
        ValueError: it has no rows.
    """
    places = _places(truth)
    if not places:
        raise ValueError(f"{truth} is empty")
    return math.dist(places[0][1:], places[-1][1:])


def landed_off_m(truth: Path, ordered_s: float) -> float | None:
    """The true horizontal way from where it was then to where it is in the end; None: the truth has no such time."""
    places = _places(truth)
    then = next(itertools.dropwhile(lambda place: place[0] < ordered_s, places), None)
    return None if then is None else round(math.dist(places[-1][1:], then[1:]), 3)


def last_words(log: Path) -> str:
    """The end of what the application printed."""
    return log.read_text(encoding="utf-8", errors="replace")[-LAST_WORDS:]


def not_in_time(log: Path) -> CrewError:
    """What to raise of a flight that has not ended."""
    return CrewError(f"the flight did not end in time: {last_words(log)}")


def _places(truth: Path) -> list[tuple[float, float, float]]:
    with truth.open(newline="", encoding="utf-8") as rows:
        return [(float(row["t_s"]), float(row["x_m"]), float(row["y_m"])) for row in csv.DictReader(rows)]
