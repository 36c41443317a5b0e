"""Surveys of a growing map: what changed since the last one is looked at, and the rest is kept."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from companion.mapping.chunks import CHUNK_LIMIT, EDGE
from companion.mapping.lookup import UNKNOWN
from companion.mapping.piece import MapPiece
from companion.mapping.queries import plan_search as search
from companion.mapping.queries.flood import WIDEST, Work, add_flown, flown_at, follow_map, no_tasks, remove_flown
from companion.mapping.queries.frontier import LEAST_FRONTIER_M, MOST_FRONTIERS, Access, Frontier, Reach, Survey
from companion.mapping.queries.plan import (
    CELLS,
    FRONTIER,
    MOST_SHEETS,
    TILE,
    Plan,
    Shape,
    empty_plan,
    first_sheet,
    is_node,
    kind_of,
    room_for,
)
from companion.mapping.queries.state_grid import StateGrid
from companion.mapping.snapshot import MapSnapshot
from companion.model import FloatArray

CELL_M = 0.1
"""Edge of a cell of the plan, or the edge of a voxel where that is more."""

MOST_PLACES = 500_000
"""Cells flown through that are remembered, 50 km of them: what comes later is not."""

_TOLERANCE_CELLS = 1.0
"""Half a voxel of the obstacle and half a cell of the vehicle: what is so much nearer than d_s still counts as d_s."""

_WALL_FUZZ_M = 0.25
"""Unknown cells this near to an occupied one are the undecided voxels of its surface."""

_LOOK_SHARE = 0.9
"""Share of the camera's range from which a frontier is sure to be cleared up."""

_SURFACE_SHARE = 0.75
"""Floor and roof count where the camera can see them from this share of its range."""

_GAP_M = 0.2
"""So much of which the looks did not decide may lie before a floor or a roof."""

_DROP_M = 1.0
"""How far below where it should be the ground is still looked for."""

_MOST_AT_ONCE = 4096
"""Cells or places that are brought up to date at once: what waits meanwhile needs room."""


