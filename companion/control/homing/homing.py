"""The way home as a whole: what is remembered on the way out, how far it is back, and the going back. Pure."""

from __future__ import annotations

import math

from companion.control.governor import braking_speed_mps
from companion.control.homing.alignment import Alignment
from companion.control.homing.homeward import Homeward
from companion.control.homing.keyframes import Keyframes
from companion.control.known_ground import KnownGround, Place
from companion.control.parameters import Parameters
from companion.model import Measurement, Pose

ARRIVED_M, GONE_M = 0.25, 0.4
"""So near the vehicle has arrived, and so far off it has to come nearer again: what it sees tells better by then."""

SETTLED_S = 2.0
"""It stands at home for so long before that is believed."""

NEAR_M, PATIENCE_S = 1.5, 20.0
"""So near to home is near enough when it has come no nearer for so long: something stands there now, or the flight
began nearer to a wall than the law flies."""

NEARER_M = 0.1
CREEP_MPS = 0.1
LENGTH_PERIOD_S = 10.0
"""Time between two searches for the length of the way home; in between it grows by what is flown."""


class Homing:
    """Home, and the way there.

    Args:
        parameters: the law's settings.
        ground: what has been seen of the plan.
    """

    def __init__(self, parameters: Parameters, ground: KnownGround) -> None:
        self.home: Place | None = None
        """Where the flight began, until `begin_at` another place."""
        self.homeward: Homeward | None = None
        """The decisions of the way home; None while the vehicle explores."""
        self.is_home = False
        self._parameters = parameters
        self._ground = ground
        self._keyframes = Keyframes()
        self._alignment = Alignment(self._keyframes)
        self._reckoning: Homeward | None = None
        self._length: tuple[float, float] | None = None
        self._next_length_s = -math.inf
        self._least_m, self._least_s = math.inf, -math.inf
        self._there_s: float | None = None

    @property
    def matches(self) -> int:
        """How often a place of the way out was recognised."""
        return self._alignment.matches

    def fly_out(self, measurement: Measurement, pose: Pose) -> None:
        """Remember the way; with every pose of the exploring."""
        if measurement.h_m is None:
            return
        here = Place.under(pose, measurement.h_m)
        if self.home is None:
            self.home = here
        self._keyframes.fly(pose)
        self._keyframes.see(measurement, pose)
        self._ground.fly(here)

    def way_home_m(self, measurement: Measurement, pose: Pose, t_s: float) -> float | None:
        """How long the way home is from here, by what is known; None where no way is.

        Args:
            measurement: of now.
            pose: by the autopilot's position.
            t_s: now.
        """
        home = self.home
        if home is None or measurement.h_m is None:
            return None
        if self._reckoning is None:
            self._reckoning = Homeward(self._parameters, self._ground, home)
        if self.homeward is not None:
            # Not by those that steer: whoever asks how far it is must not change where they search.
            return self._reckoning.length_m(Place.under(self.pose(pose), measurement.h_m), t_s)
        if t_s >= self._next_length_s:
            self._next_length_s = t_s + LENGTH_PERIOD_S
            length_m = self._reckoning.length_m(Place.under(pose, measurement.h_m), t_s)
            if length_m is not None:
                self._length = length_m, self._keyframes.way_m
        if self._length is None:
            return None
        # Whatever lies between, it can go back where it came.
        return self._length[0] + self._keyframes.way_m - self._length[1]

    def begin(self, t_s: float) -> Homeward | None:
        """From now on home; None where nobody knows where that is."""
        if self.home is None:
            return None
        if self.homeward is None:
            self.homeward = Homeward(self._parameters, self._ground, self.home)
            self._least_s = t_s
        return self.homeward

    def pose(self, pose: Pose) -> Pose:
        """Where the vehicle is by the position of the way out; the same while it explores."""
        return pose if self.homeward is None else self._alignment.pose(pose)

    def align(self, measurement: Measurement, pose: Pose, t_s: float) -> float:
        """Look where on the way out the vehicle is; by how much it was wrong, in m."""
        before = self._alignment.pose(pose)
        if not self._alignment.update(measurement, pose, t_s):
            return 0.0
        after = self._alignment.pose(pose)
        return math.hypot(after.x_m - before.x_m, after.y_m - before.y_m)

    def wait(self, t_s: float) -> None:
        """A person let it wait until now: that it came no nearer meanwhile says nothing."""
        self._least_s = t_s

    def to_go_m(self, pose: Pose) -> float:
        """How far home is, straight; infinite where nobody knows where that is."""
        home = self.home
        return math.inf if home is None else math.hypot(home.x_m - pose.x_m, home.y_m - pose.y_m)

    def has_arrived(self, pose: Pose, t_s: float) -> bool:
        """Whether the vehicle is where it is to stand; asked with every pose on the way home, as `pose` gives it."""
        to_go_m = self.to_go_m(pose)
        if to_go_m < self._least_m - NEARER_M:
            self._least_m, self._least_s = to_go_m, t_s
        gives_up = to_go_m < NEAR_M and t_s - self._least_s > PATIENCE_S
        there = to_go_m < (GONE_M if self._there_s is not None else ARRIVED_M) or gives_up
        if not there:
            self._there_s, self.is_home = None, False
            return False
        if self._there_s is None:
            self._there_s = t_s
        self.is_home = t_s - self._there_s >= SETTLED_S
        return True

    def most_mps(self, pose: Pose) -> float:
        """How fast it may fly so near to home, to stand there."""
        governor = self._parameters.governor
        to_go_m = max(0.0, self.to_go_m(pose) - ARRIVED_M / 2.0)
        return max(CREEP_MPS, braking_speed_mps(to_go_m, governor.reaction_s, governor.brake_mps2))
