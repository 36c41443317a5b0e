"""Surveys of a growing map: what changed since the last one is looked at, and the rest is kept.

`Surveyor` follows the map and the flight, and does one step of a survey after the other; what a step does is in
the file that its functions come from.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from companion.control.left_out import LeftOut, merged
from companion.mapping.frontiers.flood import add_flown, follow_map, remove_flown
from companion.mapping.frontiers.flood_work import WIDEST, Work, flown_at, no_tasks
from companion.mapping.frontiers.frontier import MOST_FRONTIERS, Access, Reach, Survey
from companion.mapping.frontiers.frontier_cells import clusters, frontiers_of, mark_frontiers
from companion.mapping.frontiers.left_out import left_out
from companion.mapping.frontiers.plan import MOST_SHEETS, TILE, cells_within, empty_plan, shape_of
from companion.mapping.frontiers.reachable import count_reached, part_sheets, reached_parts
from companion.mapping.frontiers.state_grid import StateGrid
from companion.mapping.frontiers.tiles import (
    COUNTS,
    FREE_CELLS,
    REACHED_CELLS,
    SURFACES_MISSING,
    SURFACES_SEEN,
    UNKNOWN_CELLS,
    cells_over,
    count_tiles,
    tiles_around,
    touch_under,
)
from companion.mapping.frontiers.walls import make_room_around, mark_near, probe
from companion.mapping.voxels.chunks import CHUNK_LIMIT, EDGE
from companion.mapping.voxels.piece import MapPiece, MapSnapshot
from companion.model import FloatArray

MOST_PLACES = 500_000
"""Cells flown through that are remembered, 50 km of them: what comes later is not."""

_MOST_HEIGHT_M = 100_000.0
"""Heights are kept in mm: so far they fit, and no mine is so deep."""

_TOLERANCE_CELLS = 1.0
"""Half a voxel of the obstacle and half a cell of the vehicle: what is so much nearer than d_s still counts as d_s."""

_WALL_FUZZ_M = 0.25
"""Unknown cells this near to an occupied one are the undecided voxels of its surface."""

_LOOK_SHARE = 0.9
"""Share of the camera's range from which a frontier is sure to be cleared up."""

_MOST_AT_ONCE = 4096
"""Cells or places that are brought up to date at once: what waits meanwhile needs room."""


class Surveyor:
    """Surveys one map. For one thread at a time.

    It keeps the states of all voxels, which `nearest` and `sight` may ask too, and the plan at flight height: for 10 km
    of tunnel less than 150 MB. It is given what changes, and a survey costs what has changed and a little for all.

    Args:
        voxel_m: edge of a voxel.
        reach: what the vehicle can do.
    """

    def __init__(self, voxel_m: float, reach: Reach) -> None:
        self.known = StateGrid(voxel_m)
        self._reach = reach
        self._shape = shape_of(voxel_m, reach)
        self._cell_m = self._shape.stride * voxel_m
        self._plan = empty_plan()
        self._tasks = no_tasks()
        self._touched = np.zeros(MOST_SHEETS, np.bool_)
        self._kept = cells_within(min(reach.critical_margin_m / self._cell_m, WIDEST))[1:]
        self._near = np.empty((4 * len(self._kept) + 19, 2), np.int64)
        self._wall_cells = max(_WALL_FUZZ_M, self._cell_m) / self._cell_m + 1e-9
        self._fuzz = cells_within(self._wall_cells)[1:]
        self._counts = np.zeros((MOST_SHEETS, COUNTS), np.int32)
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

    def left_out(self, found: Survey) -> tuple[LeftOut, ...]:
        """What the vehicle has seen the beginning of and not looked into; takes longer than a survey.

        Args:
            found: the last survey, after which nothing was changed.
        """
        places = left_out(self.known.grid, self._plan, self._shape, self._reached, found.frontiers)
        return merged(places)

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
            self._dirty.append(cells_over(chunks[different].astype(np.int64), bricks[different], self._shape.stride))

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
        touch_under(self._plan, both, self._touched)

    def _leave(self) -> None:
        """Where the vehicle was at the last survey counts no longer, unless `flew` has it."""
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
        """The cells of all frontiers, as from `clusters`, with everything that they depend on."""
        plan, shape, counts = self._plan, self._shape, self._counts
        blocked_cells = self._reach.margin_m / self._cell_m - _TOLERANCE_CELLS
        look_cells = int(_LOOK_SHARE * self._reach.look_m / self._cell_m)
        count_tiles(plan, self._touched, counts)
        make_room_around(plan, self._touched, int(self._wall_cells))
        tiles = tiles_around(plan, self._touched, 1)
        probe(self.known.grid, plan, shape, tiles, self._fuzz, counts[:, UNKNOWN_CELLS])
        rim = math.ceil(max(blocked_cells, self._wall_cells, 1.0) / TILE)
        tiles = tiles_around(plan, tiles, rim)
        mark_near(plan, shape, tiles, max(blocked_cells, 0.0), self._wall_cells)
        part_sheets(plan, shape, tiles)
        away_m, start = np.empty(int(plan.used[0])), np.array([here] if here >= 0 else [], np.int64)
        flown = self._flown[: self._flown_count]
        found = reached_parts(plan, shape, start, flown, away_m, TILE * self._cell_m)
        count_reached(plan, found, self._reached, tiles, counts)
        tiles = tiles_around(plan, tiles, look_cells // TILE + 1)
        mark_frontiers(plan, shape, tiles, self._reached, look_cells, counts)
        self._touched[:] = False
        cells, about = clusters(plan, shape, counts, self._reached, away_m)
        return cells, about

    def _result(self, cells: NDArray[np.int64], about: FloatArray, here_m: tuple[float, float, float]) -> Survey:
        edge_m = self._cell_m
        frontiers = frontiers_of(self._plan, edge_m, cells, about, here_m)
        counted = [frontier for frontier in frontiers if frontier.access is not Access.TOO_NARROW]
        lengths_m = np.sort(np.array([frontier.length_m for frontier in counted]))[::-1]
        totals = self._counts.sum(axis=0, dtype=np.int64).tolist()
        return Survey(
            free_m2=totals[FREE_CELLS] * edge_m**2,
            reachable_m2=totals[REACHED_CELLS] * edge_m**2,
            frontiers_m=lengths_m,
            surfaces_seen=totals[SURFACES_SEEN],
            surfaces_missing=totals[SURFACES_MISSING],
            # Floor and roof: two cells for each cell of plan.
            expected_cells=2.0 * float(lengths_m.sum()) * self._reach.look_m / edge_m**2,
            occupied=self.known.occupied_count,
            frontiers=tuple(frontiers[:MOST_FRONTIERS]),
            cut_short=bool(self._plan.used[1] or self._tasks.state[3] or self._flown_count == MOST_PLACES),
        )


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
