"""What a map is held against: the surface that can be seen from where a vehicle can fly (paper Definition 2.3)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.errors import InputError
from sitl.mines.model import World
from sitl.scene.raycast import RayCaster
from sitl.scene.surface import Array, Points, Surroundings, grouped, surface_samples, triangle_areas

EVERYWHERE = (-math.pi / 2.0, math.pi / 2.0)
"""From straight down to straight up."""

_STEP_M = 0.5
_LEAST_ROOF_M = 0.3
_FAN = 36
_NEXT = np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
_DOWN, _UP = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])

MAX_SLOPE = 0.7
"""Steepest ground that S follows, rise over run."""

_STEP_RUN_M = 1.0
"""A step counts as flown over when it is no higher than the steepest slope of this length: 0.7 m. Less than what the
presets' vehicle flies over, H less half of its slab (`companion.perception.ground_below`)."""

_ROUGH_M = 0.01
"""Floors are rough: so much a step may be higher."""

MOST_STEP_M = MAX_SLOPE * _STEP_RUN_M + _ROUGH_M
"""A step between neighbours of S is no higher."""

SAME_LEVEL_M = 0.5
"""Two places over one cell that are nearer than this in height are the same place."""


_STOP_M = 0.02
"""A look ends this far before the sample, which lies on the very surface that would stop it."""

_NEAREST, _FIRST_LOOKS, _LOOKS = 8, 24, 96
"""From how many points of S a sample is looked at: the nearest ones, then so many, out to the camera's range, before a
whole group is given up, and so many in all."""

_GROUP_M = 1.0
"""Samples this close together are looked at from the same points."""

_BATCH = 8192

MOST_PLACES = 2_000_000
"""No more points of S are sought: 30 km of drifts on a grid of 0.25 m, which take 1 GB and a minute."""

Say = Callable[[str], None]
"""Takes what is being done, for people who wait."""


def silent(_text: str) -> None:
    """Tells nobody."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The part of a world's surface that a perfect flight would map.

    Attributes:
        samples_m: (n, 3) float32, one point of the visible surface for each voxel that holds some.
        sample_areas_m2: (n,) float32, how much surface each stands for.
        area_share_visible: visible over total surface; the rest is out of reach or hidden for ever.
        traveling_surface_m: (k, 3) points of S, on a square grid.
        reach_m2: area of S that a vehicle with the given margin can reach.
    """

    samples_m: Points
    sample_areas_m2: Points
    area_share_visible: float
    traveling_surface_m: Array
    reach_m2: float

    @classmethod
    def of(
        cls,
        world: World,
        caster: RayCaster,
        start_xyz: tuple[float, float, float],
        height_m: float,
        margin_m: float,
        voxel_m: float,
        max_range_m: float,
        step_m: float = _STEP_M,
        start_margin_m: float | None = None,
        elevations_rad: tuple[float, float] = EVERYWHERE,
        say: Say = silent,
    ) -> Truth:
        """The truth for a vehicle that starts at ``start_xyz`` and flies ``height_m`` above ground.

        Args:
            world: the world.
            caster: casts rays in that world.
            start_xyz: x, y, z in m.
            height_m: H, the height of the traveling surface above ground.
            margin_m: d_s, the horizontal distance that is kept from everything.
            voxel_m: side of the voxels of the map that will be compared with this.
            max_range_m: how far the camera sees.
            step_m: side of the grid on which S is sought. It finds passages that are wider than twice ``margin_m`` by
                1.5 steps, whatever their direction.
            start_margin_m: the margin at the start itself, if the start lies nearer to a wall.
            elevations_rad: the lowest and the highest direction in which the camera sees.
            say: hears how far this is.

        Raises:
            InputError: the start is not part of S: too near to a wall or to the roof, or not above a floor; or S or
                what is seen from it is larger than any mine's.
        """
        surface = traveling_surface(
            caster, start_xyz, height_m, margin_m, step_m=step_m, start_margin_m=start_margin_m, say=say
        )
        if len(surface) == 0:
            raise InputError(
                f"start {world.named(*start_xyz)} in world {world.name}: a vehicle {height_m:.2f} m above the floor "
                f"there has not {margin_m if start_margin_m is None else start_margin_m:.2f} m of room to every side"
            )
        say("looking at what can be seen from there")
        samples, areas = surface_samples(world, voxel_m, Surroundings.of(surface, max_range_m))
        seen = visible_samples(caster, samples, surface, max_range_m, elevations_rad)
        share = float(areas[seen].sum(dtype=np.float64) / triangle_areas(world).sum())
        return cls(samples[seen], areas[seen], share, surface, len(surface) * step_m**2)


