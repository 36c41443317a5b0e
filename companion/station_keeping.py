"""Staying where one is by velocities alone: back to the place, slowly. Pure, without numpy: gate and law share it.

Zero velocity is not standing still. An autopilot flies it by an estimate that is wrong by centimetres a second, and
creeps on: the simulated PX4 0.02 to 0.06 m/s, for as long as it is asked to stand. Its position, which something
measures, does not creep; so whoever means "stand" asks for the way back to where the vehicle came to stand.

The plane's two axes and the heading are any in which the heading turns from the first axis towards the second:
east and north with a heading counter-clockwise, north and east with one clockwise.
"""

from __future__ import annotations

import math

GAIN_PER_S = 0.5
"""Of the way back in 1 s: slow against the autopilot's velocity loop (0.5 to 1 s), so the two do not swing."""
MOST_MPS = 0.1
"""Nothing that is only meant to stand is faster, however far a position has leapt; above every creep measured."""
STANDS_MPS = 0.1
"""Below this it has come to stand: where it is then is where it is to stay."""
PATIENCE_S = 2.0
"""Zero velocity has brought both autopilots to stand by then; an estimate of the velocity that never gets below that
does not tell. After this long the place is taken as it is, and what still moves has to be held another way."""

Vector = tuple[float, float, float]


class StationKeeper:
    """Remembers where the vehicle came to stand, and leads it back there.

    Attributes:
        place_m: where it is kept, on the axes in which positions are handed in; None while it has not come to stand.
    """

    def __init__(self) -> None:
        self.place_m: Vector | None = None
        self._since_s: float | None = None

    def release(self) -> None:
        """It may move again, or nobody knows where it is: the place is forgotten."""
        self.place_m = None
        self._since_s = None

    def velocity(self, at_m: Vector, velocity_mps: Vector, heading_rad: float, now_s: float) -> Vector:
        """What to ask for now so that it stays.

        Args:
            at_m: where it is: both axes of the plane, and height or depth.
            velocity_mps: on the same axes.
            heading_rad: from the first axis towards the second.
            now_s: never goes back.

        Returns:
            Along the heading, a right angle further towards the second axis, and on the third axis, in m/s; zero until
            it has come to stand. Not finite numbers, and `release`, make it begin anew.
        """
        if not all(map(math.isfinite, (*at_m, *velocity_mps, heading_rad))):
            self.release()
            return 0.0, 0.0, 0.0
        if self._since_s is None:
            self._since_s = now_s
        if self.place_m is None:
            if math.hypot(*velocity_mps) > STANDS_MPS and now_s - self._since_s < PATIENCE_S:
                return 0.0, 0.0, 0.0
            self.place_m = at_m
        first, second, third = (GAIN_PER_S * (there - here) for there, here in zip(self.place_m, at_m, strict=True))
        speed_mps = math.hypot(first, second)
        if not math.isfinite(speed_mps):  # the difference of two finite numbers need not be
            self.release()
            return 0.0, 0.0, 0.0
        share = min(1.0, MOST_MPS / max(speed_mps, 1e-9))
        first, second = share * first, share * second
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        return first * cos + second * sin, second * cos - first * sin, max(-MOST_MPS, min(MOST_MPS, third))
