"""What is left to explore, and whether the map is complete (METHOD Definition 2.3).

In flight there is no truth: the map is complete when no frontier, known free space next to unknown, is left that the
vehicle could reach or look at while it keeps d_s from everything. This is decided on a plan at flight height, which
follows the ground, over the slab that counts as obstacle: a camera that looks forward with 57° from floor to roof sees
them near the walls only from metres back, so a frontier of voxels would have specks there nearly always. Floor and roof
are counted instead: of every free cell it is asked whether the surface below and above was seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from companion.config.control import ControlSettings
from companion.config.mapping import MapSettings
from companion.mapping.lookup import FREE, OCCUPIED, UNKNOWN
from companion.mapping.plan import MISSING, SEEN, TILE, Plan, Shape, Voxels, flood, packed
from companion.mapping.plan_search import clusters, near_obstacles, reached, seen_from
from companion.mapping.snapshot import MapSnapshot
from companion.model import Camera, FloatArray

CELL_M = 0.1
"""Edge of a cell of the plan, or the edge of a voxel where that is more."""

LEAST_FRONTIER_M = 0.5
"""A shorter frontier is ignored. Depth noise and missing pixels leave specks of a few voxels, and what hides behind
half a metre is too small for a vehicle that needs 2 d_c to pass."""

ENOUGH_SEEN = 0.97
"""Share of floor and roof that has to be seen. Not all: no reachable place looks into every niche and shadow."""

SETTLED_SEEN = 0.85
SETTLED_S = 180.0
"""What is left may be what the camera cannot see: water, glass, a shaft. When at least `SETTLED_SEEN` of floor and roof
was seen, no opening is left that the vehicle fits through, and flying this long brought nothing new, the map counts as
complete, or a mission would never end."""

NEWS_SHARE = 0.002
"""So much more floor and roof than before is something new."""

_TOLERANCE_CELLS = 1.0
"""Half a voxel of the obstacle and half a cell of the vehicle: what is so much nearer than d_s still counts as d_s."""

_WALL_FUZZ_M = 0.25
"""Unknown cells this near to an occupied one are the undecided voxels of its surface."""

_LOOK_SHARE = 0.9
"""Share of the camera's range from which a frontier is sure to be cleared up."""

_SURFACE_SHARE = 0.75
"""Floor and roof count where the camera can see them from this share of its range."""

_MOST_TILES = 2048
"""Tiles along each side of the largest plan, about 3 km: what is further off is left out."""


@dataclass(frozen=True, slots=True)
class Reach:
    """Where the vehicle can be and what its camera sees from there.

    Attributes:
        height_m: H above the ground.
        margin_m: d_s.
        critical_margin_m: d_c: nothing came nearer to it, or it would have stopped.
        half_slab_m: what is this much above or below its centre is in its way.
        max_slope: steepest ground that it follows, rise over run.
        look_m: how far a look says something.
        up_rad: elevation of the upper edge of the image.
        down_rad: depression of the lower edge.
    """

    height_m: float
    margin_m: float
    critical_margin_m: float
    half_slab_m: float
    max_slope: float
    look_m: float
    up_rad: float
    down_rad: float

    @classmethod
    def of(
        cls, settings: MapSettings, camera: Camera, control: ControlSettings, half_slab_m: float, max_slope: float
    ) -> Self:
        """From the configuration of a vehicle and its camera."""
        return cls(
            height_m=control.height_m,
            margin_m=control.margin_m,
            critical_margin_m=control.critical_margin_m,
            half_slab_m=half_slab_m,
            max_slope=max_slope,
            look_m=min(settings.max_range_m, camera.max_range_m),
            up_rad=math.atan((camera.cy_px + 0.5) / camera.fy_px) - camera.mount_pitch_rad,
            down_rad=math.atan((camera.height_px - camera.cy_px - 0.5) / camera.fy_px) + camera.mount_pitch_rad,
        )


