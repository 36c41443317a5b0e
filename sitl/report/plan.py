"""The mine from above, what it covers and its walls, with the ways flown, as in the paper's Figs. 7 and 9."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from numpy.typing import NDArray

from companion.control.left_out import LeftOut
from sitl.report.data import Array, Points, ReportData, stretches
from sitl.report.style import (
    CRITICAL,
    HOMEWARD,
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

_WIDTH_PX = 600
_LEVEL_CELLS = 96
_FLOWN_POINTS = 400
_CHUNK = 500_000
_TWO_ROWS_HOLD = 6  # entries of a legend
_PER_PIXEL = 1.5  # points a pixel along rows that are turned against the grid: 1.0 leaves holes


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A mine from above.

    Attributes:
        covered: (rows, columns) bool, row 0 in the south: the surface has a point above or below there.
        extent_m: (west, east, south, north) of ``covered``.
        walls_m: (s, 2, 2) segments, where the surface crosses the flying height.
    """

    covered: NDArray[np.bool_]
    extent_m: tuple[float, float, float, float]
    walls_m: Array


def mine_plan(
    vertices_m: Points, triangles: NDArray[np.integer], flown_m: Sequence[Points], height_m: float
) -> Plan | None:
    """The plan of a mesh, cut at the height at which the vehicles flew there; ``None`` for an empty mesh.

    The cut follows slopes: its height is interpolated between the true positions ``flown_m`` (each (n, 3)), so on a
    slope where nobody flew it may miss the walls, and only ``covered`` shows the drift. If nobody flew anywhere it is
    level, ``height_m`` above the lowest point.
    """
    if len(triangles) == 0:
        return None
    corners = np.asarray(vertices_m, dtype=np.float64)
    used = corners[np.unique(triangles)]
    low, high = used[:, :2].min(axis=0), used[:, :2].max(axis=0)
    pixel = float((high - low).max()) / _WIDTH_PX or 1.0
    low, high = low - 2.0 * pixel, high + 2.0 * pixel
    shape = np.ceil((high - low) / pixel).astype(np.int64)
    top = low + shape * pixel

    positions = np.concatenate([np.empty((0, 3)), *flown_m])
    if len(positions) > 0:
        level = _flown_level(corners, positions, low, top)
    else:
        level = np.full(len(corners), used[:, 2].min() + height_m)
    return Plan(
        _covered(corners[:, :2], triangles, low, pixel, (int(shape[1]), int(shape[0]))),
        (low[0], top[0], low[1], top[1]),
        section(corners, triangles, level),
    )


def section(vertices_m: Array, triangles: NDArray[np.integer], level_m: Array) -> Array:
    """Where a mesh crosses a surface given by its height ``level_m`` (n,) at each vertex.

    Returns:
        (s, 2, 2) segments in the plan.
    """
    above_m = vertices_m[:, 2] - level_m
    above = above_m[triangles] >= 0.0
    count = above.sum(axis=1)
    crossed = (count == 1) | (count == 2)
    corners, above, count = triangles[crossed], above[crossed], count[crossed]
    # One corner is alone on its side of the cut: the segment joins the two edges that leave it.
    alone = np.argmax(above == (count == 1)[:, None], axis=1)
    rows = np.arange(len(corners))
    tip = corners[rows, alone]
    ends = []
    for other in (corners[rows, (alone + 1) % 3], corners[rows, (alone + 2) % 3]):
        share = above_m[tip] / (above_m[tip] - above_m[other])
        ends.append(vertices_m[tip, :2] + share[:, None] * (vertices_m[other, :2] - vertices_m[tip, :2]))
    return np.stack(ends, axis=1)


def _flown_level(vertices_m: Array, positions_m: Array, low_m: Array, high_m: Array) -> Array:
    """The flying height at each vertex, from the positions weighted by 1/distance⁴, over a coarse grid."""
    some = positions_m[np.linspace(0, len(positions_m) - 1, min(len(positions_m), _FLOWN_POINTS)).astype(np.int64)]
    x, y = (np.linspace(low_m[axis], high_m[axis], _LEVEL_CELLS) for axis in (0, 1))
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    squared = (grid[:, :1] - some[:, 0]) ** 2 + (grid[:, 1:] - some[:, 1]) ** 2
    weights = 1.0 / (squared + 0.01) ** 2
    level = ((weights @ some[:, 2]) / weights.sum(axis=1)).reshape(_LEVEL_CELLS, _LEVEL_CELLS)

    where = (vertices_m[:, :2] - low_m) / (high_m - low_m) * (_LEVEL_CELLS - 1)
    where = np.clip(where, 0.0, _LEVEL_CELLS - 1)  # vertices that no triangle uses may lie anywhere
    cell = np.minimum(where.astype(np.int64), _LEVEL_CELLS - 2)
    (i, j), (u, v) = cell.T, (where - cell).T
    return np.asarray(
        (level[i, j] * (1 - u) + level[i + 1, j] * u) * (1 - v)
        + (level[i, j + 1] * (1 - u) + level[i + 1, j + 1] * u) * v
    )


