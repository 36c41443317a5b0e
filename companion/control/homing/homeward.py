"""The decisions of the way home: as those of the exploring, but that home is what is looked for. Pure."""

from __future__ import annotations

import math

import numpy as np

from companion.control.decisions import Decisions
from companion.control.ground_grid import level_at
from companion.control.informed import Route, Way, Ways, ways_within
from companion.control.known_ground import KnownGround, Place
from companion.control.parameters import Parameters
from companion.control.target import Target
from companion.model import Pose

PLAN_PERIOD_S = 1.0
"""Time between two looks for the way, where none is flown."""

SEARCH_PERIOD_S = 30.0
"""A search serves for so long, unless something is in the way: known ground changes little on the way home, and in a
mine of 250 m a search takes hundredths of a second."""


class Homeward(Decisions):
    """Which way leads home. Nothing is drawn where a way is known; where none is, tangents are, by the paper's law.

    Args:
        parameters: the law's settings.
        ground: what has been seen of the plan, and where it was flown.
        home: where it is to lead, a place that was flown over.
    """

    def __init__(self, parameters: Parameters, ground: KnownGround, home: Place) -> None:
        super().__init__(parameters, ground)
        self.refusal, self.least_straight_m = 0.0, parameters.target_radius_m
        self.home = home
        self._found: Ways | None = None
        self._searched_s = -math.inf
        self._t_s = -math.inf

    def better_way(self, _gamma: int, pose: Pose, t_s: float) -> Way | None:
        """The way home, whatever boundary is followed; None just after it was blocked, and where none is known."""
        self._t_s = t_s
        if t_s < self._next_plan_s:
            return None
        self._next_plan_s = t_s + PLAN_PERIOD_S
        return self.onward(pose)

    def onward(self, pose: Pose) -> Way | None:
        """The way home from here."""
        here = self.place(pose)
        ways = self._ways(here)
        way = None if ways is None else ways.way(here, pose.yaw_rad, self._turn_m_per_rad)
        # The last straight ends at home itself, not in the middle of its cell.
        return way._replace(straight=self.home) if way is not None and way.straight == way.goal else way

    def has_been_seen(self, _goal: Place, _pose: Pose, t_s: float) -> bool:
        """Never: home is to be flown to."""
        self._t_s = t_s
        return False

    def block_way(self, target: Target, pose: Pose, t_s: float) -> None:
        """As `Decisions.block_way`; the next answer is searched anew."""
        super().block_way(target, pose, t_s)
        self.look_again()

    def lead_to(self, home: Place) -> None:
        """Lead elsewhere from now on."""
        self.home = home
        self.look_again()

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
            row, column = window.cell(self.home)
            level = level_at(window.grid, row, column, self.home.ground_dm)
            goals = np.zeros(window.grid.cells.shape, np.bool_)
            if level >= 0:
                goals[level, row, column] = True
            self._found = ways_within(window, place, goals)
        return self._found