@dataclass(frozen=True, slots=True)
class Survey:
    """What one look at the whole map found.

    Attributes:
        free_m2: free area at flight height that hangs together with where the vehicle was.
        reachable_m2: the part of it where the vehicle can be.
        frontiers_m: (n,) length of each frontier, longest first.
        surfaces_seen: cells of floor and roof that were seen, each counted once.
        surfaces_missing: cells of them that were not, though the camera could.
        expected_cells: how many more the frontiers promise.
        occupied: occupied voxels in the whole map.
    """

    free_m2: float
    reachable_m2: float
    frontiers_m: FloatArray
    surfaces_seen: int
    surfaces_missing: int
    expected_cells: float
    occupied: int

    @property
    def seen_share(self) -> float:
        """Share of floor and roof over what is free that was seen; 1 where none can be seen."""
        counted = self.surfaces_seen + self.surfaces_missing
        return self.surfaces_seen / counted if counted else 1.0

    @property
    def completeness(self) -> float:
        """An estimate from 0 to 1: floor and roof seen, over these and what is missing or expected.

        Behind each frontier a drift is expected that is as wide as the frontier and one look long. Of what lies further
        nobody knows, so early in a flight it says too much, and it falls when a junction is found.
        """
        total = self.surfaces_seen + self.surfaces_missing + self.expected_cells
        return self.surfaces_seen / total if total else 0.0


def survey(snapshot: MapSnapshot, flown_m: FloatArray, reach: Reach) -> Survey:
    """Look for frontiers in a whole map.

    Args:
        snapshot: of all chunks.
        flown_m: (n, 3) where the vehicle was; cells that it crossed several times need no more than one place.
        reach: what it can do.
    """
    voxel_m = snapshot.voxel_m
    occupied = int(np.count_nonzero(snapshot.states == OCCUPIED))
    if len(snapshot.chunks) == 0 or len(flown_m) == 0:
        return Survey(0.0, 0.0, np.zeros(0), 0, 0, 0.0, occupied)
    stride = max(1, round(CELL_M / voxel_m))
    edge_m = stride * voxel_m
    shape = Shape(
        voxel_m=voxel_m,
        stride=stride,
        height_m=reach.height_m,
        half_slab_m=reach.half_slab_m,
        up_m=max(_SURFACE_SHARE * reach.look_m * math.tan(reach.up_rad), 0.0),
        down_m=max(_SURFACE_SHARE * reach.look_m * math.tan(reach.down_rad), 0.0),
        max_slope=reach.max_slope,
        same_level_m=reach.height_m / 2.0,
        kept_m=reach.critical_margin_m,
        fuzz_m=max(_WALL_FUZZ_M, edge_m),
    )
    plan, size, flown = _filled(snapshot, shape, flown_m)
    level_m = shape.same_level_m
    kinds = plan.kinds[:size]
    blocked = near_obstacles(plan, size, reach.margin_m / edge_m - _TOLERANCE_CELLS, level_m)
    at_walls = near_obstacles(plan, size, shape.fuzz_m / edge_m + 1e-9, level_m)
    places = reached(plan, size, flown, blocked, level_m)
    look_cells = int(_LOOK_SHARE * reach.look_m / edge_m)
    frontier = seen_from(plan, size, (kinds == UNKNOWN) & ~at_walls, places, look_cells, level_m)
    lengths_m = np.bincount(clusters(plan, size, frontier, level_m))[1:] * edge_m
    frontiers_m = np.sort(lengths_m[lengths_m >= LEAST_FRONTIER_M - 1e-9])[::-1]
    free = kinds == FREE
    surfaces = np.concatenate([plan.roof[:size][free], plan.floor[:size][free]])
    return Survey(
        free_m2=float(np.count_nonzero(free)) * edge_m**2,
        reachable_m2=float(np.count_nonzero(places)) * edge_m**2,
        frontiers_m=frontiers_m,
        surfaces_seen=int(np.count_nonzero(surfaces == SEEN)),
        surfaces_missing=int(np.count_nonzero(surfaces == MISSING)),
        # Floor and roof: two cells for each cell of plan.
        expected_cells=2.0 * float(frontiers_m.sum()) * reach.look_m / edge_m**2,
        occupied=occupied,
    )


