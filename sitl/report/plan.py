"""The mine from above with the ways flown, as in the paper's Figs. 7 and 9."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sitl.report.data import Array, ReportData, stretches
from sitl.report.mine import Plan, mine_plan
from sitl.report.style import (
    CRITICAL,
    INK,
    MINE,
    MODE_COLOURS,
    MODE_LABELS,
    MOST_IN,
    STRIP_IN,
    WALL,
    WIDTH_IN,
    add_scale_bar,
    picture,
    vehicle_colour,
)
from sitl.sim.flight_log import MODES, FlightLog


def overview_png(data: ReportData) -> bytes:
    """The mine from above with the ways flown, as a PNG: one way is coloured by mode, several have a colour each."""
    flown = [flight.positions_m for flight in data.flights]
    plan = mine_plan(data.vertices_m, data.triangles, flown, data.height_m)
    west, east, south, north = _extent_m(plan, flown)

    inch_per_m = min(WIDTH_IN / (east - west), MOST_IN / (north - south))
    width, height = inch_per_m * (east - west), inch_per_m * (north - south)

    def draw(figure: Figure) -> None:
        whole = STRIP_IN + height
        left, bottom = (1.0 - width / WIDTH_IN) / 2, STRIP_IN / whole
        axes = figure.add_axes((left, bottom, width / WIDTH_IN, 1.0 - bottom))
        axes.set(xlim=(west, east), ylim=(south, north), autoscale_on=False)
        axes.set_axis_off()
        add_scale_bar(figure, inch_per_m, width)
        if plan is not None:
            _draw_mine(axes, plan)
        several = len(data.flights) > 1
        handles = []
        for index, flight in enumerate(data.flights):
            if len(flight) == 0:
                continue
            if several:
                colour = vehicle_colour(index)
                axes.plot(*flight.positions_m[:, :2].T, color=colour, lw=1.5, alpha=0.85, zorder=4)
                handles.append(Line2D([], [], color=colour, lw=2.5, label=f"vehicle {flight.vehicle_id}"))
            else:
                handles += _draw_modes(axes, flight)
            _draw_ends(axes, flight, vehicle_colour(index) if several else INK)
        if handles:
            handles += [_marker("o", "white", "start"), _marker("s", INK, "end"), *_draw_nearest(axes, data.flights)]
            place = (0.995, bottom / 2)
            figure.legend(handles=handles, loc="center right", bbox_to_anchor=place, ncols=-(-len(handles) // 2))

    return picture(WIDTH_IN, STRIP_IN + height, draw)


def _extent_m(plan: Plan | None, flown_m: Sequence[Array]) -> tuple[float, float, float, float]:
    """West, east, south and north of everything there is to draw, with a little room around it."""
    points = [positions[:, :2] for positions in flown_m]
    if plan is not None:
        points.append(np.reshape(plan.extent_m, (2, 2)).T)
    everything = np.concatenate([np.empty((0, 2)), *points])
    if len(everything) == 0:
        return 0.0, 1.0, 0.0, 1.0
    low, high = everything.min(axis=0), everything.max(axis=0)
    room = max(0.01 * float((high - low).max()), 0.1)
    return float(low[0] - room), float(high[0] + room), float(low[1] - room), float(high[1] + room)


def _draw_mine(axes: Axes, plan: Plan) -> None:
    grey = np.where(plan.covered[..., None], to_rgb(MINE), 1.0)
    axes.imshow(grey, extent=plan.extent_m, origin="lower", interpolation="bilinear", aspect="auto", zorder=1)
    axes.add_collection(LineCollection(list(plan.walls_m), colors=WALL, linewidths=1.0, capstyle="round", zorder=2))


def _draw_modes(axes: Axes, flight: FlightLog) -> list[Line2D]:
    """One line for each stretch in one mode, joined to the next; the rarer the mode, the further on top."""
    starts, ends = stretches(flight.modes)
    positions = flight.positions_m[:, :2]
    share = np.bincount(flight.modes, minlength=len(MODES))
    handles = []
    for index, mode in enumerate(MODES):
        own = flight.modes[starts] == index
        if not own.any():
            continue
        lines = [positions[start : end + 1] for start, end in zip(starts[own], ends[own], strict=True)]
        above = 3.0 + 1.0 / (1.0 + share[index])
        colour = MODE_COLOURS[mode]
        axes.add_collection(LineCollection(lines, colors=colour, linewidths=1.7, capstyle="round", zorder=above))
        handles.append(Line2D([], [], color=colour, lw=2.5, label=MODE_LABELS[mode]))
    return handles


def _draw_ends(axes: Axes, flight: FlightLog, colour: str) -> None:
    (x0, y0), (x1, y1) = flight.positions_m[0, :2], flight.positions_m[-1, :2]
    axes.plot(x1, y1, "s", ms=8, mfc=colour, mec="white", mew=1.4, zorder=6)
    axes.plot(x0, y0, "o", ms=8, mfc="white", mec=colour, mew=2.0, zorder=7)


def _draw_nearest(axes: Axes, flights: Sequence[FlightLog]) -> list[Line2D]:
    """Marks the place where a vehicle was closest to a wall, if the true distance is known."""
    distances = np.concatenate([flight.column("true_d_m") for flight in flights])
    if not np.isfinite(distances).any():
        return []
    nearest = int(np.nanargmin(distances))
    x, y = np.concatenate([flight.positions_m for flight in flights])[nearest, :2]
    axes.plot(x, y, "D", ms=8, mfc="none", mec=CRITICAL, mew=2.0, zorder=8)
    return [_marker("D", "none", f"closest to a wall: {distances[nearest]:.2f} m", CRITICAL)]


def _marker(shape: str, fill: str, label: str, edge: str = INK) -> Line2D:
    return Line2D([], [], marker=shape, ls="none", ms=7, mfc=fill, mec=edge, mew=1.8, label=label)
