"""What became of the flights past each hazard, as the table of docs/mines.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

from sitl.campaign.mission import Row

HEADING = (
    "hazard",
    "preset",
    "flights",
    "contacts",
    "least d, m",
    "least clearance, m",
    "done",
    "came home",
    "map, least",
    "how they ended",
)


def table(rows: Iterable[Row]) -> list[str]:
    """Lines of Markdown: one for each hazard and preset, in the order of the rows' missions."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in sorted(rows, key=lambda row: int(str(row["mission"]))):
        groups.setdefault((str(row["given_world"]).removeprefix("hazard:"), str(row["preset"])), []).append(row)
    lines = [HEADING, ("---",) * len(HEADING)]
    lines += [(*group, *_figures(of_group)) for group, of_group in groups.items()]
    return [f"| {' | '.join(line)} |" for line in lines]


def _figures(rows: Sequence[Row]) -> tuple[str, ...]:
    count = len(rows)
    ends = Counter(map(_end, rows))
    return (
        str(count),
        str(sum(int(str(row.get("contacts") or 0)) for row in rows)),
        _least(row.get(name) for row in rows for name in ("least_d_m", "home_least_d_m")),
        _least(row.get("least_clearance_m") for row in rows),
        f"{sum(row['ended_because'] == 'done' for row in rows)} of {count}",
        f"{sum(row.get('home_arrived') is True for row in rows)} of {count}",
        _least(row.get("completeness") for row in rows),
        ", ".join(f"{number} {end}" for end, number in ends.most_common()),
    )


def _end(row: Row) -> str:
    """The exploring's end, and that of the way home where it was another than home."""
    explored, came = str(row["ended_because"]), row.get("home_ended_because")
    if came is None or row.get("home_arrived") is True:
        return explored
    return f"{explored}, then {'beside home' if came == 'home' else came} ({row.get('home_off_m')} m)"


def _least(values: Iterable[object]) -> str:
    known = [float(str(value)) for value in values if value is not None]
    return f"{min(known):.2f}" if known else "-"
