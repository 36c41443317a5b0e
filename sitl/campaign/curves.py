"""The distributions of a campaign as pictures: one curve a group of missions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from sitl.campaign.bounds import CONFIDENCE, wilson
from sitl.campaign.groups import Group
from sitl.report.style import CRITICAL, FAINT_INK, HALF_WIDTH_IN, INK, VEHICLE_COLOURS, WIDTH_IN, picture
from sitl.sim.simulation import COMPLETE_SHARE

MOST_CURVES = len(VEHICLE_COLOURS)
"""Groups beyond have grey curves, which the legend calls the others: more colours could not be told apart."""

_HEIGHT_IN = 4.6
_HALF_HEIGHT_IN = 3.4
_HALF_AXES = (0.135, 0.15, 0.835, 0.77)  # left, bottom, width and height as shares of the picture
_MOST_BANDED = 3
_DASHED = (0, (5, 3))


def times_picture(groups: Sequence[Group]) -> bytes:
    """A PNG of P(t_f <= t): the share of the missions whose map was complete after t, with its bounds."""
    limit_s = max((value for group in groups for value in group.figures("time_limit_s")), default=1.0)
    ended_s = max((value for group in groups for value in group.figures("sim_time_s")), default=limit_s)

    def draw(figure: Figure) -> None:
        axes = figure.add_axes((0.07, 0.12, 0.68, 0.82))
        for index, group in enumerate(groups):
            times_s = group.arrived_s()
            if not times_s:
                continue
            known = [time_s for time_s in times_s if math.isfinite(time_s)]
            steps_s = np.array([0.0, *known, ended_s])
            shares = np.array([*range(len(known) + 1), len(known)]) / len(times_s)
            if len(groups) <= _MOST_BANDED:
                low, high = zip(*(wilson(count, len(times_s)) for count in range(len(known) + 1)), strict=True)
                axes.fill_between(
                    steps_s, [*low, low[-1]], [*high, high[-1]], step="post", color=_colour(index), alpha=0.12, lw=0
                )
            axes.step(steps_s, shares, where="post", color=_colour(index), lw=1.8, label=_label(index, group))
        axes.set_xlim(0.0, ended_s or 1.0)
        axes.set_ylim(0.0, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_xlabel("simulated time t in s")
        axes.set_ylabel("P($t_f$ ≤ t)")
        if axes.get_lines():
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), handlelength=1.4)

    return picture(WIDTH_IN, _HEIGHT_IN, draw)


def shares_picture(
    groups: Sequence[Group], name: str, meaning: str, limit: float | None = None, limit_name: str = ""
) -> bytes:
    """A PNG of the share of the missions in which a figure was at most what is on the axis below.

    Args:
        groups: one curve each.
        name: of the figure.
        meaning: what the figure is, with its unit.
        limit: a value to compare with, drawn as a line.
        limit_name: what that is.
    """

    def draw(figure: Figure) -> None:
        axes = figure.add_axes(_HALF_AXES)
        for index, group in enumerate(groups):
            values = np.sort(group.figures(name))
            if len(values):
                shares = np.arange(1, len(values) + 1) / len(values)
                axes.step([values[0], *values], [0.0, *shares], where="post", color=_colour(index), lw=1.6)
        if limit is not None:
            _limit(axes, limit, limit_name)
        axes.set_ylim(0.0, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_ylabel("share of the missions")
        axes.set_xlabel(meaning)

    return picture(HALF_WIDTH_IN, _HALF_HEIGHT_IN, draw)


def completeness_picture(groups: Sequence[Group], name: str, meaning: str) -> bytes:
    """A PNG of how complete the maps were, at the moment that ``name`` and ``meaning`` say."""
    return shares_picture(groups, name, meaning, COMPLETE_SHARE, f"{COMPLETE_SHARE:.0%}")


def bands(groups: Sequence[Group]) -> str:
    """What the caption of `times_picture` says of its bounds."""
    return (
        f"The bands are its bounds at {100.0 * CONFIDENCE:.0f} % at each time." if len(groups) <= _MOST_BANDED else ""
    )


def _limit(axes: Axes, value: float, name: str) -> None:
    axes.axvline(value, color=CRITICAL, lw=1.1, ls=_DASHED)
    axes.text(value, 1.015, name, transform=axes.get_xaxis_transform(), ha="center", va="bottom", color=INK)


def _colour(index: int) -> str:
    return VEHICLE_COLOURS[index] if index < MOST_CURVES else FAINT_INK


def _label(index: int, group: Group) -> str:
    if index > MOST_CURVES:
        return ""
    return group.name if index < MOST_CURVES else "others"
