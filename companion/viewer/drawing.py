"""A tiled map in a scene of viser: what has changed is sent, tile by tile, and nothing else."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import viser
from numpy.typing import NDArray

from companion.mapping.files.clouds import viridis
from companion.viewer.tiles import COARSEST, Shown, Tile, TileCloud, TiledMap, finest
from companion.viewer.voxels import PackedVoxels, State

Rgb = tuple[int, int, int]

STATE_COLOURS: dict[State, Rgb] = {
    State.OCCUPIED: (96, 104, 112),
    State.FREE: (110, 170, 214),
    State.UNDECIDED: (230, 159, 0),
}
_FREE_SIZE = 0.3
"""Free voxels are drawn this much smaller than they are, or one would see nothing but the nearest."""

_WALL_LIGHT = 0.72
"""How bright walls are beside the ground: without light from somewhere, depth cannot be seen."""

_ROUND_M = 0.5
"""The colours of heights go from one multiple of this to another, so that they seldom change while a map grows."""

_SPARE = 0.15
"""Of the height of a map that grows, so much is added where it leaves the range of the colours."""


@dataclass(frozen=True, slots=True)
class Style:
    """How a map is drawn.

    Attributes:
        shown: which part of it.
        states: which voxels.
        by_height: whether occupied voxels are coloured by height, or all alike.
        most_points: cubes become coarser where there are more.
    """

    shown: Shown = field(default_factory=Shown)
    states: frozenset[State] = frozenset({State.OCCUPIED})
    by_height: bool = True
    most_points: int = 1_000_000


@dataclass(slots=True)
class HeightRange:
    """The heights between the darkest and the brightest colour; maps that are drawn together share one."""

    low_m: float = math.inf
    high_m: float = -math.inf

    def cover(self, low_m: float, high_m: float) -> bool:
        """Grow to have these heights in it; returns whether it had to."""
        if self.low_m <= low_m and high_m <= self.high_m:
            return False
        first = self.low_m > self.high_m
        low_m, high_m = min(low_m, self.low_m), max(high_m, self.high_m)
        spare_m = 0.0 if first else _SPARE * (high_m - low_m)
        if low_m < self.low_m:
            self.low_m = math.floor((low_m - spare_m) / _ROUND_M) * _ROUND_M
        if high_m > self.high_m:
            self.high_m = math.ceil((high_m + spare_m) / _ROUND_M) * _ROUND_M
        return True


class MapDrawing:
    """One map in the scene.

    Everything is for one thread at a time.

    Args:
        server: viser's.
        root: name of the node that it hangs on.
        voxel_m: edge of a voxel.
        heights: of the colours.
    """

    def __init__(self, server: viser.ViserServer, root: str, voxel_m: float, heights: HeightRange) -> None:
        self.map = TiledMap(voxel_m)
        self.root = root
        self._server = server
        self._heights = heights
        self._style = Style()
        self._levels = dict.fromkeys(State, (0, 1))
        self._waiting: dict[Tile, None] = {}
        self._nodes: dict[tuple[Tile, State], viser.PointCloudHandle] = {}

    @property
    def points(self) -> int:
        """How many are drawn now."""
        return sum(len(node.points) for node in self._nodes.values())

    @property
    def waiting(self) -> int:
        """Tiles that are not drawn as they should be yet."""
        return len(self._waiting)

    def edge_m(self, state: State) -> float:
        """Edge of the cubes that stand for voxels of a state."""
        return self.map.voxel_m * (1 << self._levels[state][0])

    def put(self, voxels: PackedVoxels) -> None:
        """Take chunks in place of what it had of them; `draw` shows it."""
        self._waiting.update(dict.fromkeys(self.map.put(voxels)))

    def restyle(self, style: Style, levels: dict[State, tuple[int, int]] | None = None) -> None:
        """Show the map otherwise from the next `draw` on.

        Args:
            style: how.
            levels: by state the level of the cubes and every how many chunks are shown, where maps share a limit;
                None: as this map alone needs it.
        """
        levels = levels_of([self.map], style.most_points) if levels is None else levels
        if style != self._style or levels != self._levels:
            self._style, self._levels = style, levels
            self._waiting.update(dict.fromkeys(self.map.tiles))

    def repaint(self) -> None:
        """The colours have changed: draw all tiles again."""
        self._waiting.update(dict.fromkeys(self.map.tiles))

    def draw(self, budget_s: float = math.inf, now_s: Callable[[], float] = time.perf_counter) -> bool:
        """Send tiles that have changed, oldest first, until the time is up.

        Returns:
            Whether the heights of the map have left the range of the colours: all maps that share it need `repaint`.
        """
        end_s = now_s() + budget_s
        outgrown = False
        while self._waiting and now_s() < end_s:
            tile = next(iter(self._waiting))
            del self._waiting[tile]
            for state in State:
                outgrown |= self._draw_tile(tile, state)
        return outgrown

    def remove(self) -> None:
        """Take it from the scene."""
        for node in self._nodes.values():
            node.remove()
        self._nodes.clear()
        self._waiting.clear()

    def seen_from(self, origin_m: NDArray[np.float64], towards: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """The nearest cube that is drawn along a ray.

        Args:
            origin_m: (3,) where the eye is.
            towards: (3,) a unit vector.

        Returns:
            (3,) the centre of the cube; None where there is none.
        """
        best_m, found = math.inf, None
        for (tile, state), node in self._nodes.items():
            edge_m = self.edge_m(state)
            corner_m = np.array(self.map.corner_m(tile))
            places = corner_m + node.points.astype(np.float64) * edge_m - origin_m
            along_m = places @ towards
            off_m = np.linalg.norm(places - along_m[:, None] * towards, axis=1)
            hit = (off_m <= 0.87 * edge_m) & (along_m > 0.0)
            if hit.any():
                nearest = int(np.argmin(np.where(hit, along_m, math.inf)))
                if along_m[nearest] < best_m:
                    best_m, found = float(along_m[nearest]), places[nearest] + origin_m
        return found

    def _draw_tile(self, tile: Tile, state: State) -> bool:
        level, every = self._levels[state]
        node = self._nodes.get((tile, state))
        cloud = self.map.cloud(tile, state, self._style.shown, level, every) if state in self._style.states else None
        if cloud is None or not len(cloud.cubes):
            if node is not None:
                node.remove()
                del self._nodes[tile, state]
            return False
        outgrown = self._heights.cover(float(cloud.heights_m.min()), float(cloud.heights_m.max()))
        # Halves of whole numbers are exact in float16: half the bytes, and no voxel is off its place.
        self._nodes[tile, state] = self._server.scene.add_point_cloud(
            f"{self.root}/{state.name.lower()}/{'_'.join(map(str, tile))}",
            cloud.cubes.astype(np.float16) + np.float16(0.5),
            self._colours(cloud, state),
            point_size=_FREE_SIZE if state is State.FREE else 1.0,
            point_shape="square",
            point_shading="flat",
            precision="float16",
            scale=self.edge_m(state),
            position=self.map.corner_m(tile),
        )
        return outgrown

    def _colours(self, cloud: TileCloud, state: State) -> NDArray[np.uint8] | Rgb:
        if state is not State.OCCUPIED:
            return STATE_COLOURS[state]
        if self._style.by_height:
            low_m, high_m = self._heights.low_m, self._heights.high_m
            colours = viridis((cloud.heights_m.astype(np.float64) - low_m) / max(high_m - low_m, 1e-6))
        else:
            colours = np.broadcast_to(np.array(STATE_COLOURS[state], np.uint8), (len(cloud.cubes), 3))
        light = np.where(cloud.ground, 1.0, _WALL_LIGHT)
        return np.asarray((colours * light[:, None]).astype(np.uint8))


def levels_of(maps: Sequence[TiledMap], most_points: int) -> dict[State, tuple[int, int]]:
    """By state how coarse the cubes of these maps have to be for there not to be more than so many in all of them."""
    counts = sum((one.counts() for one in maps), np.zeros((len(State), COARSEST + 1), np.int64))
    chunks = sum(one.chunks for one in maps)
    return {state: finest(counts[state], chunks, most_points) for state in State}