class Surveyor:
    """Surveys one map. For one thread at a time.

    It keeps the states of all voxels, which `nearest` and `sight` may ask too, and the plan at flight height: for 10 km
    of tunnel less than 150 MB. It is told what changes, and a survey costs what has changed and a little for all.

    Args:
        voxel_m: edge of a voxel.
        reach: what the vehicle can do.
    """

    def __init__(self, voxel_m: float, reach: Reach) -> None:
        self.known = StateGrid(voxel_m)
        self._reach = reach
        self._shape = _shape(voxel_m, reach)
        self._cell_m = self._shape.stride * voxel_m
        self._plan = empty_plan()
        self._tasks = no_tasks()
        self._touched = np.zeros(MOST_SHEETS, np.bool_)
        self._kept = _circle(min(reach.critical_margin_m / self._cell_m, WIDEST))[1:]
        self._near = np.empty((4 * len(self._kept) + 19, 2), np.int64)
        self._wall_cells = max(_WALL_FUZZ_M, self._cell_m) / self._cell_m + 1e-9
        self._fuzz = _circle(self._wall_cells)[1:]
        self._counts = np.zeros((MOST_SHEETS, search.COUNTS), np.int32)
        self._reached = np.zeros((MOST_SHEETS, 4), np.uint64)
        self._dirty: list[NDArray[np.int64]] = []
        self._flown = np.empty(1024, np.int64)
        self._flown_count = 0
        self._here = -1

    def update(self, snapshot: MapSnapshot) -> None:
        """Take what has changed in the map.

        Args:
            snapshot: the chunks that changed, or more.

        Raises:
            ValueError: it has voxels of another size.
        """
        self._changed(snapshot.chunks, self.known.update(snapshot))

    def put(self, piece: MapPiece, threshold: int) -> None:
        """The same, from a piece of a map; a voxel is occupied from ``threshold`` on."""
        self._changed(piece.chunks, self.known.put(piece, threshold))

    def flew(self, places_m: FloatArray) -> None:
        """Remember where the vehicle was at flight height: there it is free, and from there all is looked for.

        Args:
            places_m: (n, 3), in the order of time.

        Raises:
            ValueError: a place is not finite.
        """
        self._follow()
        self._leave()
        places = self._on_plan(places_m)[: MOST_PLACES - self._flown_count]
        for first in range(0, len(places), _MOST_AT_ONCE):
            nodes = add_flown(self._work, places[first : first + _MOST_AT_ONCE])
            nodes = nodes[nodes >= 0]
            end = self._flown_count + len(nodes)
            if end > len(self._flown):
                self._flown = np.concatenate([self._flown, np.empty(max(end, len(self._flown)), np.int64)])
            self._flown[self._flown_count : end] = nodes
            self._flown_count = end

    def survey(self, here_m: tuple[float, float, float]) -> Survey:
        """Look for frontiers.

        Args:
            here_m: where the vehicle is. For this survey it counts as a place where it was.

        Raises:
            ValueError: the place is not finite.
        """
        self._follow()
        places = self._on_plan(np.array([here_m]))
        if len(places) == 0:
            return self._result(np.zeros((0, 2), np.int64), np.zeros((0, 4)), here_m)
        i, j, height_mm = (int(part) for part in places[0])
        here = int(flown_at(self._plan, i, j, height_mm, self._shape.level_mm))
        if here != self._here:
            self._leave()
            here = int(flown_at(self._plan, i, j, height_mm, self._shape.level_mm))
        if here < 0:
            here = self._here = int(add_flown(self._work, places)[0])
        cells, about = self._look(here)
        return self._result(cells, about, here_m)

    @property
    def memory_bytes(self) -> int:
        """Memory that is in use for the map and for the plan."""
        sheets = int(self._plan.used[0])
        plan, counts = self._plan, self._counts
        by_sheet: list[NDArray[np.generic]] = [plan.others, plan.corners, counts, self._reached, self._touched]
        by_node: list[NDArray[np.generic]] = [plan.heights_mm, plan.rises_mm, plan.steps, plan.ranks]
        by_node += [plan.kinds, plan.flags, plan.parts]
        used = sum(sheets * array.nbytes // MOST_SHEETS for array in [*by_sheet, *by_node])
        fixed = plan.keys.nbytes + plan.firsts.nbytes + sum(array.nbytes for array in self._tasks)
        return self.known.memory_bytes + used + fixed + self._flown.nbytes

    @property
    def _work(self) -> Work:
        return Work(self.known.grid, self._plan, self._shape, self._tasks, self._kept, self._near, self._touched)

    def _changed(self, chunks: NDArray[np.int32], bricks: NDArray[np.uint64]) -> None:
        different = bricks != 0
        if different.any():
            self._dirty.append(_cells_over(chunks[different].astype(np.int64), bricks[different], self._shape.stride))

    def _follow(self) -> None:
        """Bring the plan up to date with the map."""
        if not self._dirty:
            return
        cells = np.unique(np.concatenate(self._dirty))
        self._dirty = []
        both = np.stack([cells >> 32, (cells & 0xFFFFFFFF) - 2**31], axis=1)
        for first in range(0, len(both), _MOST_AT_ONCE):
            follow_map(self._work, both[first : first + _MOST_AT_ONCE])
        # What lies behind unknown nodes may be different where no node is.
        _touch_under(self._plan, both, self._touched)

    def _leave(self) -> None:
        """Where the vehicle was at the last survey counts no longer, unless it was told that it flew there."""
        if self._here >= 0:
            remove_flown(self._work, self._here)
            self._here = -1

    def _on_plan(self, places_m: FloatArray) -> NDArray[np.int64]:
        """(n, 3) the cells of some places and their heights in mm."""
        places = np.asarray(places_m, np.float64).reshape(-1, 3)
        if not np.isfinite(places).all():
            raise ValueError("a place has coordinates that are not finite")
        # Beyond what can be mapped there is nothing to survey.
        inside = np.all(np.abs(places) < (CHUNK_LIMIT - TILE) * EDGE * self.known.voxel_m, axis=1)
        places = places[inside & (np.abs(places[:, 2]) < _MOST_HEIGHT_M)]
        cells = np.floor(places[:, :2] / self._cell_m)
        return np.concatenate([cells, np.rint(places[:, 2:] * 1000.0)], axis=1).astype(np.int64)

    def _look(self, here: int) -> tuple[NDArray[np.int64], FloatArray]:
        """The cells of all frontiers, as from `search.clusters`, with everything that they depend on."""
        plan, shape, counts = self._plan, self._shape, self._counts
        blocked_cells = self._reach.margin_m / self._cell_m - _TOLERANCE_CELLS
        look_cells = int(_LOOK_SHARE * self._reach.look_m / self._cell_m)
        search.count_tiles(plan, self._touched, counts)
        _make_room_around(plan, self._touched, int(self._wall_cells))
        tiles = search.around(plan, self._touched, 1)
        search.probe(self.known.grid, plan, shape, tiles, self._fuzz, counts[:, 3])
        rim = math.ceil(max(blocked_cells, self._wall_cells, 1.0) / TILE)
        tiles = search.around(plan, tiles, rim)
        search.mark_near(plan, shape, tiles, max(blocked_cells, 0.0), self._wall_cells)
        search.part_sheets(plan, shape, tiles)
        away_m = np.empty(int(plan.used[0]))
        found = search.reach(
            plan,
            shape,
            np.array([here] if here >= 0 else [], np.int64),
            self._flown[: self._flown_count],
            away_m,
            TILE * self._cell_m,
        )
        search.count_reached(plan, found, self._reached, tiles, counts)
        tiles = search.around(plan, tiles, look_cells // TILE + 1)
        search.mark_frontiers(plan, shape, tiles, self._reached, look_cells, counts)
        self._touched[:] = False
        cells, about = search.clusters(plan, shape, counts, self._reached, away_m)
        return cells, about

    def _result(self, cells: NDArray[np.int64], about: FloatArray, here_m: tuple[float, float, float]) -> Survey:
        edge_m = self._cell_m
        frontiers = self._frontiers(cells, about, here_m)
        counted = [frontier for frontier in frontiers if frontier.access is not Access.TOO_NARROW]
        lengths_m = np.sort(np.array([frontier.length_m for frontier in counted]))[::-1]
        free, seen, missing, _, _, reached = (int(count) for count in self._counts.sum(axis=0, dtype=np.int64))
        return Survey(
            free_m2=free * edge_m**2,
            reachable_m2=reached * edge_m**2,
            frontiers_m=lengths_m,
            surfaces_seen=seen,
            surfaces_missing=missing,
            # Floor and roof: two cells for each cell of plan.
            expected_cells=2.0 * float(lengths_m.sum()) * self._reach.look_m / edge_m**2,
            occupied=self.known.occupied_count,
            frontiers=tuple(sorted(frontiers, key=_order)[:MOST_FRONTIERS]),
            cut_short=bool(self._plan.used[1] or self._tasks.state[3] or self._flown_count == MOST_PLACES),
        )

    def _frontiers(
        self, cells: NDArray[np.int64], about: FloatArray, here_m: tuple[float, float, float]
    ) -> list[Frontier]:
        """Those that are long enough."""
        plan, edge_m = self._plan, self._cell_m
        nodes, groups = cells[:, 0], cells[:, 1]
        ends = np.flatnonzero(np.diff(groups, append=-1)) + 1
        made = []
        first = 0
        for end in ends.tolist():
            part = slice(first, end)
            first = end
            length_m = (part.stop - part.start) * edge_m
            if length_m < LEAST_FRONTIER_M - 1e-9:
                continue
            its = nodes[part]
            on_tile = its % CELLS
            x_m = (plan.corners[its // CELLS, 0] + (on_tile >> 4) + 0.5) * edge_m
            y_m = (plan.corners[its // CELLS, 1] + (on_tile & 15) + 0.5) * edge_m
            to_free = about[part, :2].sum(axis=0)
            reachable = bool(about[part, 2].any())
            middle = float(x_m.mean()), float(y_m.mean()), float(plan.heights_mm[its].mean()) / 1000.0
            path_m = float(about[part, 3].min())
            made.append(
                Frontier(
                    access=Access.REACHABLE
                    if reachable
                    else Access.IN_SIGHT
                    if plan.flags[its[0]] & FRONTIER
                    else Access.TOO_NARROW,
                    length_m=length_m,
                    x_m=middle[0],
                    y_m=middle[1],
                    z_m=middle[2],
                    low_m=(float(x_m.min()) - edge_m / 2.0, float(y_m.min()) - edge_m / 2.0),
                    high_m=(float(x_m.max()) + edge_m / 2.0, float(y_m.max()) + edge_m / 2.0),
                    bearing_rad=math.atan2(-to_free[1], -to_free[0]),
                    path_m=max(path_m, math.dist(middle, here_m)),
                    cells=len(its),
                )
            )
        return made


def survey(snapshot: MapSnapshot, flown_m: FloatArray, reach: Reach) -> Survey:
    """One survey of a whole map, when there will be no other.

    Args:
        snapshot: of all chunks.
        flown_m: (n, 3) where the vehicle was, in the order of time.
        reach: what it can do.
    """
    surveyor = Surveyor(snapshot.voxel_m, reach)
    surveyor.update(snapshot)
    if len(flown_m) == 0 or surveyor.known.chunk_count == 0:
        return Survey(0.0, 0.0, np.zeros(0), 0, 0, 0.0, surveyor.known.occupied_count)
    surveyor.flew(flown_m)
    x_m, y_m, z_m = flown_m[-1].tolist()
    return surveyor.survey((x_m, y_m, z_m))


_MOST_HEIGHT_M = 100_000.0
"""Heights are kept in mm: so far they fit, and no mine is so deep."""


def _order(frontier: Frontier) -> tuple[bool, float, float, float, float]:
    narrow = frontier.access is Access.TOO_NARROW
    return narrow, frontier.path_m, -frontier.length_m, frontier.x_m, frontier.y_m


def _shape(voxel_m: float, reach: Reach) -> Shape:
    stride = max(1, round(CELL_M / voxel_m))
    half = max(1, round(reach.half_slab_m / voxel_m))
    gap = max(1, round(_GAP_M / voxel_m))
    up_m = max(_SURFACE_SHARE * reach.look_m * math.tan(reach.up_rad), 0.0)
    down_m = max(_SURFACE_SHARE * reach.look_m * math.tan(reach.down_rad), 0.0)
    return Shape(
        voxel_mm=1000.0 * voxel_m,
        stride=stride,
        height_mm=round(1000.0 * reach.height_m),
        most_mm=round(1000.0 * reach.max_slope * stride * voxel_m),
        level_mm=round(500.0 * reach.height_m),
        half=half,
        gap=gap,
        below=math.ceil((max(reach.height_m + _DROP_M, down_m) + reach.half_slab_m) / voxel_m),
        above=math.ceil((up_m + reach.half_slab_m) / voxel_m) + gap + 1,
        up=math.floor(up_m / voxel_m) - half + gap,
        down=math.floor(down_m / voxel_m) - half + gap,
    )


def _circle(radius_cells: float) -> NDArray[np.int64]:
    """(n, 2) cells in a circle around one, near ones first."""
    rim = math.floor(radius_cells)
    cells = [(a * a + b * b, a, b) for a in range(-rim, rim + 1) for b in range(-rim, rim + 1)]
    inside = [cell[1:] for cell in sorted(cells) if cell[0] <= radius_cells * radius_cells]
    return np.array(inside, np.int64).reshape(-1, 2)


@njit(cache=True, nogil=True)
def _cells_over(chunks: NDArray[np.int64], bricks: NDArray[np.uint64], stride: int) -> NDArray[np.int64]:
    """The cells of the plan over bricks that changed, both coordinates in one number, some of them twice.

    Args:
        chunks: (n, 3) coordinates.
        bricks: (n,) bit b for brick b.
        stride: voxels along one edge of a cell.
    """
    cells = np.empty(1024, np.int64)
    count = 0
    for n in range(chunks.shape[0]):
        # The bits of a brick's number are those of x, y, z, x, y, z: those of z are folded away.
        columns = bricks[n] | bricks[n] >> np.uint64(4)
        columns |= columns >> np.uint64(32)
        for brick in range(64):
            if brick & 0b100100 or not columns >> np.uint64(brick) & np.uint64(1):
                continue
            x = EDGE * chunks[n, 0] + 4 * ((brick & 1) | (brick >> 2 & 2))
            y = EDGE * chunks[n, 1] + 4 * ((brick >> 1 & 1) | (brick >> 3 & 2))
            for i in range(x // stride, (x + 3) // stride + 1):
                for j in range(y // stride, (y + 3) // stride + 1):
                    if count == cells.shape[0]:
                        cells = np.concatenate((cells, np.empty_like(cells)))
                    cells[count] = i << 32 | (j + 2**31)
                    count += 1
    return cells[:count]


@njit(cache=True, nogil=True)
def _touch_under(plan: Plan, cells: NDArray[np.int64], touched: NDArray[np.bool_]) -> None:
    """Mark the tiles of cells (n, 2)."""
    for n in range(cells.shape[0]):
        sheet = first_sheet(plan, cells[n, 0], cells[n, 1])
        if sheet >= 0:
            touched[sheet] = True


@njit(cache=True, nogil=True)
def _make_room_around(plan: Plan, touched: NDArray[np.bool_], rim: int) -> None:
    """Make the tiles into which unknown nodes of marked ones look for a wall, so that it is found there."""
    for first in range(plan.used[0]):
        sheet = int(first if touched[first] else -1)
        while sheet >= 0:
            for place in range(CELLS):
                node = sheet * CELLS + place
                if not (is_node(plan, node) and kind_of(plan, node) == UNKNOWN):
                    continue
                i, j = plan.corners[sheet, 0] + (place >> 4), plan.corners[sheet, 1] + (place & 15)
                for a in (-rim, rim):
                    for b in (-rim, rim):
                        if first_sheet(plan, i + a, j + b) < 0:
                            room_for(plan, i + a, j + b)
            sheet = int(plan.others[sheet])
