"""What the flight looks like over time: distances to walls, height, modes, and how the map grew."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, PercentFormatter

from sitl.report.cards import number
from sitl.report.data import Array, ReportData, stretches, thinned
from sitl.report.style import (
    CRITICAL,
    FAINT_INK,
    HALF_WIDTH_IN,
    INK,
    MODE_COLOURS,
    MODE_LABELS,
    NEAR,
    SAFE,
    WIDTH_IN,
    picture,
)
from sitl.sim.flight_log import MODES, FlightLog
from sitl.sim.simulation import COMPLETE_SHARE

_BINS = 1000
_BIN_M = 0.05
_MOST_BARS = 80
_MEASURED = "#9aa3ab"
_HALF_HEIGHT_IN = 3.4
_HALF_AXES = (0.135, 0.15, 0.835, 0.77)  # left, bottom, width and height as shares of the picture
_D_S, _D_C = "$d_s$", "$d_c$"
_DASHED = (0, (5, 3))


def flight_picture(flight: FlightLog, data: ReportData) -> bytes:
    """A PNG of d(t), h(t) and the modes of one vehicle."""
    t_s = flight.column("t_s")
    end_s = float(t_s[-1]) if len(t_s) > 0 and t_s[-1] > 0.0 else 1.0
    height_in = 4.9

    def draw(figure: Figure) -> None:
        place = {"left": 0.055, "right": 0.91, "top": 0.935, "bottom": 0.11, "hspace": 0.14}
        distance, height, modes = figure.subplots(3, 1, sharex=True, gridspec_kw={"height_ratios": (10, 6, 1), **place})
        _draw_distance(distance, flight, data)
        _draw_height(height, flight, data.height_m)
        _draw_modes(modes, flight)
        modes.set_xlim(0.0, end_s)
        modes.set_xlabel("time in s", loc="left")
        figure.align_ylabels([distance, height])

    return picture(WIDTH_IN, height_in, draw)


def progress_picture(data: ReportData) -> bytes:
    """A PNG of completeness over time."""
    progress = np.asarray(data.progress, dtype=np.float64).reshape(-1, 2)
    t_s, share = thinned(progress[:, 0], progress[:, 1], _BINS)
    completed_s = number(data.summary, "completed_at_s")

    def draw(figure: Figure) -> None:
        axes = figure.add_axes(_HALF_AXES)
        axes.plot(t_s, share, color=SAFE, lw=2.0)
        axes.fill_between(t_s, share, color=SAFE, alpha=0.10, lw=0)
        axes.axhline(COMPLETE_SHARE, color=FAINT_INK, lw=1.0, ls=_DASHED)
        if completed_s is None:
            note = f"{COMPLETE_SHARE:.0%} not reached"
        else:
            note = f"{COMPLETE_SHARE:.0%} after {completed_s:.0f} s"
            axes.plot([completed_s] * 2, [0.0, COMPLETE_SHARE], color=FAINT_INK, lw=1.0, ls=_DASHED)
            axes.plot(completed_s, COMPLETE_SHARE, "o", ms=7, mfc="white", mec=SAFE, mew=2.0, clip_on=False, zorder=5)
        axes.text(1.0, 1.015, note, transform=axes.transAxes, ha="right", va="bottom", weight="bold")
        axes.set_xlim(0.0, float(t_s.max()) if len(t_s) > 0 and t_s.max() > 0.0 else 1.0)
        axes.set_ylim(0.0, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_ylabel("completeness")
        axes.set_xlabel("time in s")

    return picture(HALF_WIDTH_IN, _HALF_HEIGHT_IN, draw)


def distance_histogram(data: ReportData) -> bytes:
    """A PNG of how much of the time was spent how near to the walls, from the true distance of all vehicles."""
    distances = np.concatenate([np.empty(0), *(flight.column("true_d_m") for flight in data.flights)])
    distances = distances[np.isfinite(distances)]
    most = max(1.6 * data.margin_m, float(distances.max(initial=0.0)))
    width = max(_BIN_M, most / _MOST_BARS)
    edges = width * np.arange(int(most / width) + 2)

    def draw(figure: Figure) -> None:
        axes = figure.add_axes(_HALF_AXES)
        counts, _ = np.histogram(distances, edges)
        shares = counts / max(len(distances), 1)
        middles = (edges[:-1] + edges[1:]) / 2
        zone = np.where(middles < data.critical_margin_m, CRITICAL, np.where(middles < data.margin_m, NEAR, SAFE))
        axes.bar(middles, shares, width=0.92 * width, color=zone)
        axes.set_xlim(0.0, float(edges[-1]))
        axes.set_ylim(0.0, 1.08 * max(float(shares.max(initial=0.0)), 0.01))
        above = axes.get_xaxis_transform()
        for value, name, side in ((data.margin_m, _D_S, "left"), (data.critical_margin_m, _D_C, "right")):
            axes.axvline(value, color=INK, lw=1.1, ls=_DASHED)
            axes.text(value, 1.015, f"{name} = {value:g} m", transform=above, ha=side, va="bottom")
        axes.yaxis.set_major_locator(MaxNLocator(5))
        axes.yaxis.set_major_formatter(PercentFormatter(1.0))
        axes.set_ylabel("share of the flight")
        axes.set_xlabel("true distance to the nearest wall in m")
        axes.grid(visible=False, axis="x")

    return picture(HALF_WIDTH_IN, _HALF_HEIGHT_IN, draw)


def _draw_distance(axes: Axes, flight: FlightLog, data: ReportData) -> None:
    t_s, measured, true = (flight.column(name) for name in ("t_s", "d_m", "true_d_m"))
    axes.axhspan(0.0, data.critical_margin_m, color=CRITICAL, alpha=0.10, lw=0)
    axes.axhspan(data.critical_margin_m, data.margin_m, color=NEAR, alpha=0.13, lw=0)
    axes.plot(*thinned(t_s, measured, _BINS), color=_MEASURED, lw=0.8, label="measured")
    known = np.isfinite(true)  # the truth is worked out for some ticks only, which are joined
    axes.plot(*thinned(t_s[known], true[known], _BINS), color=SAFE, lw=1.2, label="true")
    _level(axes, data.margin_m, _D_S)
    _level(axes, data.critical_margin_m, _D_C)
    # What is far away is of no interest here: it must not press the margins together.
    highest = max(float(true[known].max(initial=0.0)), _high(measured))
    axes.set_ylim(0.0, np.clip(1.05 * highest, 2.0 * data.margin_m, 3.5 * data.margin_m))
    axes.set_ylabel("distance d in m")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=2, borderaxespad=0.0, handlelength=1.4)


def _draw_height(axes: Axes, flight: FlightLog, height_m: float) -> None:
    h_m = flight.column("h_m")
    axes.plot(*thinned(flight.column("t_s"), h_m, _BINS), color=SAFE, lw=1.0)
    _level(axes, height_m, "$H$")
    axes.set_ylim(0.0, 1.25 * max(height_m, _high(h_m), 0.1))
    axes.set_ylabel("height h in m")


def _draw_modes(axes: Axes, flight: FlightLog) -> None:
    t_s = flight.column("t_s")
    starts, ends = stretches(flight.modes)
    handles = []
    for index, mode in enumerate(MODES):
        own = flight.modes[starts] == index
        if not own.any():
            continue
        begin, end = t_s[starts[own]], t_s[np.minimum(ends[own], len(t_s) - 1)]
        colour = MODE_COLOURS[mode]
        axes.broken_barh(list(zip(begin, end - begin, strict=True)), (0.0, 1.0), facecolors=colour, lw=0)
        handles.append(Patch(color=colour, label=MODE_LABELS[mode]))
    axes.set_ylim(0.0, 1.0)
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.spines[["left", "bottom"]].set_visible(False)
    if handles:
        axes.legend(handles=handles, loc="upper right", bbox_to_anchor=(1.0, -0.85), ncols=4, borderaxespad=0.0)


def _level(axes: Axes, value_m: float, name: str) -> None:
    """A dashed line across, named with its value at the right end, outside the data."""
    axes.axhline(value_m, color=INK, lw=1.0, ls=_DASHED, zorder=5)
    axes.text(1.008, value_m, f"{name} = {value_m:g} m", transform=axes.get_yaxis_transform(), va="center")


def _high(values: Array) -> float:
    """The value that only the highest 0.5 % exceed: single wild readings must not squeeze the picture."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, 0.995)) if len(known) > 0 else 0.0
