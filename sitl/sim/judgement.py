"""What the vehicles themselves would say of a simulated mission: the rule of a flight, without the truth.

In flight the map is surveyed by its process, all the time. Here a survey would take as long as the rest of the
simulation, so the map is asked only while the known ground has nothing left, and at the end.
"""

from __future__ import annotations

import math

import numpy as np

from companion.config.mapping import MapSettings
from companion.config.settings import Settings
from companion.control.completion import Completion
from companion.control.left_out import LeftOut, merged
from companion.mapping import VoxelMap
from companion.mapping.frontiers.frontier import Reach, Survey
from companion.mapping.frontiers.surveyor import Surveyor
from sitl.sim.flight import Flight

SURVEY_PERIOD_S = 15.0
"""Simulated time between two surveys."""


class Judgement:
    """Asks the vehicles of one mission, as if they were one: nothing is left when none of them knows of anything.

    Args:
        flights: the vehicles.
        settings: the whole configuration.
    """

    def __init__(self, flights: tuple[Flight, ...], settings: Settings) -> None:
        self.done_at_s: float | None = None
        """When the vehicles would first have said that they are done."""
        self._flights = flights
        self._settings = settings
        self._reach = Reach.of(
            settings.mapping,
            settings.sensors.camera.model(),
            settings.control,
            settings.half_slab_m,
            settings.sensors.scan.max_ground_slope,
        )
        self._completion = Completion(2.0 * settings.control.critical_margin_m)
        self._surveyor = Surveyor(settings.mapping.voxel_m, self._reach)
        self._survey: Survey | None = None
        self._revision = 0
        self._ticks = [0] * len(flights)
        self._surveyed_s = -math.inf

    def look(self, t_s: float) -> bool:
        """Whether they would say that they are done."""
        grounds = [flight.navigator.is_way_left(flight.estimated) for flight in self._flights]
        ground = True if any(grounds) else None if None in grounds else False
        if not ground and t_s >= self._surveyed_s + SURVEY_PERIOD_S:
            self._look_for_frontiers(t_s)
        found = self._survey
        is_done = self._completion.update(t_s, ground, None if found is None else found.word(self._reach))
        if is_done and self.done_at_s is None:
            self.done_at_s = t_s
        return is_done

    def completeness(self, t_s: float) -> float:
        """What they take their map for, from 0 to 1 (`Survey.completeness`)."""
        return self._newest(t_s).completeness

    def left_out(self, t_s: float) -> tuple[LeftOut, ...]:
        """What they have seen the beginning of and not looked into."""
        on_ground = [place for flight in self._flights for place in flight.navigator.left_out(flight.estimated)]
        return merged((*on_ground, *self._surveyor.left_out(self._newest(t_s))))

    def _newest(self, t_s: float) -> Survey:
        if self._survey is None or self._surveyed_s < t_s:
            self._survey = self._look_for_frontiers(t_s)
        return self._survey

    def _look_for_frontiers(self, t_s: float) -> Survey:
        flights, surveyor = self._flights, self._surveyor
        if len(flights) == 1:
            snapshot = flights[0].map.snapshot(self._revision)
            self._revision = snapshot.revision
        else:
            snapshot = merged_map(flights, self._settings.mapping).snapshot()
        surveyor.update(snapshot)
        for index, flight in enumerate(flights):
            log = flight.log
            places = np.stack([log.column(f"estimated_{axis}_m")[self._ticks[index] :] for axis in "xyz"], axis=1)
            self._ticks[index] = len(log)
            if len(places):
                surveyor.flew(places)
        here = flights[0].estimated
        self._survey = surveyor.survey((here.x_m, here.y_m, here.z_m))
        self._surveyed_s = t_s
        return self._survey


def merged_map(flights: tuple[Flight, ...], settings: MapSettings) -> VoxelMap:
    """V: the union of what every vehicle has mapped (paper eq. (5))."""
    if len(flights) == 1:
        return flights[0].map
    merged = VoxelMap(settings)
    for flight in flights:
        merged.merge(flight.map)
    return merged
