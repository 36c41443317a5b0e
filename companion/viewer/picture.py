"""A map as one picture: plan and two sections in one scale, laid out as in a mine drawing.

In the plan one looks down through the mine: a column of voxels is darker the more of it is occupied, so that walls
stand out, and its colour is the mean height of what is occupied in it. The sections are cuts, one voxel thick.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator

from companion.mapping.files.whole import whole_file
from companion.mapping.voxels.chunks import SHIFT
from companion.mapping.voxels.piece import Progress, silent
from companion.model import FloatArray
from companion.viewer.graphs import GraphLines
from companion.viewer.voxels import PIECE, PackedVoxels, State

DPI = 144

PLAN_PX = 1300, 850
"""Most that the plan takes, in width and height; it takes all of one of them."""

SECTION_PX = 150, 420
"""Sections lower than the first are stretched; none is higher than the second."""

_STRETCHES = 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000

_LEAST_PX = 130
"""A narrower frame gets room on both sides, for its numbers."""

_LEFT_PX, _TOP_PX, _BETWEEN_PX, _KEY_PX = 100, 110, 105, 120
_LEAST_WIDTH_PX = 1150

_INK, _FAINT, _MARK, _WAY = "#1f2428", "#6b737b", "#d55e00", "#cc3c00"
_FREE, _PAPER = np.array([222, 233, 241]) / 255.0, np.ones(3)
_FAINTEST = 0.3
"""How dark a column with a single occupied voxel is in the plan."""

_STYLE: dict[Any, Any] = {  # matplotlib's own type for this names every key that it has
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "text.color": _INK,
    "axes.edgecolor": _FAINT,
    "axes.labelcolor": _INK,
    "axes.linewidth": 0.7,
    "axes.titlesize": 8.5,
    "axes.titlelocation": "left",
    "xtick.color": _FAINT,
    "ytick.color": _FAINT,
    "legend.frameon": False,
}

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class _Raster:
    """Voxels counted in square cells, (columns, rows) each: occupied, free, and the mean height of the former."""

    occupied: FloatArray
    free: FloatArray
    height_m: FloatArray


def write_picture(
    voxels: PackedVoxels,
    title: str,
    ways: list[FloatArray],
    path: Path,
    progress: Progress = silent,
    lines: Sequence[GraphLines] = (),
) -> None:
    """Write a PNG with a plan, a section along x and one along y; whole or not at all.

    Args:
        voxels: the map.
        title: the first line of the picture.
        ways: (n, 3) positions in m of each way flown.
        path: the file.
        progress: takes the share of the work done, 0 to 1, from time to time.
        lines: navigation graphs, drawn over the plan.

    Raises:
        OSError: the file cannot be written.
    """
    figure = map_figure(voxels, title, ways, progress, lines)
    with mpl.rc_context(_STYLE), whole_file(path) as file:
        # As large as what is on it: no line runs off the sheet.
        figure.savefig(file, format="png", bbox_inches="tight", pad_inches=0.2)


def map_figure(
    voxels: PackedVoxels,
    title: str,
    ways: list[FloatArray],
    progress: Progress = silent,
    lines: Sequence[GraphLines] = (),
) -> Figure:
    """The picture that `write_picture` writes."""
    with mpl.rc_context(_STYLE):
        return _Sheet(voxels).draw(title, ways, progress, lines)


class _Sheet:
    """Scales and places of everything on the sheet."""

    def __init__(self, voxels: PackedVoxels) -> None:
        self._voxels = voxels
        self._low, high = voxels.bounds()
        size = high - self._low
        self._low_m = self._low * voxels.voxel_m
        self._size_m = size * voxels.voxel_m
        self._px_per_m = float(np.min(np.array([*PLAN_PX, SECTION_PX[1]]) / self._size_m))
        height_px = self._size_m[2] * self._px_per_m
        allowed = [times for times in _STRETCHES if times == 1 or times * height_px <= SECTION_PX[1]]
        self._stretch = next((times for times in allowed if times * height_px >= SECTION_PX[0]), allowed[-1])
        # Coarser cells where a pixel would be smaller than a voxel.
        voxel_px = self._px_per_m * voxels.voxel_m * np.array([1, 1, self._stretch])
        self._cell = np.ceil(1.0 / voxel_px - 1e-9).astype(np.int64)
        self._cells = -(-size // self._cell)
        self._frame_m = self._cells * self._cell * voxels.voxel_m
        self._heights = ScalarMappable(Normalize(self._low_m[2], self._low_m[2] + self._size_m[2]), "viridis")

    def draw(self, title: str, ways: list[FloatArray], progress: Progress, lines: Sequence[GraphLines]) -> Figure:
        """The picture."""
        scale, tall = self._px_per_m, self._px_per_m * self._stretch
        x, y = self._span(0, scale), self._span(1, scale)
        z = self._span(2, tall)
        width, depth, height = scale * (x[1] - x[0]), scale * (y[1] - y[0]), tall * (z[1] - z[0])
        whole = max(_LEFT_PX + width + _BETWEEN_PX + height, _LEAST_WIDTH_PX), _TOP_PX + depth + height + 250.0
        figure = Figure(figsize=(whole[0] / DPI, whole[1] / DPI), dpi=DPI, facecolor="white")
        FigureCanvasAgg(figure)

        def frame(left: float, top: float, wide: float, high: float) -> Axes:
            return figure.add_axes((left / whole[0], 1.0 - (top + high) / whole[1], wide / whole[0], high / whole[1]))

        below, beside = _TOP_PX + depth + _BETWEEN_PX, _LEFT_PX + width + 60.0
        plan = frame(_LEFT_PX, _TOP_PX, width, depth)
        along = frame(_LEFT_PX, below, width, height)
        across = frame(beside, _TOP_PX, height, depth)

        seen = self._counted(0, 1, progress=progress)
        # Sections go where they cut the most free space.
        cut_x, cut_y = (self._most_free(seen.free, axis) for axis in (0, 1))
        self._show(plan, self._seen_through(seen), 0, 1)
        self._show(along, self._cut(self._counted(0, 2, (1, cut_y))), 0, 2)
        # Its heights go to the right, so that y stays beside that of the plan.
        self._show(across, self._cut(self._counted(1, 2, (0, cut_x))).transpose(1, 0, 2), 2, 1)
        for way_m in ways:
            plan.plot(*way_m[:, :2].T, color=_WAY, lw=1.2, zorder=3)
        for drawn in lines:
            plan.add_collection(LineCollection(list(drawn.segments_m[:, :, :2]), colors=drawn.colour, lw=1.6, zorder=3))

        at_x, at_y = ((cut + 0.5) * self._voxels.voxel_m for cut in (cut_x, cut_y))
        stretched = "" if self._stretch == 1 else f", heights x {self._stretch}"
        plan.set(xlim=x, ylim=y, xlabel="x (m)", ylabel="y (m)")
        along.set(xlim=x, ylim=z, xlabel="x (m)", ylabel="z (m)", title=f"section A at y = {at_y:.2f} m{stretched}")
        across.set(xlim=z, ylim=y, xlabel="z (m)", title=f"section B at x = {at_x:.2f} m{stretched}")
        across.tick_params(labelleft=False)
        for axes, wide, high in ((plan, width, depth), (along, width, height), (across, height, depth)):
            axes.xaxis.set_major_locator(MaxNLocator(max(2, min(10, int(wide / 110.0))), steps=[1, 2, 5, 10]))
            axes.yaxis.set_major_locator(MaxNLocator(max(2, int(high / 45.0)), steps=[1, 2, 5, 10]))
            axes.ticklabel_format(style="plain", useOffset=False)
        dashed: dict[str, Any] = {"color": _MARK, "lw": 0.8, "ls": (0, (6, 4)), "zorder": 4}
        plan.axhline(at_y, **dashed)
        plan.axvline(at_x, **dashed)
        beyond: dict[str, Any] = {"color": _MARK, "fontweight": "bold", "textcoords": "offset points"}
        plan.annotate("A", (x[1], at_y), (4, 0), va="center", **beyond)
        plan.annotate("B", (at_x, y[1]), (0, 3), ha="center", **beyond)

        figure.text(_LEFT_PX / whole[0], 1.0 - 32.0 / whole[1], title, fontsize=13.5, va="center")
        figure.text(_LEFT_PX / whole[0], 1.0 - 66.0 / whole[1], self._facts(), color=_FAINT, va="center")
        self._add_key(figure, frame, below + height + _KEY_PX, bool(ways), lines)
        return figure

    def _span(self, axis: int, px_per_m: float) -> Span:
        """From where to where a frame goes, in m."""
        low_m, size_m = float(self._low_m[axis]), float(self._frame_m[axis])
        more_m = max(_LEAST_PX / px_per_m - size_m, 0.0) / 2.0
        return low_m - more_m, low_m + size_m + more_m

    def _facts(self) -> str:
        voxels = self._voxels
        occupied, free = voxels.count(State.OCCUPIED), voxels.count(State.FREE)
        if occupied + free == 0:
            return f"voxel {voxels.voxel_m:g} m    nothing is known: no voxel is occupied or free"
        extent = " x ".join(f"{size:.1f}" for size in self._size_m)
        known = f"{occupied:,} occupied, {free:,} free ({free * voxels.voxel_m**3:,.0f} m³)"
        return f"voxel {voxels.voxel_m:g} m    {known}    extent {extent} m"

    def _add_key(
        self, figure: Figure, frame: Callable[..., Axes], top: float, some_way: bool, lines: Sequence[GraphLines]
    ) -> None:
        """Draw the scale bar, the colours of heights and what else the colours mean into the strip at the bottom."""
        length_m = round_length_m(130.0 / self._px_per_m)
        long = length_m * self._px_per_m
        bar = frame(_LEFT_PX, top, long, 10.0)
        for part in range(4):
            bar.add_patch(Rectangle((part / 4.0, 0.0), 0.25, 1.0, facecolor=_INK if part % 2 == 0 else "white"))
        bar.set(xticks=[0.0, 1.0], xticklabels=["0", f"{length_m:g} m"], yticks=[])
        bar.tick_params(length=0)

        heights = frame(_LEFT_PX + max(long, 130.0) + 110.0, top, 240.0, 14.0)
        figure.colorbar(self._heights, cax=heights, orientation="horizontal", label="z (m)")
        heights.set_xticks(self._heights.get_clim(), [f"{at_m:.1f}" for at_m in self._heights.get_clim()])

        handles: list[Any] = [Patch(facecolor=tuple(_FREE.tolist()), edgecolor=_FAINT, label="free")]
        handles.append(Patch(facecolor="white", edgecolor=_FAINT, label="unknown"))
        if some_way:
            handles.append(Line2D([], [], color=_WAY, lw=1.8, label="way flown"))
        handles += [Line2D([], [], color=drawn.colour, lw=1.8, label=drawn.label) for drawn in lines]
        place = heights.get_position()
        figure.legend(handles=handles, loc="center left", bbox_to_anchor=(place.x1 + 0.03, place.y0), ncols=3)

    def _show(self, axes: Axes, colours: FloatArray, across: int, up: int) -> None:
        """Put (columns, rows, 3) colours where their voxels are."""
        (left, low), (right, high) = ((at[across], at[up]) for at in (self._low_m, self._low_m + self._frame_m))
        image = colours.transpose(1, 0, 2)
        axes.imshow(image, origin="lower", extent=(left, right, low, high), aspect="auto", interpolation="nearest")

    def _counted(
        self, across: int, up: int, cut: tuple[int, int] | None = None, progress: Progress = silent
    ) -> _Raster:
        """The voxels seen along the third axis, all of them, or those whose coordinate ``cut[0]`` is ``cut[1]``."""
        shape = int(self._cells[across]), int(self._cells[up])
        sums = {state: np.zeros(shape[0] * shape[1]) for state in (State.OCCUPIED, State.FREE)}
        height_m = np.zeros(shape[0] * shape[1])
        voxels = self._voxels
        if cut is not None:
            voxels = voxels.where(voxels.chunks[:, cut[0]] == cut[1] >> SHIFT)
        done = 0
        for state, total in sums.items():
            for numbers in voxels.numbers(state):
                seen = numbers if cut is None else numbers[numbers[:, cut[0]] == cut[1]]
                column, row = ((seen[:, axis] - self._low[axis]) // self._cell[axis] for axis in (across, up))
                place = column * shape[1] + row
                total += np.bincount(place, minlength=len(total))
                if state is State.OCCUPIED:
                    heights = (seen[:, 2] + 0.5) * self._voxels.voxel_m
                    height_m += np.bincount(place, heights, minlength=len(total))
                done += PIECE
                progress(min(done / (len(sums) * len(voxels.chunks)), 1.0))
        occupied, free = sums[State.OCCUPIED].reshape(shape), sums[State.FREE].reshape(shape)
        return _Raster(occupied, free, height_m.reshape(shape) / np.maximum(occupied, 1.0))

    def _most_free(self, free: FloatArray, axis: int) -> int:
        """The voxel coordinate along an axis of the plan at which there is the most free space."""
        cut = free.sum(axis=1 - axis)
        # Of many that are as good, the one in the middle.
        good = np.flatnonzero(cut >= 0.95 * cut.max())
        middle = int(good[len(good) // 2]) * self._cell[axis] + self._cell[axis] // 2
        return int(self._low[axis] + middle)

    def _shades(self, height_m: FloatArray) -> FloatArray:
        return np.asarray(self._heights.to_rgba(height_m)[..., :3])

    def _seen_through(self, seen: _Raster) -> FloatArray:
        """The plan: the more of a column is occupied, the more of its colour."""
        some = seen.occupied[seen.occupied > 0]
        most = float(np.quantile(some, 0.95)) if len(some) else 1.0
        dense = np.clip(seen.occupied / most, _FAINTEST, 1.0)[..., None] * (seen.occupied > 0)[..., None]
        ground = np.where((seen.free > 0)[..., None], _FREE, _PAPER)
        return np.asarray(dense * self._shades(seen.height_m) + (1.0 - dense) * ground)

    def _cut(self, seen: _Raster) -> FloatArray:
        """A section: what is occupied, free and unknown, nothing else."""
        ground = np.where((seen.free > 0)[..., None], _FREE, _PAPER)
        return np.where((seen.occupied > 0)[..., None], self._shades(seen.height_m), ground)


def round_length_m(least_m: float) -> float:
    """The smallest of 1, 2, 5, 10 ... (and 0.5, 0.2 ...) that is at least ``least_m``."""
    power = 10.0 ** math.floor(math.log10(least_m))
    return power * next(step for step in (1.0, 2.0, 5.0, 10.0) if step * power >= least_m * (1.0 - 1e-9))
