"""The tables of a campaign's report: what is known of each group of missions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from sitl.campaign.groups import Group, quantile
from sitl.campaign.mission import Row
from sitl.campaign.words import below, metres, percent, sure, unit, within
from sitl.report import html
from sitl.report.cards import UNKNOWN, number

_SHARES = (0.5, 0.9, 1.0)
_QUANTILES = ("median", "90 %", "worst")


def group_tables(groups: Sequence[Group], toured: bool) -> str:
    """HTML: how long missions took; how much longer than a good tour, where there are tours; and what they came near.

    Args:
        groups: a line each.
        toured: whether there are tours.
    """
    tables = [
        html.table(
            ("group", "missions", "failed", f"complete ({sure()})", *_named("t_f"), *_named("way")),
            [_times(group) for group in groups],
        )
    ]
    if toured:
        tables.append(
            html.table(
                ("group", "compared", *_named("t_f / tour"), *_named("way / tour"), "tour, median"),
                [_ratios(group) for group in groups],
            )
        )
    headings = ("group", f"contacts ({sure()})", "least distance", "time below d_c", "completeness, least")
    errors = ("estimate too high by, median", "most", "least", "completeness when done, least")
    tables.append(html.table((*headings, *errors), [_walls_and_map(group) for group in groups]))
    if any(group.homeward for group in groups):
        home = ("group", f"came home ({sure()})", "off, median", "off, worst", "time / reckoned, median", "worst")
        rest = ("least distance on the way", "battery below the promise, median", "worst")
        tables.append(html.table((*home, *rest), [_way_home(group) for group in groups]))
    return "\n".join(tables)


def _named(what: str) -> list[str]:
    return [f"{what} {name}" for name in _QUANTILES]


def _times(group: Group) -> tuple[str, ...]:
    flown = len(group.flown)
    return (
        group.name,
        str(len(group.rows)),
        str(group.failed),
        f"{group.complete} of {flown} ({within(group.complete, flown)})",
        *_quantiles(group.arrived_s(), _seconds),
        *_quantiles(group.of_complete("path_length_m"), lambda way_m: metres(way_m, 0)),
    )


def _ratios(group: Group) -> tuple[str, ...]:
    times = group.of_complete("time_ratio", "tour_time_s")
    tour_s, tour_m = group.median("tour_time_s"), group.median("tour_length_m")
    return (
        group.name,
        f"{len(times)} of {len(group.flown)}",
        *_quantiles(times, _ratio),
        *_quantiles(group.of_complete("way_ratio", "tour_length_m"), _ratio),
        UNKNOWN if tour_s is None else f"{_seconds(tour_s)}, {metres(tour_m, 0)}",
    )


def _walls_and_map(group: Group) -> tuple[str, ...]:
    flown, near = len(group.flown), group.mean_over_time("in_d_c_share")
    errors = group.figures("estimate_error")
    return (
        group.name,
        f"{group.contacts} ({below(group.contacts, flown)})",
        metres(min(group.figures("least_d_m"), default=None)),
        # What is rare must not read as never.
        UNKNOWN if near is None else "none" if near == 0.0 else "< 0.001 %" if near < 1e-5 else percent(near, 3),
        unit(min(group.figures("completeness"), default=None), "", 4),
        unit(group.median("estimate_error"), "", 4),
        unit(max(errors, default=None), "", 4),
        unit(min(errors, default=None), "", 4),
        unit(min(group.figures("completeness_when_done"), default=None), "", 4),
    )


def _way_home(group: Group) -> tuple[str, ...]:
    rows = group.homeward
    came = sum(row.get("home_arrived") is True for row in rows)
    times = sorted(_quotients(rows, "home_time_s", "home_promised_s"))
    missing = sorted(
        promised - left
        for row in rows
        if (promised := number(row, "home_promised_percent")) is not None
        and (left := number(row, "home_came_percent")) is not None
    )
    return (
        group.name,
        f"{came} of {len(rows)} ({within(came, len(rows))})",
        metres(group.median("home_off_m")),
        metres(max(group.figures("home_off_m"), default=None)),
        *(UNKNOWN if not times else _ratio(quantile(times, share)) for share in (0.5, 1.0)),
        metres(min(group.figures("home_least_d_m"), default=None)),
        *(UNKNOWN if not missing else unit(quantile(missing, share), "points", 1) for share in (0.5, 1.0)),
    )


def _quotients(rows: Sequence[Row], name: str, by: str) -> list[float]:
    return [a / b for row in rows if (a := number(row, name)) is not None and (b := number(row, by))]


def _quantiles(values: Sequence[float], words: Callable[[float], str]) -> list[str]:
    """Median, 90 % and worst of sorted values; where the worst was never reached, also the worst that was."""
    if not values:
        return [UNKNOWN] * len(_SHARES)
    said = [words(quantile(values, share)) for share in _SHARES]
    reached = [value for value in values if math.isfinite(value)]
    if reached and len(reached) < len(values):
        said[-1] += f"; {words(reached[-1])} where complete"
    return said


def _seconds(time_s: float) -> str:
    # Without the minutes, which make columns wide.
    return unit(time_s, "s", 0)


def _ratio(value: float) -> str:
    return unit(value, "", 2)
