"""The ground below the vehicle: how high it is, and where it ends.

It ends where the beam downward sees none, and where it falls by more than the vehicle could come up again: on the way
back such a step is a wall in the slab. Nobody who wants to come home flies down there.
"""

from __future__ import annotations

from companion.control.separation import Back
from companion.model import Pose

KEPT_S = 10.0
"""The slab follows the last ground for so long: as long as a flight goes on without a height."""

LEAST_DROP_M = 0.5
"""A fall by less is rubble, however low the vehicle flies."""

RISES_S = 0.25
"""Ground that has risen by more than it may fall is believed after so long: two readings of a beam of 10 Hz. One alone
is dust or spray in the beam; taken for ground, the floor below would be a shaft ever after."""


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


class GroundBelow:
    """The last ground that was measured.

    Args:
        climbs_m: a step so high is flown over upward too; what stands higher is a wall in the slab.
    """

    def __init__(self, climbs_m: float) -> None:
        self._drop_m = max(LEAST_DROP_M, climbs_m)
        self._known: tuple[float, float, float] | None = None  # its height, the height above it, and when
        self._risen_s: float | None = None  # since when every reading has said that it has risen

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
        if self.height_m(t_s) is None:
            self._known = None
        if h_m is not None and not self._has_fallen(h_m, pose):
            if not self._has_risen(h_m, pose):
                self._risen_s = None
            elif self._risen_s is None or t_s - self._risen_s < RISES_S:
                # It is kept off at once; what it is kept for below is the ground as it was.
                self._risen_s = t_s if self._risen_s is None else self._risen_s
                return h_m, False
            self._known = (pose.z_m - h_m, h_m, t_s)
            return h_m, False
        if h_m is not None:
            self._risen_s = None
        return None, self._known is not None and (h_m is not None or no_ground)

    def height_m(self, t_s: float) -> float | None:
        """Height of the ground as it is, or was a moment ago: at its edge what lies ahead must still be seen."""
        return self._known[0] if self._known is not None and t_s - self._known[2] <= KEPT_S else None

    def _has_risen(self, h_m: float, pose: Pose) -> bool:
        """Whether the reading itself has jumped up by so much that the ground as it was would be a fall from there."""
        if self._known is None:
            return False
        ground_m, flown_m, _ = self._known
        return flown_m - h_m > self._drop_m and pose.z_m - h_m - ground_m > self._drop_m

    def _has_fallen(self, h_m: float, pose: Pose) -> bool:
        """Whether the reading itself has jumped, and with it the ground: a leap of the position moves only one."""
        if self._known is None:
            return False
        ground_m, flown_m, _ = self._known
        return h_m - flown_m > self._drop_m and ground_m - (pose.z_m - h_m) > self._drop_m