def traveling_surface(
    caster: RayCaster,
    start_xyz: tuple[float, float, float],
    height_m: float,
    margin_m: float,
    step_m: float = _STEP_M,
    max_slope: float = MAX_SLOPE,
    start_margin_m: float | None = None,
    say: Say = silent,
) -> Array:
    """The points of the traveling surface S (paper Definition 3.1) that can be reached from a start.

    A flood fill, wave by wave, over a horizontal square grid through the start. A neighbour belongs to S if the way to
    it is free, its ground is not steeper than ``max_slope`` or only for a step that is flown over, nothing is
    horizontally nearer to it than ``margin_m``, and the roof is not right above it. Places above each other stay apart.

    Args:
        caster: casts rays in the world.
        start_xyz: x, y, z in m, somewhere above the floor.
        height_m: H, height above ground.
        margin_m: d_s, least horizontal distance to anything, at that height.
        step_m: side of the grid.
        max_slope: greatest rise over run of the ground between neighbours.
        start_margin_m: the same as ``margin_m`` for the start itself, which may lie nearer to a wall.
        say: hears how much was found.

    Returns:
        (k, 3) in m, the start's own point first; k = 0 if the start is not part of S.

    Raises:
        InputError: more than `MOST_PLACES`.
    """
    origin = np.asarray(start_xyz, dtype=np.float64)
    needed_m = margin_m if start_margin_m is None else start_margin_m
    if not has_room_above_ground(caster, origin[None], height_m, needed_m):
        return np.empty((0, 3))
    wave = _above_ground(caster, origin[None], height_m)

    cells = np.zeros((1, 2), dtype=np.int64)
    looked_at = _Levels()
    looked_at.add(cells, wave[:, 2])
    found, places = [wave], 1
    while len(wave) > 0:
        parents = np.repeat(wave, 4, axis=0)
        cells = (cells[:, None] + _NEXT).reshape(-1, 2)
        there = np.column_stack([origin[:2] + cells * step_m, parents[:, 2]])
        free = ~caster.blocked(parents, there)
        there[:, 2] += height_m - caster.cast(there, _DOWN)
        steep = free & (np.abs(there[:, 2] - parents[:, 2]) > max_slope * step_m)
        free &= ~steep
        free[steep] = _is_flown_over(caster, parents[steep], there[steep], height_m, max_slope)
        cells, parents, there = cells[free], parents[free], there[free]
        free = ~caster.blocked(parents, there)
        cells, there = cells[free], there[free]
        fresh = looked_at.add(cells, there[:, 2])
        cells, there = cells[fresh], there[fresh]
        room = _has_room(caster, there, margin_m)
        cells, wave = cells[room], there[room]
        found.append(wave)
        places += len(wave)
        say(f"looking for where it can fly: {places * step_m**2:,.0f} m² so far")
        if places > MOST_PLACES:
            raise InputError(
                f"more than {places * step_m**2:.0f} m² of floor can be reached from the start, more than any mine "
                "has: cut out a part of the mesh, or close it; if its unit is not the metre, give --scale (0.01 for "
                "centimetres)"
            )
    return np.concatenate(found)


def _is_flown_over(
    caster: RayCaster, here: Array, there: Array, height_m: float, max_slope: float
) -> NDArray[np.bool_]:
    """Whether the ground between neighbours (n, 3) rises or falls in a step, and not further on as well.

    A metre before and a metre behind it is no further from the one and the other than a slope would be.
    """
    rise_m = max_slope * _STEP_RUN_M + _ROUGH_M
    good = np.abs(there[:, 2] - here[:, 2]) <= rise_m
    along = there[:, :2] - here[:, :2]
    along *= _STEP_RUN_M / np.hypot(along[:, 0], along[:, 1])[:, None]
    top_m = np.maximum(here[:, 2], there[:, 2])
    for place, other, sign in ((here, there, 1.0), (there, here, -1.0)):
        begin = np.column_stack([other[:, :2], top_m])
        beyond = np.column_stack([place[:, :2] + sign * along, top_m])
        ground = _above_ground(caster, beyond, height_m)
        good &= ~caster.blocked(begin, beyond) & (np.abs(ground[:, 2] - place[:, 2]) <= rise_m)
    return np.asarray(good)


