"""What is left to explore (METHOD Definition 2.3).

In flight there is no truth: the map has no more to say when no frontier, known free space next to unknown, is left that
the vehicle could reach or look at while it keeps d_s from everything. This is decided on a plan at flight height, which
follows the ground, over the slab that counts as obstacle: a camera that looks forward with 57° from floor to roof sees
them near the walls only from metres back, so a frontier of voxels would have specks there nearly always. Floor and roof
are counted instead: of every free cell it is asked whether the surface below and above was seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Self

from companion.config.control import ControlSettings
from companion.config.mapping import MapSettings
from companion.control.completion import MapWord
from companion.model import Camera, FloatArray

LEAST_FRONTIER_M = 0.5
"""A shorter frontier is ignored. Depth noise and missing pixels leave specks of a few voxels, and what hides behind
half a metre is too small for a vehicle that needs 2 d_c to pass."""

MOST_FRONTIERS = 64
"""So many frontiers are reported one by one."""


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


class Access(Enum):
    """How a frontier can be come by."""

    REACHABLE = "reachable"
    """The vehicle can get to it and keep d_s from everything."""

    IN_SIGHT = "in sight"
    """It is too narrow there for d_s, but it can be looked at from where there is room."""

    TOO_NARROW = "too narrow"
    """The only ways there are too narrow for d_s, and it is in sight from nowhere else: it does not count."""


@dataclass(frozen=True, slots=True)
class Frontier:
    """One frontier: known free space at flight height next to unknown.

    Attributes:
        access: how it can be come by.
        length_m: how long it is.
        x_m: where its middle is.
        y_m: the same along y.
        z_m: mean flight height on it.
        low_m: (x, y) least coordinates of its cells.
        high_m: (x, y) largest.
        bearing_rad: direction from what is free to what is unknown, counterclockwise from x.
        path_m: length of the way to it from where the vehicle is, as exact as a tile of 1.6 m is wide; infinite when
            none is known.
        cells: cells of the plan that it has.
    """

    access: Access
    length_m: float
    x_m: float
    y_m: float
    z_m: float
    low_m: tuple[float, float]
    high_m: tuple[float, float]
    bearing_rad: float
    path_m: float
    cells: int


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
        frontiers: the frontiers one by one, those that count first, near ones before far ones; not more than
            `MOST_FRONTIERS`.
        cut_short: the mine is larger than what can be surveyed: the rest was left out.
    """

    free_m2: float
    reachable_m2: float
    frontiers_m: FloatArray
    surfaces_seen: int
    surfaces_missing: int
    expected_cells: float
    occupied: int
    frontiers: tuple[Frontier, ...] = ()
    cut_short: bool = False

    @property
    def seen_share(self) -> float:
        """Share of floor and roof over what is free that was seen; 1 where none can be seen."""
        counted = self.surfaces_seen + self.surfaces_missing
        return self.surfaces_seen / counted if counted else 1.0

    def word(self, reach: Reach) -> MapWord:
        """What the map says to `Completion`, which decides when a mission is done."""
        return MapWord(
            frontier_m=float(self.frontiers_m[0]) if len(self.frontiers_m) else 0.0,
            seen_share=self.seen_share,
            surfaces_seen=self.surfaces_seen,
            has_room=self.free_m2 >= math.pi * reach.margin_m**2,
        )

    @property
    def completeness(self) -> float:
        """An estimate from 0 to 1: floor and roof seen, over these and what is missing or expected.

        Behind each frontier a drift is expected that is as wide as the frontier and one look long. Of what lies further
        nobody knows, so early in a flight it says too much, and it falls when a junction is found.
        """
        total = self.surfaces_seen + self.surfaces_missing + self.expected_cells
        return self.surfaces_seen / total if total else 0.0
