"""Rows that belong together, and what is said of them: how many arrived, how long it took, and what went wrong."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from sitl.campaign.mission import FAILED, Campaign, Row
from sitl.report.cards import number


@dataclass(frozen=True, slots=True)
class Group:
    """Missions of one kind.

    Attributes:
        name: what they have in common, for people.
        rows: one a mission; never empty.
    """

    name: str
    rows: Sequence[Row]

    @property
    def flown(self) -> list[Row]:
        """Without the missions that failed: of these no figure is known."""
        return [row for row in self.rows if row["ended_because"] != FAILED]

    @property
    def failed(self) -> int:
        """How many raised an error, or took their process with them."""
        return len(self.rows) - len(self.flown)

    @property
    def complete(self) -> int:
        """How many ended with a complete map, by the truth."""
        return sum(number(row, "completed_at_s") is not None for row in self.rows)

    @property
    def contacts(self) -> int:
        """In how many something was touched, be it another vehicle."""
        return sum(any((number(row, name) or 0.0) > 0.0 for name in ("contacts", "collisions")) for row in self.rows)

    @property
    def homeward(self) -> list[Row]:
        """Those that flew home, or tried to."""
        return [row for row in self.flown if row.get("home_ended_because") is not None]

    def figures(self, name: str) -> list[float]:
        """The known values of a figure."""
        return [value for row in self.rows if (value := number(row, name)) is not None]

    def arrived_s(self) -> list[float]:
        """t_f of every mission that was flown, sorted: endless where the map did not become complete."""
        return self.of_complete("completed_at_s")

    def time_quantile_s(self, share: float) -> float:
        """The time within which this share of the missions was complete; endless where it was not reached."""
        return quantile(self.arrived_s(), share)

    def of_complete(self, name: str, beside: str | None = None) -> list[float]:
        """A figure of every mission that was flown, sorted: endless where the map did not become complete.

        Args:
            name: of the figure.
            beside: a figure that must be known of a mission for it to count, as the tour's where it is a ratio.
        """
        counted = [row for row in self.flown if beside is None or number(row, beside) is not None]
        found = (math.inf if number(row, "completed_at_s") is None else number(row, name) for row in counted)
        return sorted(value for value in found if value is not None)

    def mean_over_time(self, name: str) -> float | None:
        """The mean of a share of the time, each mission by how long it flew."""
        known = [
            (share, time_s)
            for row in self.flown
            if (share := number(row, name)) is not None and (time_s := number(row, "sim_time_s"))
        ]
        return sum(share * time_s for share, time_s in known) / sum(time_s for _, time_s in known) if known else None

    def farthest(self, name: str) -> float | None:
        """The value of a figure that is farthest from 0, where it is known of any mission."""
        return max(self.figures(name), key=abs, default=None)

    def median(self, name: str) -> float | None:
        """The median of a figure, where it is known of any mission."""
        values = self.figures(name)
        return statistics.median(values) if values else None


def quantile(values: Sequence[float], share: float) -> float:
    """The least of sorted values which this share of them does not exceed; endless where there are none."""
    # What is off by rounding must not be the next one: 0.07 * 100 is 7.000000000000001.
    return values[max(math.ceil(share * len(values) - 1e-9), 1) - 1] if values else math.inf


def kinds(campaign: Campaign, rows: Sequence[Row]) -> list[Group]:
    """The groups that a campaign compares: what it varies but draws, or else its worlds.

    The drawn worlds ``random:K`` are one kind.
    """
    compared = grouped(rows, lambda row: variant_name(campaign, row))
    return compared if len(compared) > 1 else grouped(rows, lambda row: world_name(row, drawn_as_one=True))


def cells(campaign: Campaign, rows: Sequence[Row]) -> list[Group]:
    """The smallest groups: each variant in each world."""

    def name(row: Row) -> str:
        return ", ".join(filter(None, (world_name(row), variant_name(campaign, row))))

    return grouped(rows, name)


def grouped(rows: Sequence[Row], name: Callable[[Row], str]) -> list[Group]:
    """Rows with the same name together, in the order in which the names come by number of mission."""
    found: dict[str, list[Row]] = {}
    for row in sorted(rows, key=lambda row: int(str(row["mission"]))):
        found.setdefault(name(row), []).append(row)
    return [Group(name, tuple(rows)) for name, rows in found.items()]


def variant_name(campaign: Campaign, row: Row) -> str:
    """Preset, case and values of a row, where the campaign has several; nothing where it has one."""
    several = campaign.several
    parts = [str(row["preset"])] if "preset" in several else []
    parts += [str(row["case"])] if "case" in several else []
    parts += [f"{name.rpartition('.')[2]} {row.get(name)}" for name in several if name not in ("preset", "case")]
    return ", ".join(parts)


def world_name(row: Row, drawn_as_one: bool = False) -> str:
    """The world of a row, without the folder of a mesh."""
    name = str(row["given_world"])
    if drawn_as_one and name.partition(":")[0] == "random":
        return "random"
    return Path(name).name if Path(name).suffix else name