def has_room_above_ground(caster: RayCaster, places: Array, height_m: float, margin_m: float) -> NDArray[np.bool_]:
    """Whether S, at ``height_m`` above ground, can begin at each of ``places`` (n, 3).

    There must be ground below, a free way to that height, nothing horizontally nearer than ``margin_m`` there, and a
    roof that is not right above it.
    """
    there = _above_ground(caster, places, height_m)
    good = np.isfinite(there[:, 2])
    some, there = places[good], there[good]
    good[good] = ~caster.blocked(some, there) & _has_room(caster, there, margin_m)
    return np.asarray(good)


def _above_ground(caster: RayCaster, places: Array, height_m: float) -> Array:
    """(n, 3) the points ``height_m`` above the ground below ``places`` (n, 3); -inf where there is none."""
    ground_m = places[:, 2] - caster.cast(places, _DOWN)
    return np.column_stack([places[:, :2], ground_m + height_m])


class _Levels:
    """Which places of a grid have been looked at: for each cell the heights."""

    def __init__(self) -> None:
        self._heights_m: dict[tuple[int, int], list[float]] = {}

    def add(self, cells: NDArray[np.int64], heights_m: Array) -> NDArray[np.bool_]:
        """Adds places, and says of each (n,) whether it is new."""
        fresh = np.zeros(len(cells), dtype=bool)
        for k, (x, y, height_m) in enumerate(zip(*cells.T.tolist(), heights_m.tolist(), strict=True)):
            known = self._heights_m.setdefault((x, y), [])
            fresh[k] = all(abs(height_m - other) > SAME_LEVEL_M for other in known)
            if fresh[k]:
                known.append(height_m)
        return fresh


def _has_room(caster: RayCaster, points: Array, margin_m: float) -> NDArray[np.bool_]:
    """Whether nothing is horizontally nearer than ``margin_m`` to each point, and the roof not right above it."""
    roof_m = caster.cast(points, _UP)
    around_m = _fan_ranges(caster, points, _FAN).min(axis=1)
    return np.asarray((around_m >= margin_m) & (roof_m > _LEAST_ROOF_M))


def _fan_ranges(caster: RayCaster, points: Array, bearings: int) -> Points:
    """(n, bearings) horizontal ranges in m around points (n, 3)."""
    angles = np.arange(bearings) * (2.0 * np.pi / bearings)
    fan = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(bearings)])
    return caster.cast(np.repeat(points, bearings, axis=0), np.tile(fan, (len(points), 1))).reshape(-1, bearings)


def horizontal_clearance(caster: RayCaster, points: Array, half_height_m: float, bearings: int = 72) -> Points:
    """The true least horizontal distance of a body to anything: what a flight is scored by.

    Args:
        caster: casts rays in the world.
        points: (n, 3) where the body's middle is, in m.
        half_height_m: the body reaches this far up and down; a floor or a roof that is nearer cuts it short.
        bearings: how many directions are measured, at the body's top, middle and bottom.

    Returns:
        (n,) in m.
    """
    clearances = []
    for begin in range(0, len(points), _BATCH):
        middle = np.asarray(points[begin : begin + _BATCH], dtype=np.float64)
        least = _fan_ranges(caster, middle, bearings).min(axis=1)
        for way in (_DOWN, _UP):
            reach_m = np.minimum(half_height_m, caster.cast(middle, way) - _STOP_M)
            rim = middle + way * np.maximum(reach_m, 0.0)[:, None]
            least = np.minimum(least, _fan_ranges(caster, rim, bearings).min(axis=1))
        clearances.append(least)
    return np.concatenate(clearances) if clearances else np.empty(0, dtype=np.float32)


