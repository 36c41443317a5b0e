"""The decisions of the way home: as those of the exploring, but that home is what is looked for. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from companion.control.decisions import Choice, Decisions
from companion.control.ground_grid import level_at
from companion.control.informed import Route, Way, Ways, ways_within
from companion.control.known_ground import KnownGround, Place, Window
from companion.control.parameters import Parameters
from companion.control.target import Target
from companion.model import Measurement, Pose

PLAN_PERIOD_S = 1.0
"""Time between two looks for the way, where none is flown."""

SEARCH_PERIOD_S = 30.0
"""A search serves for so long, unless something is in the way: known ground changes little on the way home, and in a
mine of 250 m a search takes hundredths of a second."""

LOST_PERIOD_S = 3.0
"""Where it has found no way, it is searched anew after so long: another one may have come into view."""


class Homeward(Decisions):
    """Which way leads home. Nothing is drawn where a way is known.

    Where none is, what is unseen is looked into, for another way may lead through it; where nothing is unseen either,
    tangents are drawn for, by the paper's law.

    Args:
        parameters: the law's settings.
        ground: what has been seen of the plan, and where it was flown.
        home: where it is to lead, a place that was flown over.
        search: chooses what is looked into where no way home is known; None: nothing is.
    """

    def __init__(self, parameters: Parameters, ground: KnownGround, home: Place, search: Choice | None = None) -> None:
        super().__init__(parameters, ground)
        self._search = search
        self.refusal, self.least_straight_m = 0.0, parameters.target_radius_m
        self.home = home
        self._found: Ways | None = None
        self._searched_s = -math.inf
        self._t_s = -math.inf

    def see(self, measurement: Measurement, pose: Pose) -> None:
        """As `Decisions.see`."""
        super().see(measurement, pose)
        if self._search is not None:
            self._search.stand_over(measurement.h_m)

    def better_way(self, gamma: int, pose: Pose, t_s: float) -> Way | None:
        """The way home, whatever boundary is followed; None just after it was blocked.

        Where none is known, the way to what is unseen.
        """
        self._t_s = t_s
        if t_s < self._next_plan_s:
            return None
        self._next_plan_s = t_s + PLAN_PERIOD_S
        way = self._way_home(pose)
        return self._search.better_way(gamma, pose, t_s) if way is None and self._search is not None else way

    def onward(self, pose: Pose) -> Way | None:
        """The way on from here, home or to what is unseen."""
        way = self._way_home(pose)
        return self._search.onward(pose) if way is None and self._search is not None else way

    def _way_home(self, pose: Pose) -> Way | None:
        here = self.place(pose)
        ways = self._ways(here)
        way = None if ways is None else ways.way(here, pose.yaw_rad, self._turn_m_per_rad)
        # The last straight ends at home itself, not in the middle of its cell.
        return way._replace(straight=self.home) if way is not None and way.straight == way.goal else way

    def has_been_seen(self, goal: Place, pose: Pose, t_s: float) -> bool:
        """Home never: it is to be flown to. What is unseen, as while exploring, and once a way home is known."""
        self._t_s = t_s
        ways = self._ways(self.place(pose))
        if ways is None or self._search is None or ways.is_goal(goal):
            return False
        return ways.cost_m(self.place(pose)) is not None or self._search.has_been_seen(goal, pose, t_s)

    def block_way(self, target: Target, pose: Pose, t_s: float) -> None:
        """As `Decisions.block_way`; the next answer is searched anew."""
        super().block_way(target, pose, t_s)
        self.look_again()

    def lead_to(self, home: Place) -> None:
        """Lead elsewhere from now on."""
        self.home = home
        self.look_again()

    def try_again(self) -> None:
        """What was blocked may have gone out of the way meanwhile."""
        self._ground.unblock()
        self.look_again()

    def is_anything_left(self, pose: Pose) -> bool:
        """Whether a way from here leads to something unseen, behind which another way home may be, or nobody knows."""
        return self._search is not None and self._search.is_way_left(pose) is not False

    def nearest_home(self, places: Iterable[Place], here: Place) -> Place | None:
        """Of places those that a way leads to from here, and of them that from which it is the shortest way home.

        Home by the ways as they were before one was closed: so far somebody has to go to fetch the vehicle.

        Args:
            places: that were flown over.
            here: where it is.
        """
        window = self._ground.with_way_flown()
        if window is None:
            return None
        before = _ways_to(self.home, replace(window, blocked=window.blocked[:0]), here)
        to_here = _ways_to(here, window, here)
        costs_m = ((before.cost_m(place), place) for place in places if to_here.cost_m(place) is not None)
        known = [(cost_m, place) for cost_m, place in costs_m if cost_m is not None]
        return min(known, key=lambda one: one[0])[1] if known else None

    def look_again(self) -> None:
        """Search anew before the next answer: the vehicle turned out to be elsewhere, or something is in the way."""
        self._found = None

    def route(self, place: Place, yaw_rad: float, t_s: float) -> Route | None:
        """The way home from a place, for a vehicle that points there; None where no way is known."""
        self._t_s = t_s
        ways = self._ways(place)
        if ways is None:
            return None
        if ways.window.cell(place) == ways.window.cell(self.home):
            return Route(math.hypot(self.home.x_m - place.x_m, self.home.y_m - place.y_m), 0.0)
        return ways.route(place, yaw_rad)

    def cost_m(self, place: Place, t_s: float) -> float | None:
        """What the way home costs, see `Ways.cost_m`; None where no way is known."""
        self._t_s = t_s
        ways = self._ways(place)
        return None if ways is None else ways.cost_m(place)

    def _ways(self, place: Place) -> Ways | None:
        if self._found is None or self._t_s - self._searched_s >= SEARCH_PERIOD_S:
            window = self._ground.with_way_flown()
            self._searched_s = self._t_s
            if window is None:
                return None
            self._found = _ways_to(self.home, window, place)
            if self._found.cost_m(place) is None:
                self._searched_s -= SEARCH_PERIOD_S - LOST_PERIOD_S
        return self._found


def _ways_to(goal: Place, window: Window, place: Place) -> Ways:
    """Ways to one place, for a vehicle that is at another."""
    row, column = window.cell(goal)
    goals = np.zeros_like(window.grid.cells, np.bool_)
    rows, columns = window.grid.cells.shape[1:]
    level = level_at(window.grid, row, column, goal.ground_dm) if 0 <= row < rows and 0 <= column < columns else -1
    if level >= 0:
        goals[level, row, column] = True
    return ways_within(window, place, goals)
