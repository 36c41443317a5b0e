"""A map as one picture: plan and two sections in one scale, laid out as in a mine drawing.

In the plan one looks down through the mine: a column of voxels is darker the more of it is occupied, so that walls
stand out, and its colour is the mean height of what is occupied in it. The sections are cuts, one voxel thick.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from companion.mapping.files.colours import viridis
from companion.mapping.files.export import Progress, silent
from companion.mapping.files.whole import whole_file
from companion.mapping.voxels.chunks import SHIFT
from companion.model import FloatArray
from companion.viewer.canvas import FAINT, MARK, TITLE_PX, Axis, Paper, text_width
from companion.viewer.voxels import PIECE, PackedVoxels, State

PLAN_PX = 1300, 850
"""Most that the plan takes, in width and height; it takes all of one of them."""

SECTION_PX = 150, 420
"""Sections lower than the first are stretched; none is higher than the second."""

_STRETCHES = 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000
_MARGIN_PX, _AXIS_PX, _BELOW_PX, _TITLE_PX, _KEY_PX = 30, 80, 56, 92, 64
_LEAST_WIDTH_PX = 1150

_FREE = np.array([222, 233, 241], np.float64)
_PAPER = np.array([255, 255, 255], np.float64)
_WAY = (204, 60, 0)

_FAINTEST = 0.3
"""How dark a column with a single occupied voxel is in the plan."""


@dataclass(frozen=True, slots=True)
class _Raster:
    """Voxels counted in square cells, (columns, rows) each: occupied, free, and the mean height of the former."""

    occupied: FloatArray
    free: FloatArray
    height_m: FloatArray


def write_picture(
    voxels: PackedVoxels, title: str, ways: list[FloatArray], path: Path, progress: Progress = silent
) -> None:
    """Write a PNG with a plan, a section along x and one along y; whole or not at all.

    Args:
        voxels: the map.
        title: the first line of the picture.
        ways: (n, 3) positions in m of each way flown.
        path: the file.
        progress: takes the share of the work done, 0 to 1, from time to time.

    Raises:
        OSError: the file cannot be written.
    """
    sheet = _Sheet(voxels)
    picture = sheet.draw(title, ways, progress)
    with whole_file(path) as file:
        picture.save(file, format="PNG")


class _Sheet:
    """Scales and places of everything on the sheet."""

    def __init__(self, voxels: PackedVoxels) -> None:
        self._voxels = voxels
        self._low, high = _bounds(voxels)
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

    def draw(self, title: str, ways: list[FloatArray], progress: Progress) -> Image.Image:
        """The picture."""
        (x_low, y_low, z_low), (x_high, y_high, z_high) = self._low_m, self._low_m + self._frame_m
        scale, tall = self._px_per_m, self._px_per_m * self._stretch
        width, depth = (round(float(size) * scale) for size in self._frame_m[:2])
        height = round(float(self._frame_m[2]) * tall)
        left, top = _MARGIN_PX + _AXIS_PX, _TITLE_PX
        below, beside = top + depth + _BELOW_PX + 30, left + width + 60
        x = Axis(x_low, x_high, left, scale)
        y = Axis(y_low, y_high, top + depth, -scale)
        z_up = Axis(z_low, z_high, below + height, -tall)
        z_right = Axis(z_low, z_high, beside, tall)

        plan = self._counted(0, 1, progress=progress)
        # Sections go where they cut the most free space.
        cut_x, cut_y = (self._most_free(plan.free, axis) for axis in (0, 1))
        along, across = self._counted(0, 2, (1, cut_y)), self._counted(1, 2, (0, cut_x))
        voxel_m = self._voxels.voxel_m
        at_y, at_x = (cut_y + 0.5) * voxel_m, (cut_x + 0.5) * voxel_m
        times = "" if self._stretch == 1 else f", heights x {self._stretch}"
        caption_a, caption_b = f"section A at y = {at_y:.2f} m{times}", f"section B at x = {at_x:.2f} m{times}"

        widest = max(
            beside + height + 20,
            beside + text_width(caption_b),
            left + text_width(caption_a),
            _MARGIN_PX + text_width(title, TITLE_PX),
        )
        paper = Paper(max(widest + _MARGIN_PX, _LEAST_WIDTH_PX), below + height + _BELOW_PX + _KEY_PX + _MARGIN_PX)
        paper.raster(self._seen_through(plan), x, y)
        paper.raster(self._cut(along), x, z_up)
        # Its heights go to the right, so that y stays beside that of the plan.
        paper.raster(np.ascontiguousarray(np.rot90(self._cut(across), -1)), z_right, y)
        for way in ways:
            for one in _within(way, x, y):
                paper.line([(x.at(px), y.at(py)) for px, py, _ in one], _WAY, 2)
        paper.axes(x, y, "x (m)", "y (m)")
        paper.axes(x, z_up, "x (m)", "z (m)")
        paper.axes(z_right, y, "z (m)", None)

        paper.dashes((left, y.at(at_y)), (left + width, y.at(at_y)))
        paper.dashes((x.at(at_x), top), (x.at(at_x), top + depth))
        paper.text(left + width + 8, y.at(at_y), "A", colour=MARK, anchor="lm")
        paper.text(x.at(at_x), top - 6, "B", colour=MARK, anchor="ms")
        paper.text(left, below - 6, caption_a, anchor="ls")
        paper.text(beside, top - 6, caption_b, anchor="ls")
        self._explain(paper, title, below + height + _BELOW_PX + _KEY_PX // 2, ways)
        return paper.image

    def _explain(self, paper: Paper, title: str, at_px: float, ways: list[FloatArray]) -> None:
        """Write the title, and the scale bar and the key into the strip at the bottom."""
        voxels = self._voxels
        occupied, free = voxels.count(State.OCCUPIED), voxels.count(State.FREE)
        extent = " x ".join(f"{size:.1f}" for size in self._size_m)
        paper.text(_MARGIN_PX, 14, title, TITLE_PX)
        known = (
            f"{occupied:,} occupied, {free:,} free ({free * voxels.voxel_m**3:,.0f} cubic m)    extent {extent} m"
            if occupied + free
            else "nothing is known: no voxel is occupied or free"
        )
        paper.text(_MARGIN_PX, 48, f"voxel {voxels.voxel_m:g} m    {known}", colour=FAINT)
        x = paper.scale_bar(_MARGIN_PX + 20, at_px, self._px_per_m) + 60
        steps = 220
        bar = np.repeat(viridis(np.linspace(0.0, 1.0, steps))[None], 14, axis=0)
        paper.raster(bar, Axis(0.0, steps, x + 60, 1.0), Axis(0.0, 14.0, at_px + 7, -1.0))
        low_m, high_m = self._low_m[2], self._low_m[2] + self._size_m[2]
        paper.text(x + 52, at_px, f"z {low_m:.1f} m", anchor="rm")
        paper.text(x + 68 + steps, at_px, f"{high_m:.1f} m", anchor="lm")
        x += steps + 160
        shade: tuple[int, int, int] = tuple(int(part) for part in _FREE)  # type: ignore[assignment]
        paper.box((x, at_px - 8, x + 24, at_px + 8), shade)
        paper.text(x + 34, at_px, "free", anchor="lm")
        paper.box((x + 100, at_px - 8, x + 124, at_px + 8), (255, 255, 255))
        paper.text(x + 134, at_px, "unknown", anchor="lm")
        if ways:
            paper.line([(x + 240, at_px), (x + 264, at_px)], _WAY, 3)
            paper.text(x + 274, at_px, "way flown", anchor="lm")

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
        share = (height_m - self._low_m[2]) / self._size_m[2]
        return viridis(share).astype(np.float64)

    def _seen_through(self, seen: _Raster) -> NDArray[np.uint8]:
        """The plan: the more of a column is occupied, the more of its colour."""
        some = seen.occupied[seen.occupied > 0]
        most = float(np.quantile(some, 0.95)) if len(some) else 1.0
        dense = np.clip(seen.occupied / most, _FAINTEST, 1.0)[..., None] * (seen.occupied > 0)[..., None]
        ground = np.where((seen.free > 0)[..., None], _FREE, _PAPER)
        return _upright(dense * self._shades(seen.height_m) + (1.0 - dense) * ground)

    def _cut(self, seen: _Raster) -> NDArray[np.uint8]:
        """A section: what is occupied, free and unknown, nothing else."""
        ground = np.where((seen.free > 0)[..., None], _FREE, _PAPER)
        return _upright(np.where((seen.occupied > 0)[..., None], self._shades(seen.height_m), ground))


def _upright(colours: FloatArray) -> NDArray[np.uint8]:
    """(columns, rows, 3) with the origin at the lower left as an image, whose rows begin at the top."""
    return colours.transpose(1, 0, 2)[::-1].round().astype(np.uint8)


def _bounds(voxels: PackedVoxels) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Lowest voxel and the one after the highest of what is known; one voxel at the origin of an empty map."""
    some = voxels.where(np.asarray(voxels.bits[[State.OCCUPIED, State.FREE]].any(axis=(0, 2))))
    chunks = some.chunks
    if len(chunks):
        # Only what is farthest out can be at an edge.
        outer = (chunks == np.stack([chunks.min(axis=0), chunks.max(axis=0)])[:, None]).any(axis=(0, 2))
        some = some.where(np.asarray(outer, np.bool_))
    corners = [
        corner
        for state in (State.OCCUPIED, State.FREE)
        for numbers in some.numbers(state)
        if len(numbers)
        for corner in (numbers.min(axis=0), numbers.max(axis=0))
    ]
    if not corners:
        return np.zeros(3, np.int64), np.ones(3, np.int64)
    together = np.array(corners, np.int64)
    return together.min(axis=0), together.max(axis=0) + 1


def _within(way_m: FloatArray, x: Axis, y: Axis) -> list[FloatArray]:
    """The parts of a way that lie in the frame."""
    inside = (way_m[:, 0] >= x.low_m) & (way_m[:, 0] <= x.high_m) & (way_m[:, 1] >= y.low_m) & (way_m[:, 1] <= y.high_m)
    parts = np.split(np.arange(len(way_m)), np.flatnonzero(np.diff(inside)) + 1)
    return [way_m[part] for part in parts if len(part) > 1 and inside[part[0]]]
