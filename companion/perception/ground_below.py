"""The ground below the vehicle: how high it is, and where it ends.

It ends where the beam downward sees none, and where it falls by more than the vehicle could come up again: on the way
back such a step is a wall in the slab. Nobody who wants to come home flies down there.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from companion.control.separation import Back
from companion.model import Pose

KEPT_S = 10.0
"""The slab follows the last ground for so long: as long as a flight goes on without a height."""

LEAST_DROP_M = 0.5
"""A fall by less is rubble, however low the vehicle flies."""

RISES_S = 0.25
"""Ground that has risen by more than it may fall is believed after so long: two readings of a beam of 10 Hz. One alone
is dust or spray in the beam; taken for ground, the floor below would be a shaft ever after."""

LATELY_M = 1.0
"""Of the ground within this the highest counts. The wall of a shaft is met over decimetres of way, and each reading may
be less than a fall from the one before."""

NOTED_M, NOTED_S = 0.1, 1.0
"""A place of the ground is kept for each of these."""

MEETS_M = 0.4
"""Two positions in one frame may differ by so much in height and still be one place. From the back of the lowest
vehicle it is further to the ground."""


def above_ground_m(down_m: float | None, beneath: tuple[Back, ...]) -> float | None:
    """The height above ground, also where the beam downward ends on the back of another vehicle.

    A back is no ground: once it was passed the ground would have fallen, and that is where nobody flies on.

    Args:
        down_m: how far the beam downward sees; None where it says nothing.
        beneath: the vehicles that this one may be above.
    """
    if down_m is None:
        return None
    backs = [(abs(back.down_m - down_m), back.height_m) for back in beneath]
    off_m, height_m = min(backs, default=(MEETS_M, 0.0))
    return down_m + height_m if off_m < MEETS_M else down_m


class _Place(NamedTuple):
    t_s: float
    x_m: float
    y_m: float
    ground_m: float


class GroundBelow:
    """The last ground that was measured.

    Args:
        climbs_m: a step so high is flown over upward too; what stands higher is a wall in the slab.
        max_slope: steepest ground, rise over run.
    """

    def __init__(self, climbs_m: float, max_slope: float) -> None:
        self._drop_m = max(LEAST_DROP_M, climbs_m)
        self._max_slope = max_slope
        self._known: tuple[float, float, float] | None = None  # its height, the height above it, and when
        self._risen_s: float | None = None  # since when every reading has said that it has risen
        self._lately: deque[_Place] = deque()

    def see(self, h_m: float | None, no_ground: bool, pose: Pose, t_s: float) -> tuple[float | None, bool]:
        """What the beam downward says now.

        Args:
            h_m: the height above ground, None where it says none.
            no_ground: it sees nothing as far as it reaches.
            pose: of this moment.
            t_s: now.

        Returns:
            The height above ground that may be flown at, None where there is none; and whether the ground has ended.
        """
        self._forget(pose, t_s)
        if h_m is not None and not self._has_fallen(h_m, pose):
            if not self._has_risen(h_m, pose):
                self._risen_s = None
            elif self._risen_s is None or t_s - self._risen_s < RISES_S:
                # It is kept off at once; what it is kept for below is the ground as it was.
                self._risen_s = t_s if self._risen_s is None else self._risen_s
                return h_m, False
            self._note(h_m, pose, t_s)
            return h_m, False
        if h_m is not None:
            self._risen_s = None
        return None, self._known is not None and (h_m is not None or no_ground)

    def height_m(self, t_s: float) -> float | None:
        """Height of the ground as it is, or was a moment ago: at its edge what lies ahead must still be seen."""
        return self._known[0] if self._known is not None and t_s - self._known[2] <= KEPT_S else None

    def _forget(self, pose: Pose, t_s: float) -> None:
        if self.height_m(t_s) is None:
            self._known = None
        if self._known is not None and abs(pose.z_m - self._known[0] - self._known[1]) > LEAST_DROP_M:
            # The position has leapt: earlier heights are of another frame.
            self._lately.clear()
        while self._lately and t_s - self._lately[0].t_s > KEPT_S:
            self._lately.popleft()

    def _note(self, h_m: float, pose: Pose, t_s: float) -> None:
        ground_m = pose.z_m - h_m
        self._known = ground_m, h_m, t_s
        last = self._lately[-1] if self._lately else None
        if (
            last is None
            or t_s - last.t_s >= NOTED_S
            or math.dist((pose.x_m, pose.y_m), (last.x_m, last.y_m)) >= NOTED_M
        ):
            self._lately.append(_Place(t_s, pose.x_m, pose.y_m, ground_m))

    def _lately_m(self, pose: Pose) -> float:
        """Not lower than this the ground was lately, for this place: as far away as it was, ramps aside."""
        away_m = ((math.dist((pose.x_m, pose.y_m), (one.x_m, one.y_m)), one.ground_m) for one in self._lately)
        near_m = (ground_m - self._max_slope * far_m for far_m, ground_m in away_m if far_m <= LATELY_M)
        return max(near_m, default=-math.inf)

    def _has_risen(self, h_m: float, pose: Pose) -> bool:
        """Whether the reading itself has jumped up by so much that the ground as it was would be a fall from there."""
        if self._known is None:
            return False
        ground_m, flown_m, _ = self._known
        return flown_m - h_m > self._drop_m and pose.z_m - h_m - ground_m > self._drop_m

    def _has_fallen(self, h_m: float, pose: Pose) -> bool:
        """Whether the reading itself has jumped, and with it the ground: a leap of the position moves only one.

        Or the ground has gone down bit by bit, faster than any ramp: that is the wall of a shaft, and it leads into it.
        """
        if self._known is None:
            return False
        ground_m, flown_m, _ = self._known
        below_m = pose.z_m - h_m
        has_jumped = h_m - flown_m > self._drop_m and ground_m - below_m > self._drop_m
        return has_jumped or self._lately_m(pose) - below_m > self._drop_m
