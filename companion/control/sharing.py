"""What vehicles tell each other of the mine, so that they choose different ways: known ground, and claims. Pure.

Ground is told by tiles, each as it is now: told twice, late or out of order it does no harm. What another one has seen
counts where the own eyes know nothing, so that it attracts nobody any more. A claim says which unseen place a vehicle
is on its way to, and how far it still has: others look for another one. Like all that the known ground decides, this
costs time where it is wrong, never safety.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.control.decisions import Choice
from companion.control.ground_grid import GroundGrid
from companion.control.known_ground import KnownGround, Place, Window
from companion.model import ABSURD, Pose

TILE_CELLS = 32
"""Side of a tile: 16 m with the largest cells."""

MOST_TILES = 8
"""So many tiles a message tells, those that have changed first: some kB."""

CLAIM_LASTS_S = 15.0
"""A claim that has not been renewed for so long binds nobody any more."""

MOST_CLAIMS = 32
"""Of so many others claims are kept."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Where a vehicle's own frame lies in the shared one: its origin, and by how much it is turned to the left."""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    yaw_rad: float = 0.0

    def shared(self, x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
        """A point of the vehicle's frame in the shared one."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return self.x_m + cos * x_m - sin * y_m, self.y_m + sin * x_m + cos * y_m, self.z_m + z_m

    def own(self, x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
        """A point of the shared frame in the vehicle's."""
        cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        east_m, north_m = x_m - self.x_m, y_m - self.y_m
        return cos * east_m + sin * north_m, cos * north_m - sin * east_m, z_m - self.z_m


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """A square of a vehicle's known ground, as it is now.

    Attributes:
        row: of the tile, in tiles from where the vehicle's grid began; so is the next.
        column: see ``row``.
        cells: (levels, `TILE_CELLS`, `TILE_CELLS`) uint8 what is known.
        ground_dm: (levels, `TILE_CELLS`, `TILE_CELLS`) int16 height of the ground there, in the vehicle's frame.
    """

    row: int
    column: int
    cells: NDArray[np.uint8]
    ground_dm: NDArray[np.int16]

    @property
    def place(self) -> tuple[int, int]:
        """Row and column."""
        return self.row, self.column


@dataclass(frozen=True, slots=True)
class GroundNews:
    """Some tiles of a vehicle's known ground.

    Attributes:
        frame: of the vehicle.
        cell_m: side of its cells.
        x_m: low corner of tile (0, 0), in its frame; so is the next.
        y_m: see ``x_m``.
        tiles: those that are told.
    """

    frame: Frame
    cell_m: float
    x_m: float
    y_m: float
    tiles: tuple[Tile, ...]


@dataclass(frozen=True, slots=True)
class Claim:
    """The unseen place that a vehicle is on its way to, in the shared frame, and how far it has to go."""

    x_m: float
    y_m: float
    ground_m: float
    length_m: float

    @property
    def is_finite(self) -> bool:
        """Whether every number of it is one."""
        return all(abs(number) < ABSURD for number in (self.x_m, self.y_m, self.ground_m, self.length_m))


class Sharing:
    """What one vehicle tells the others, and what it makes of what they tell.

    Args:
        own_id: its number.
        frame: where its own frame lies in the shared one.
        ground: what it knows.
        choice: which way it takes.
    """

    def __init__(self, own_id: int, frame: Frame, ground: KnownGround, choice: Choice) -> None:
        self._own_id = own_id
        self._frame = frame
        self._ground = ground
        self._choice = choice
        self._corner: tuple[float, float] | None = None
        self._told: dict[tuple[int, int], bytes] = {}
        self._claims: dict[int, tuple[float, Claim]] = {}
        self.newest_claim: Claim | None = None
        """What was last claimed; None: nothing."""

    def news(self) -> GroundNews | None:
        """The tiles that have changed since they were last told, and in turn one that has not; None: nothing is known.

        With the one that has not, whoever was out of reach, or comes later, is told everything in the end.
        """
        seen = self._ground.seen()
        if seen.grid.cells.size == 0:
            return None
        if self._corner is None:
            self._corner = seen.x_m, seen.y_m
        found = {tile.place: (tile, _digest(tile)) for tile in _tiles(seen, self._corner)}
        changed = [place for place, (_, digest) in found.items() if self._told.get(place) != digest][:MOST_TILES]
        # Those told longest ago come first: a dictionary keeps the order in which its keys came.
        again = [place for place in self._told if place in found and place not in changed][:1]
        for place in (*changed, *again):
            self._told.pop(place, None)
            self._told[place] = found[place][1]
        tiles = tuple(found[place][0] for place in (*changed, *again))
        return GroundNews(self._frame, seen.cell_m, *self._corner, tiles)

    def learn(self, news: GroundNews) -> None:
        """Know what another vehicle has seen; what makes no sense is ignored."""
        numbers = (news.cell_m, news.x_m, news.y_m, news.frame.x_m, news.frame.y_m, news.frame.z_m, news.frame.yaw_rad)
        if not all(abs(number) < ABSURD for number in numbers) or not news.cell_m > 0.0:
            return
        turn_rad = self._frame.yaw_rad - news.frame.yaw_rad
        x_m, y_m, z_m = news.frame.own(*self._frame.shared(0.0, 0.0, 0.0))
        for tile in news.tiles:
            low_x_m = news.x_m + tile.column * TILE_CELLS * news.cell_m
            low_y_m = news.y_m + tile.row * TILE_CELLS * news.cell_m
            theirs = Window(
                GroundGrid(tile.cells, tile.ground_dm, np.zeros_like(tile.cells, np.int8)),
                np.empty((0, 3), np.int64),
                *(low_x_m, low_y_m, news.cell_m),
            )
            self._ground.learn(theirs, (x_m, y_m, z_m), turn_rad)

    def claim(self, pose: Pose) -> Claim | None:
        """What this vehicle is on its way to, for the others; None where it knows of nothing."""
        way = self._choice.nearest_unseen(pose)
        self.newest_claim = None
        if way is not None:
            goal_m = self._frame.shared(way.goal.x_m, way.goal.y_m, way.goal.ground_m)
            self.newest_claim = Claim(*goal_m, way.length_m)
        return self.newest_claim

    def on_claim(self, vehicle_id: int, claim: Claim | None, t_s: float) -> None:
        """Note what another vehicle is on its way to; None: nothing."""
        if claim is None or not claim.is_finite:
            self._claims.pop(vehicle_id, None)
        elif vehicle_id in self._claims or len(self._claims) < MOST_CLAIMS:
            self._claims[vehicle_id] = t_s, claim

    def look(self, t_s: float) -> None:
        """Let the choice know of the claims that bind now."""
        self._claims = {one: known for one, known in self._claims.items() if t_s - known[0] <= CLAIM_LASTS_S}
        self._choice.claimed = tuple(
            (Place(*self._frame.own(claim.x_m, claim.y_m, claim.ground_m)), claim.length_m, vehicle_id < self._own_id)
            for vehicle_id, (_, claim) in self._claims.items()
        )


def _tiles(seen: Window, corner_m: tuple[float, float]) -> Iterator[Tile]:
    """All tiles in which anything is known."""
    levels, rows, columns = seen.grid.cells.shape
    off_row, off_column = (
        round((low_m - from_m) / seen.cell_m) for low_m, from_m in ((seen.y_m, corner_m[1]), (seen.x_m, corner_m[0]))
    )
    for row in range(off_row // TILE_CELLS, (off_row + rows - 1) // TILE_CELLS + 1):
        for column in range(off_column // TILE_CELLS, (off_column + columns - 1) // TILE_CELLS + 1):
            low, left = row * TILE_CELLS - off_row, column * TILE_CELLS - off_column
            from_row, from_column = max(low, 0), max(left, 0)
            part = seen.grid.part(
                slice(from_row, min(low + TILE_CELLS, rows)), slice(from_column, min(left + TILE_CELLS, columns))
            )
            if not part.cells.any():
                continue
            whole = GroundGrid.unseen(TILE_CELLS, TILE_CELLS, levels)
            _, height, width = part.cells.shape
            at_row, at_column = from_row - low, from_column - left
            inside = whole.part(slice(at_row, at_row + height), slice(at_column, at_column + width))
            inside.cells[:], inside.ground_dm[:] = part.cells, part.ground_dm
            yield Tile(row, column, whole.cells, whole.ground_dm)


def _digest(tile: Tile) -> bytes:
    return hashlib.blake2b(tile.cells.tobytes() + tile.ground_dm.tobytes(), digest_size=8).digest()