def _covered(
    plan_m: Array, triangles: NDArray[np.integer], low_m: Array, pixel_m: float, shape: tuple[int, int]
) -> NDArray[np.bool_]:
    """The pixels onto which the triangles fall, found by points on each that lie less than a pixel apart."""
    covered = np.zeros(shape, dtype=np.bool_)
    corners = (plan_m[triangles] - low_m) / pixel_m
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    # Start every triangle at its longest side: rows of points run along that and shrink towards the third corner.
    first = np.argmax(sides, axis=1)
    rows = np.arange(len(corners))
    a, b, c = (corners[rows, (first + k) % 3] for k in range(3))
    longest = sides[rows, first]
    area = np.abs((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0]))
    across = area / np.maximum(longest, 1e-12)
    n_along, n_across = (
        2 ** np.ceil(np.log2(np.maximum(_PER_PIXEL * size, 1.0))).astype(np.int64) for size in (longest, across)
    )

    for along, up in np.unique(np.stack([n_along, n_across], axis=1), axis=0):
        s = np.tile(np.linspace(0.0, 1.0, along + 1), up + 1)
        t = np.repeat(np.linspace(0.0, 1.0, up + 1), along + 1)
        share = np.stack([(1 - t) * (1 - s), (1 - t) * s, t])
        group = np.flatnonzero((n_along == along) & (n_across == up))
        for part in np.array_split(group, len(group) * len(s) // _CHUNK + 1):
            points = np.einsum("kp,knd->npd", share, np.stack([a[part], b[part], c[part]]))
            column, row = points.reshape(-1, 2).astype(np.int64).T
            covered[row, column] = True
    return covered


def overview_png(data: ReportData, plan: Plan | None) -> bytes:
    """The mine from above with the ways flown, as a PNG: one way is coloured by mode, several have a colour each."""
    several = len(data.flights) > 1

    def draw(axes: Axes) -> list[Line2D]:
        handles = []
        for index, flight in enumerate(data.flights):
            if len(flight) == 0:
                continue
            if several:
                colour = vehicle_colour(index)
                axes.plot(*flight.positions_m[:, :2].T, color=colour, lw=1.5, alpha=0.85, zorder=4)
                handles.append(Line2D([], [], color=colour, lw=2.5, label=f"vehicle {flight.vehicle_id}"))
            else:
                handles += _draw_modes(axes, flight, data.homeward_from(index))
            handles += _draw_homeward(axes, flight, data.homeward_from(index), label=index == 0)
            _draw_ends(axes, flight, vehicle_colour(index) if several else INK)
        if handles:
            handles += [marker("o", "white", "start"), marker("s", INK, "end"), *_draw_nearest(axes, data.flights)]
        return handles + _draw_left_out(axes, data.left_out)

    return plan_png(data, plan, draw)


def plan_of(data: ReportData) -> Plan | None:
    """The plan of the mine that was flown in."""
    return mine_plan(data.vertices_m, data.triangles, [flight.positions_m for flight in data.flights], data.height_m)


def plan_png(data: ReportData, plan: Plan | None, on_it: Callable[[Axes], list[Line2D]]) -> bytes:
    """The mine from above as a PNG.

    Args:
        data: the flights, for which there is room as well.
        plan: the mine.
        on_it: draws on the plan, in m, and returns what the legend is to explain.
    """
    west, east, south, north = _extent_m(plan, [flight.positions_m for flight in data.flights])
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
        handles = on_it(axes)
        if handles:
            place, rows = (0.995, bottom / 2), 2 if len(handles) <= _TWO_ROWS_HOLD else 3
            figure.legend(handles=handles, loc="center right", bbox_to_anchor=place, ncols=-(-len(handles) // rows))

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


def _draw_homeward(axes: Axes, flight: FlightLog, first: int, label: bool) -> list[Line2D]:
    """The way home, dotted over whatever it leads along."""
    if first >= len(flight):
        return []
    style: dict[str, Any] = {"color": HOMEWARD, "lw": 2.2, "ls": (0, (1.0, 1.4)), "zorder": 5}
    axes.plot(*flight.positions_m[first:, :2].T, **style)
    return [Line2D([], [], label="the way home", **style)] if label else []


def _draw_modes(axes: Axes, flight: FlightLog, ticks: int) -> list[Line2D]:
    """One line for each stretch in one mode, joined to the next; the rarer the mode, the further on top."""
    modes, positions = flight.modes[:ticks], flight.positions_m[:ticks, :2]
    if len(modes) == 0:
        return []
    starts, ends = stretches(modes)
    share = np.bincount(modes, minlength=len(MODES))
    handles = []
    for index, mode in enumerate(MODES):
        own = modes[starts] == index
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
    return [marker("D", "none", f"closest to a wall: {distances[nearest]:.2f} m", CRITICAL)]


def _draw_left_out(axes: Axes, places: Sequence[LeftOut]) -> list[Line2D]:
    """A cross for each place that was seen and not looked into, in a circle as wide as it, with the reason beside."""
    for place in places:
        where = (place.x_m, place.y_m)
        axes.plot(*where, "x", ms=7, mec=CRITICAL, mew=1.8, zorder=9)
        axes.add_patch(Circle(where, place.extent_m / 2.0, fill=False, ec=CRITICAL, lw=0.8, zorder=9))
        beside = (7, 4)
        axes.annotate(place.why.value, where, beside, textcoords="offset points", color=CRITICAL, fontsize=7, zorder=9)
    return [marker("x", "none", "seen and left out", CRITICAL)] if places else []


def marker(shape: str, fill: str, label: str, edge: str = INK) -> Line2D:
    """An entry of a legend."""
    return Line2D([], [], marker=shape, ls="none", ms=7, mfc=fill, mec=edge, mew=1.8, label=label)
