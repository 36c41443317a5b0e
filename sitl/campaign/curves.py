"""The distributions of a campaign as pictures: one curve a group of missions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from sitl.campaign.bounds import CONFIDENCE, between
from sitl.campaign.groups import Group
from sitl.report.style import CRITICAL, FAINT_INK, HALF_WIDTH_IN, INK, VEHICLE_COLOURS, WIDTH_IN, picture
from sitl.sim.simulation import COMPLETE_SHARE

_STROKES: tuple[str | tuple[int, tuple[float, float]], ...] = ("-", (0, (4, 1.5)), (0, (1, 1)))
MOST_CURVES = len(VEHICLE_COLOURS) * len(_STROKES)
"""Groups beyond have grey curves: more colours, and strokes of a colour, could not be told apart."""

_HEIGHT_IN = 4.6
_HALF_HEIGHT_IN = 3.4
_HALF_AXES = (0.135, 0.15, 0.835, 0.77)  # left, bottom, width and height as shares of the picture
_MOST_BANDED = 3
_COLUMNS, _PLOT_HEIGHT_IN = 3, 2.1
_DASHED = (0, (5, 3))
_OTHERS = "#c9cdd1"


def times_picture(groups: Sequence[Group]) -> bytes:
    """A PNG of P(t_f <= t): the share of the missions whose map was complete after t, with its bounds.

    Missions whose map did not become complete are in the share and never arrive: their curve stays below 1. Of a few
    groups all curves are in one plot; of more each has one of its own, before those of the others.
    """
    ended_s = max((value for group in groups for value in group.figures("sim_time_s")), default=1.0)
    together = len(groups) <= _MOST_BANDED

    def draw(figure: Figure) -> None:
        if together:
            axes = figure.add_axes((0.07, 0.12, 0.68, 0.82))
            for index, group in enumerate(groups):
                _time_curve(axes, group, ended_s, index)
            if axes.get_lines():
                axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), handlelength=1.4)
            plots = [axes]
        else:
            rows = math.ceil(len(groups) / _COLUMNS)
            plots = list(np.ravel(figure.subplots(rows, _COLUMNS, sharex=True, sharey=True)))
            figure.subplots_adjust(left=0.07, right=0.985, bottom=0.55 / figure.get_figheight(),
                                   top=1.0 - 0.3 / figure.get_figheight(), wspace=0.08, hspace=0.3)  # fmt: skip
            for index, axes in enumerate(plots):
                if index < len(groups):
                    for other in groups:
                        _time_curve(axes, other, ended_s)
                    _time_curve(axes, groups[index], ended_s, index)
                    axes.set_title(groups[index].name, loc="left", fontsize="medium")
                axes.set_visible(index < len(groups))
        for index, axes in enumerate(plots):
            axes.set_xlim(0.0, ended_s or 1.0)
            axes.set_ylim(0.0, 1.02)
            axes.yaxis.set_major_formatter(PercentFormatter(1.0))
            if together or index % _COLUMNS == 0:
                axes.set_ylabel("P($t_f$ ≤ t)")
            if together or index + _COLUMNS >= len(groups):
                axes.set_xlabel("simulated time t in s")
                axes.tick_params(labelbottom=True)

    height_in = _HEIGHT_IN if together else 0.85 + _PLOT_HEIGHT_IN * math.ceil(len(groups) / _COLUMNS)
    return picture(WIDTH_IN, height_in, draw)


def _time_curve(axes: Axes, group: Group, ended_s: float, index: int | None = None) -> None:
    """The curve of a group: of the one at ``index`` with its bounds and its name, of others grey, to compare with."""
    times_s = group.arrived_s()
    if not times_s:
        return
    known = [time_s for time_s in times_s if math.isfinite(time_s)]
    steps_s = np.array([0.0, *known, ended_s])
    counts = [*range(len(known) + 1), len(known)]
    shares = np.array(counts) / len(times_s)
    if index is None:
        axes.step(steps_s, shares, where="post", color=_OTHERS, lw=1.0)
        return
    low, high = zip(*(between(count, len(times_s)) for count in counts), strict=True)
    axes.fill_between(steps_s, low, high, step="post", color=_colour(index), alpha=0.14, lw=0)
    axes.step(steps_s, shares, where="post", color=_colour(index), ls=_stroke(index), lw=1.8, label=group.name)


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
                axes.step(
                    [values[0], *values], [0.0, *shares], where="post", color=_colour(index), ls=_stroke(index), lw=1.6
                )
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


def ratios_picture(groups: Sequence[Group], name: str, beside: str, meaning: str) -> bytes:
    """A PNG of the share of the missions that took at most so many times as much as a tour.

    Args:
        groups: one curve each; missions whose map did not become complete never arrive.
        name: of the ratio.
        beside: the tour's figure in it, which must be known.
        meaning: what the ratio is.
    """

    def draw(figure: Figure) -> None:
        axes = figure.add_axes(_HALF_AXES)
        found = [group.of_complete(name, beside) for group in groups]
        most = max([2.0, *(ratio for ratios in found for ratio in ratios if math.isfinite(ratio))])
        for index, ratios in enumerate(found):
            known = [ratio for ratio in ratios if math.isfinite(ratio)]
            if ratios:
                shares = np.array([*range(len(known) + 1), len(known)]) / len(ratios)
                steps = [0.0, *known, 1.03 * most]
                axes.step(steps, shares, where="post", color=_colour(index), ls=_stroke(index), lw=1.6)
        _limit(axes, 1.0, "the tour")
        axes.set_xlim(0.0, 1.03 * most)
        axes.set_ylim(0.0, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_ylabel("share of the missions")
        axes.set_xlabel(meaning)

    return picture(HALF_WIDTH_IN, _HALF_HEIGHT_IN, draw)


def bands(groups: Sequence[Group]) -> str:
    """What the caption of `times_picture` says of its curves and their bounds."""
    said = f"The bands are the bounds at {100.0 * CONFIDENCE:.0f} % at each time, by Clopper and Pearson."
    return said if len(groups) <= _MOST_BANDED else f"{said} Grey are the other groups."


def _limit(axes: Axes, value: float, name: str) -> None:
    axes.axvline(value, color=CRITICAL, lw=1.1, ls=_DASHED)
    axes.text(value, 1.015, name, transform=axes.get_xaxis_transform(), ha="center", va="bottom", color=INK)


def _colour(index: int) -> str:
    return VEHICLE_COLOURS[index % len(VEHICLE_COLOURS)] if index < MOST_CURVES else FAINT_INK


def _stroke(index: int) -> str | tuple[int, tuple[float, float]]:
    return _STROKES[index // len(VEHICLE_COLOURS)] if index < MOST_CURVES else "-"
