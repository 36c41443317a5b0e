"""The way home as a whole: what is remembered on the way out, how far it is back, and the going back. Pure."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from companion.control.decisions import Choice
from companion.control.governor import braking_speed_mps
from companion.control.homing.alignment import Alignment
from companion.control.homing.homeward import Homeward
from companion.control.homing.keyframes import Keyframe, Keyframes
from companion.control.homing.pace import Pace
from companion.control.informed import Route
from companion.control.known_ground import KnownGround, Place
from companion.control.parameters import Parameters
from companion.model import Measurement, Pose

ARRIVED_M, GONE_M = 0.25, 0.4
"""So near the vehicle has arrived, and so far off it has to come nearer again: what it sees tells better by then."""

SETTLED_M, SETTLED_S, SETTLING_S = 0.1, 2.0, 10.0
"""It stands so near to home for so long before it is there; after some seconds more it is as near as it gets."""

NEAR_M, PATIENCE_S, NEARER_M = 6.0, 20.0, 0.1
"""When the way home is no longer than this and has become no shorter for so long, something stands there now, or the
flight began nearer to a wall than the law flies: it lands at the nearest place where it can."""

UNSURE_M, TELLS_M = 0.5, 10.0
"""Where home may be further off than that, though it takes itself to be there, it flies the first metres of its way out
once more, to where walls may tell it, and comes back."""

CLOSED_S, TRIES = 20.0, 3
"""When for so long no way home has been known, and none to anything unseen, what is in the way is looked at anew; where
it still is so many times, the way is closed."""

EDGE_APART_M, MOST_EDGES = 0.2, 256
"""Places over which there was no ground below are kept so far apart, the newest."""

NOTICED_M = 0.3
"""So far behind the edge the vehicle may be before the beam downward has told: two readings of 10 Hz at 1.3 m/s."""

LOOK_PERIOD_S = 1.0
CREEP_MPS = 0.1
LONGER, LONGER_S = 3.0, 120.0
"""So many times what is reckoned for the way home, and so much more, it may take; then it lands where it is."""

ROUTE_PERIOD_S = 10.0
"""Time between two searches for the length of the way home; in between it grows by what is flown."""


def _straight_m(place: Place | None, pose: Pose) -> float:
    return math.inf if place is None else math.hypot(place.x_m - pose.x_m, place.y_m - pose.y_m)


def longest_s(time_s: float) -> float:
    """How long a way may take for which so much was reckoned."""
    return LONGER * time_s + LONGER_S


class WayHome(NamedTuple):
    """How far home is, and how long the way there takes."""

    length_m: float
    time_s: float

    @property
    def longest_s(self) -> float:
        """So long it may take; then it has failed."""
        return longest_s(self.time_s)


class Homing:
    """Home, and the way there.

    Args:
        parameters: the law's settings.
        ground: what has been seen of the plan.
        search: chooses what unseen ground is looked into where no way home is known.
    """

    def __init__(self, parameters: Parameters, ground: KnownGround, search: Choice) -> None:
        self.began_at: Place | None = None
        """Where the flight began."""
        self.home: Place | None = None
        """The same; on the way home where it lands, or where it first looks for walls that tell where home is."""
        self.lands_elsewhere = False
        """Whether it lands beside the place where the flight began, which it cannot get to."""
        self.is_closed = False
        """Whether no way home was found, and it lands at the nearest place to it that it gets to."""
        self.homeward: Homeward | None = None
        """The decisions of the way home; None while the vehicle explores."""
        self.is_home = False
        self._parameters = parameters
        self._ground = ground
        self._search = search
        self._keyframes = Keyframes(parameters.critical_margin_m)
        self._without_ground: deque[tuple[float, float]] = deque(maxlen=MOST_EDGES)
        self._alignment = Alignment(self._keyframes)
        self._reckoning: Homeward | None = None
        self._route: tuple[Route, float] | None = None
        self._next_route_s = -math.inf
        self._pace = Pace(parameters)
        self._least_m, self._least_s = math.inf, -math.inf
        self._open_s, self._tries = -math.inf, 0
        self._has_made_sure = False
        self._there_s: float | None = None
        self._near_s = -math.inf
        self._next_look_s = -math.inf

    @property
    def matches(self) -> int:
        """How often a place of the way out was recognised."""
        return self._alignment.matches

    def pace(self, pose: Pose, straight: bool) -> None:
        """Note how fast it flies; with every pose.

        Args:
            pose: by any position.
            straight: whether it flies straight to somewhere, as on the way home.
        """
        self._pace.note(pose, straight)

    def fly_out(self, measurement: Measurement, pose: Pose) -> None:
        """Remember the way; with every pose of the exploring."""
        if measurement.h_m is None:
            return
        here = Place.under(pose, measurement.h_m)
        if self.home is None:
            self.began_at = self.home = here
        self._keyframes.fly(pose)
        self._keyframes.see(measurement, pose)
        self._ground.fly(here)

    def lose_ground(self, pose: Pose) -> None:
        """There is no ground below this place: nothing is landed on beside it."""
        here = pose.x_m, pose.y_m
        if all(math.dist(here, one) >= EDGE_APART_M for one in self._without_ground):
            self._without_ground.append(here)

    def way_home(self, measurement: Measurement, pose: Pose, t_s: float, anew: bool = False) -> WayHome | None:
        """How far home is from here, by what is known; None where no way is.

        Args:
            measurement: of now.
            pose: by the autopilot's position.
            t_s: now.
            anew: search now, though the last search was a moment ago.
        """
        if self.home is None or measurement.h_m is None:
            return None
        if self._reckoning is None:
            self._reckoning = Homeward(self._parameters, self._ground, self.home)
        # Not by those that steer: whoever asks how far it is must not change where they search.
        reckoning, pose = self._reckoning, self.pose(pose)
        if self.homeward is not None:
            if reckoning.home != self.home:
                reckoning.lead_to(self.home)
            route = reckoning.route(Place.under(pose, measurement.h_m), pose.yaw_rad, t_s)
            return None if route is None else WayHome(route.length_m, self._pace.takes_s(route))
        if anew:
            reckoning.look_again()
        if anew or t_s >= self._next_route_s:
            self._next_route_s = t_s + ROUTE_PERIOD_S
            found = reckoning.route(Place.under(pose, measurement.h_m), pose.yaw_rad, t_s)
            if found is not None:
                self._route = found, self._keyframes.way_m
        if self._route is None:
            return None
        # Whatever lies between, it can go back where it came.
        route = self._route[0]._replace(length_m=self._route[0].length_m + self._keyframes.way_m - self._route[1])
        return WayHome(route.length_m, self._pace.takes_s(route))

    def begin(self, t_s: float) -> Homeward | None:
        """From now on home; None where nobody knows where that is."""
        if self.home is None:
            return None
        if self.homeward is None:
            self.homeward = Homeward(self._parameters, self._ground, self.home, self._search)
            # Only here it is known how far it has flown, and so how far its position may have drifted since it left.
            self._alignment = Alignment(self._keyframes)
            self._least_s = self._open_s = t_s
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
        self._least_s = self._open_s = t_s

    def to_go_m(self, pose: Pose) -> float:
        """How far home is, straight; infinite where nobody knows where that is."""
        return _straight_m(self.home, pose)

    def off_home_m(self, pose: Pose) -> float:
        """How far it is from where the flight began, straight; infinite where nobody knows where that is."""
        return _straight_m(self.began_at, pose)

    @property
    def unsure_m(self) -> float:
        """On the way home, how far `off_home_m` may be wrong by the drift of the position."""
        return self._alignment.unsure_m

    def has_arrived(self, pose: Pose, t_s: float) -> bool:
        """Whether the vehicle is where it is to stand; asked with every pose on the way home, as `pose` gives it."""
        self._look_whether_it_gets_there(pose, t_s)
        self._make_sure(pose, t_s)
        to_go_m = self.to_go_m(pose)
        if to_go_m >= (GONE_M if self._there_s is not None else ARRIVED_M):
            self._there_s, self.is_home = None, False
            return False
        if self._there_s is None:
            self._there_s = t_s
        if to_go_m > SETTLED_M:
            self._near_s = t_s
        self.is_home = t_s - max(self._there_s, self._near_s) >= SETTLED_S or t_s - self._there_s >= SETTLING_S
        return True

    def _make_sure(self, pose: Pose, t_s: float) -> None:
        """Fly on along the way out from a home that no wall has told, and back once one has; once in a flight."""
        homeward, began_at = self.homeward, self.began_at
        if homeward is None or began_at is None or self.lands_elsewhere:
            return
        is_there, is_unsure = self.to_go_m(pose) < ARRIVED_M, self.unsure_m > UNSURE_M
        if self._makes_sure:
            # Where something stands in its way now, it was worth a try, and no more.
            if is_there or not is_unsure or t_s - self._least_s > PATIENCE_S:
                self._lead_to(began_at, homeward, t_s)
        elif is_there and is_unsure and not self._has_made_sure:
            self._has_made_sure = True
            self._lead_to(self._keyframes.place_after(TELLS_M) or began_at, homeward, t_s)

    @property
    def _makes_sure(self) -> bool:
        """Whether it is on its way to see walls that tell where home is."""
        return self.home != self.began_at and not self.lands_elsewhere

    def _lead_to(self, place: Place, homeward: Homeward, t_s: float) -> None:
        self.home = place
        self._least_m, self._least_s = math.inf, t_s
        homeward.lead_to(place)

    def _look_whether_it_gets_there(self, pose: Pose, t_s: float) -> None:
        """Where home cannot be got to though it is near, land at the nearest place that is fit; where none is, here."""
        homeward = self.homeward
        if homeward is None or t_s < self._next_look_s:
            return
        self._next_look_s = t_s + LOOK_PERIOD_S
        here = homeward.place(pose)
        cost_m = homeward.cost_m(here, t_s)
        # While it makes sure it comes from home: that is not closed.
        self._look_whether_it_is_closed(homeward, here, pose, t_s, cost_m is not None or self._makes_sure)
        left_m = self.to_go_m(pose) if cost_m is None else cost_m
        if left_m < self._least_m - NEARER_M:
            self._least_m, self._least_s = left_m, t_s
        if left_m > NEAR_M or self._there_s is not None or self._makes_sure or t_s - self._least_s <= PATIENCE_S:
            return
        fit = [place for place in self._fit(self._keyframes.near(here, NEAR_M)) if place != self.home]
        nearest = min(fit, key=lambda one: _straight_m(one, pose), default=here)
        # Where it did not get to the place chosen last either, it is enough.
        self._land_at(here if self.lands_elsewhere else nearest, homeward, t_s)

    def _look_whether_it_is_closed(
        self, homeward: Homeward, here: Place, pose: Pose, t_s: float, is_open: bool
    ) -> None:
        """Where no way home is known, nor to anything unseen, try again, and then land as near to home as it gets."""
        if is_open or self.is_closed:
            self._open_s = t_s
        if t_s - self._open_s <= CLOSED_S:
            return
        self._open_s = t_s
        # Not each time: it costs a search of all that is known.
        if homeward.is_anything_left(pose):
            return
        self._tries += 1
        if self._tries < TRIES:
            homeward.try_again()
            return
        self.is_closed = True
        self._land_at(homeward.nearest_home(self._fit(self._keyframes.all), here) or here, homeward, t_s)

    def _fit(self, looks: Iterable[Keyframe]) -> list[Place]:
        """The places to land on: level, wide enough, and as far from the edge of a shaft as from a wall.

        When a look was made beside it, nobody may have known of the shaft yet.
        """
        room_m = self._parameters.critical_margin_m + NOTICED_M
        return [
            look.place
            for look in looks
            if look.lands
            and all(math.dist((look.place.x_m, look.place.y_m), edge) >= room_m for edge in self._without_ground)
        ]

    def _land_at(self, place: Place, homeward: Homeward, t_s: float) -> None:
        """Instead of at home."""
        self.lands_elsewhere = True
        self._lead_to(place, homeward, t_s)

    def most_mps(self, pose: Pose) -> float:
        """How fast it may fly so near to home, to stand there."""
        governor = self._parameters.governor
        to_go_m = max(0.0, self.to_go_m(pose) - ARRIVED_M / 2.0)
        return max(CREEP_MPS, braking_speed_mps(to_go_m, governor.reaction_s, governor.brake_mps2))
