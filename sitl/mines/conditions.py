"""What a place does to a vehicle besides being in its way: surfaces that give no echo, dust, wind, what moves."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.model import Pose


class Surface(enum.IntEnum):
    """What a triangle is made of, as far as cameras and rangefinders care."""

    ROCK = 0
    DARK = 1
    """Nothing comes back: soot, wet coal, black cloth."""
    SHINY = 2
    """Patches of it come and go: most of the light is mirrored away, some comes back from what is mirrored."""
    WATER = 3
    """Still water: a camera sees what is mirrored in it, a beam the surface, what is mirrored, or nothing."""


@dataclass(frozen=True, slots=True)
class Trigger:
    """Something begins when a vehicle has come as near as this to a place in the plan."""

    x_m: float
    y_m: float
    radius_m: float

    def is_met(self, pose: Pose) -> bool:
        """Whether a vehicle is there."""
        return math.dist((pose.x_m, pose.y_m), (self.x_m, self.y_m)) <= self.radius_m


@dataclass(frozen=True, slots=True, eq=False)
class Mover:
    """A body that begins to move when a vehicle comes, goes straight, and stays where it arrives.

    Attributes:
        vertices_m: (n, 3) float32 where it stands at first, which may be out of sight in the rock.
        triangles: (m, 3) int32.
        way_m: how far it goes along x, y and z.
        speed_mps: how fast.
        trigger: when it begins.
    """

    vertices_m: NDArray[np.float32]
    triangles: NDArray[np.int32]
    way_m: tuple[float, float, float]
    speed_mps: float
    trigger: Trigger


@dataclass(frozen=True, slots=True)
class Stretch:
    """A rectangle of the plan, in m: west, south, east and north border."""

    west_m: float
    south_m: float
    east_m: float
    north_m: float

    def holds(self, pose: Pose) -> bool:
        """Whether a vehicle is in it."""
        return self.west_m <= pose.x_m <= self.east_m and self.south_m <= pose.y_m <= self.north_m


@dataclass(frozen=True, slots=True)
class Dust:
    """Sparse dust or spray in a stretch, which comes in puffs: false returns in images and beams, and then none.

    Attributes:
        where: the stretch.
        clouds: how many small clouds an image shows on average while a puff lasts.
        beam_share: of the readings of a beam, how many meet one.
    """

    where: Stretch
    clouds: float
    beam_share: float


@dataclass(frozen=True, slots=True)
class Wind:
    """A steady wind in a stretch, in m/s towards east and north."""

    where: Stretch
    x_mps: float
    y_mps: float


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """Everything of the kind in one world.

    Attributes:
        surfaces: (m,) uint8 a `Surface` for each triangle of the world; None where all is rock.
        movers: what moves.
        dust: where it is dusty.
        winds: where wind blows; of several that overlap the first counts.
        light_fails: from when on the camera sees nothing.
    """

    surfaces: NDArray[np.uint8] | None = None
    movers: tuple[Mover, ...] = ()
    dust: tuple[Dust, ...] = ()
    winds: tuple[Wind, ...] = ()
    light_fails: Trigger | None = None


NONE = Conditions()