def visible_samples(
    caster: RayCaster,
    samples: Points,
    surface_points: Array,
    max_range_m: float,
    elevations_rad: tuple[float, float] = EVERYWHERE,
) -> NDArray[np.bool_]:
    """Which samples can be seen from the traveling surface, turning all round and looking out to ``max_range_m``.

    Args:
        caster: casts rays in the world.
        samples: (n, 3) points on the world's surface.
        surface_points: (k, 3) points of S.
        max_range_m: how far the camera sees.
        elevations_rad: the lowest and the highest direction in which it sees, of a vehicle that hovers level.

    Returns:
        (n,) bool. Each sample is looked at from some points of S only; at most 2 in 1000 visible ones are lost by that.
    """
    visible = np.zeros(len(samples), dtype=bool)
    if len(samples) == 0 or len(surface_points) == 0:
        return visible
    order, starts = grouped(np.floor(samples / _GROUP_M).astype(np.int64))
    group = np.empty(len(samples), dtype=np.int64)
    group[order] = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(order)))
    centres = (np.floor(samples[order[starts]] / _GROUP_M) + 0.5) * _GROUP_M
    viewpoints = _viewpoints(centres, surface_points, max_range_m + _GROUP_M)

    hidden = np.arange(len(samples))
    for look in range(_LOOKS):
        tried = hidden[viewpoints[group[hidden], look] >= 0]
        source = viewpoints[group[tried], look]
        ways = samples[tried] - surface_points[source]
        lengths_m = np.linalg.norm(ways, axis=1)
        rises = ways[:, 2] / np.maximum(lengths_m, 1e-9)
        in_view = (rises >= math.sin(elevations_rad[0])) & (rises <= math.sin(elevations_rad[1]))
        near = (lengths_m <= max_range_m) & in_view
        tried, source = tried[near], source[near]
        ends = samples[tried] - ways[near] * np.minimum(_STOP_M / lengths_m[near], 1.0)[:, None]
        visible[tried[~caster.blocked(surface_points[source], ends)]] = True
        hidden = hidden[~visible[hidden]]
        if look + 1 == _FIRST_LOOKS:  # where nothing was seen from so many points, there is rock between: do not go on
            hopeful = np.zeros(len(starts), dtype=bool)
            hopeful[group[visible]] = True
            hidden = hidden[hopeful[group[hidden]]]
    return visible


def _viewpoints(centres: Array, surface_points: Array, range_m: float) -> NDArray[np.int64]:
    """For each centre (g, 3) the points of S within range that are tried: the nearest, then evenly by distance.

    Returns:
        (g, `_LOOKS`) indices into ``surface_points`` in the order of trying, so that any number of the first ones is
        spread over all distances; -1 where there is none.
    """
    further = _NEAREST + np.argsort(np.arange(_LOOKS - _NEAREST) * 0.6180339887498949 % 1.0)
    trying = np.concatenate([np.arange(_NEAREST), further])
    chosen = np.full((len(centres), _LOOKS), -1)
    blocks = np.floor(centres / range_m).astype(np.int64)
    order, starts = grouped(blocks)
    for members in np.split(order, starts[1:]):
        corner = blocks[members[0]] * range_m
        near = np.flatnonzero(np.all(np.abs(surface_points - corner - range_m / 2) <= 1.5 * range_m, axis=1))
        if len(near) == 0:
            continue
        distances = np.linalg.norm(centres[members, None] - surface_points[near], axis=2)
        by_distance = np.argsort(distances, axis=1, kind="stable")
        count = np.sum(distances <= range_m, axis=1)[:, None]
        rank = np.arange(_LOOKS)[None]
        spread = _NEAREST + (rank - _NEAREST) * (count - _NEAREST) // (_LOOKS - _NEAREST)
        rank = np.where((rank < _NEAREST) | (count <= _LOOKS), rank, spread)
        picked = near[np.take_along_axis(by_distance, np.minimum(rank, len(near) - 1), axis=1)]
        chosen[members] = np.where(rank < count, picked, -1)[:, trying]
    return chosen


def precision(distances_m: NDArray[np.floating], voxel_m: float) -> float:
    """The share of occupied voxels within one voxel of the true surface; NaN when there are none.

    Args:
        distances_m: (n,) distance of each occupied voxel's centre to the true surface, never negative.
        voxel_m: edge of a voxel.
    """
    return float(np.mean(distances_m <= voxel_m)) if len(distances_m) else float("nan")


def accuracy_m(distances_m: NDArray[np.floating]) -> float:
    """The mean of ``distances_m`` (n,), from occupied voxels' centres to the true surface; NaN when there are none."""
    return float(np.mean(distances_m)) if len(distances_m) else float("nan")