class Judge:
    """Says when the map is complete, from one survey after the other.

    Args:
        reach: what the vehicle can do.
    """

    def __init__(self, reach: Reach) -> None:
        self._reach = reach
        self._most_seen = 0
        self._news_s = -math.inf

    def complete(self, found: Survey, t_s: float) -> bool:
        """Whether the map is complete now. It may say no again later: a new opening is news.

        Args:
            found: the newest survey.
            t_s: time of the newest frame in it, in s.
        """
        if found.surfaces_seen > self._most_seen * (1.0 + NEWS_SHARE):
            self._most_seen, self._news_s = found.surfaces_seen, t_s
        # Who has not even seen the room to turn in has seen nothing.
        if found.free_m2 < math.pi * self._reach.margin_m**2:
            return False
        if len(found.frontiers_m) == 0 and found.seen_share >= ENOUGH_SEEN:
            return True
        openings = found.frontiers_m >= 2.0 * self._reach.critical_margin_m
        settled = t_s - self._news_s >= SETTLED_S and found.seen_share >= SETTLED_SEEN
        return settled and not bool(openings.any())


def _sorted(snapshot: MapSnapshot) -> Voxels:
    keys = packed(snapshot.chunks)
    order = np.argsort(keys)
    return Voxels(keys[order], snapshot.states[order])


def _filled(snapshot: MapSnapshot, shape: Shape, flown_m: FloatArray) -> tuple[Plan, int, int]:
    """The plan, how many nodes it has, and how many of these were flown through."""
    voxels = _sorted(snapshot)
    tiles, low = _tiles(snapshot.chunks, shape.stride, flown_m, shape.stride * shape.voxel_m)
    count = int(tiles.max()) + 1
    capacity = TILE**2 * count
    while True:
        plan = Plan(
            tiles=tiles,
            low=low,
            heads=np.full((count, TILE**2), -1, np.int32),
            nexts=np.empty(capacity, np.int32),
            cells=np.empty((capacity, 2), np.int32),
            heights_m=np.empty(capacity, np.float64),
            kinds=np.empty(capacity, np.uint8),
            roof=np.empty(capacity, np.uint8),
            floor=np.empty(capacity, np.uint8),
        )
        size, flown = flood(voxels, plan, shape, flown_m)
        if size >= 0:
            return plan, size, flown
        # Several levels above each other.
        capacity *= 2


def _tiles(
    chunks: NDArray[np.int32], stride: int, flown_m: FloatArray, edge_m: float
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Numbers of the tiles over the map and around it, and the corner from which they are counted."""
    centre = np.floor(np.median(flown_m[:, :2], axis=0) / (TILE * edge_m)).astype(np.int64)
    # A chunk has 16 voxels along each side and a tile 16 cells, so a tile is as many chunks wide as a cell is voxels.
    used = np.unique(chunks[:, :2].astype(np.int64) // stride, axis=0)
    used = used[np.all(np.abs(used - centre) < _MOST_TILES // 2 - 1, axis=1)]
    around = (used[:, np.newaxis, :] + _AROUND).reshape(-1, 2)
    if len(around) == 0:
        around = centre[np.newaxis, :]
    low = around.min(axis=0)
    tiles = np.full(tuple(around.max(axis=0) - low + 1), -1, np.int32)
    tiles[tuple((around - low).T)] = 0
    tiles[tiles == 0] = np.arange(np.count_nonzero(tiles == 0), dtype=np.int32)
    return tiles, low


_AROUND = np.array([[a, b] for a in (-1, 0, 1) for b in (-1, 0, 1)])
