"""A simulated mission as the operator's page sees it: what the vehicles tell, and a copy of their maps that grows.

The mission's thread looks from time to time and takes copies; the page asks for them from a thread of its own.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

import numpy as np

from companion.config.settings import Settings
from companion.link.words import Answer, Command, Place, Telemetry
from companion.mapping import VoxelMap
from companion.mapping.voxels.piece import MapSnapshot, MapSource
from companion.model import FloatArray
from companion.pipeline import Order
from companion.viewer.graphs import GraphLines, graph_lines
from sitl.sim.display import MODE_MEANS
from sitl.sim.flight import Flight
from sitl.sim.simulation import Simulation

LOOK_PERIOD_S = 0.2
"""Time between two looks, of the time that somebody waits."""

MAP_PERIOD_S = 1.0
"""The same for maps, graphs and what is left to explore."""

_STEP_M = 0.2
"""Positions of the way this far from each other are kept."""


class WatchedVehicle:
    """One vehicle of a simulated mission; a `companion.ground.station.VehicleView`.

    Args:
        flight: the vehicle.
        settings: the whole configuration.
        flight_name: of the mission.
    """

    def __init__(self, flight: Flight, settings: Settings, flight_name: str) -> None:
        self.name = f"vehicle {flight.log.vehicle_id}"
        self.doubt = ""
        self.map_age_s = 0.0
        self.map_number = 0
        self._flight = flight
        self._settings = settings
        self._flight_name = flight_name
        self._lock = threading.Lock()
        self._telemetry: Telemetry | None = None
        self._number = 0
        self._copy = VoxelMap(settings.mapping)
        self._revision = 0
        self._way_m: list[Place] = []
        self._ticks = 0
        self._graph: list[GraphLines] = []
        self._left: list[Place] = []

    @property
    def telemetry(self) -> Telemetry | None:
        """As of the last look."""
        return self._telemetry

    @property
    def age_s(self) -> float:
        """Nothing is between the page and the mission, which may take its time."""
        return 0.0 if self._telemetry is not None else float("inf")

    def changed(self, revision: int) -> MapSnapshot:
        """Of the copy."""
        with self._lock:
            return self._copy.snapshot(revision)

    def source(self) -> MapSource:
        """The copy as it is now."""
        whole = VoxelMap(self._settings.mapping)
        with self._lock:
            for piece in self._copy.pieces():
                whole.put(piece)
        return whole

    def way_m(self) -> FloatArray:
        """Where it took itself to be."""
        with self._lock:
            return np.array(self._way_m, np.float64).reshape(-1, 3)

    def graph(self) -> Sequence[GraphLines]:
        """Of the navigator."""
        with self._lock:
            return self._graph

    def frontiers_m(self) -> Sequence[Place]:
        """What the navigator knows to be left."""
        with self._lock:
            return self._left

    def ask(self, command: Command, on_answer: Callable[[Answer | None], None]) -> None:
        """Nobody commands here."""
        on_answer(Answer(False, f"this mission is only watched; Ctrl-C in its terminal ends it ({command.value})"))

    def look(self, t_s: float, completeness: float, ended_because: str) -> None:
        """Take what the vehicle would tell. For the mission's thread."""
        flight, control = self._flight, self._settings.control
        measurement, here, status = flight.measurement, flight.estimated, flight.navigator.status
        home = flight.way_home()
        self._number += 1
        waits = flight.order is Order.WAIT
        phase = "homing" if flight.order is Order.HOME else "exploring"
        self._telemetry = Telemetry(
            vehicle=self.name,
            flight=self._flight_name,
            number=self._number,
            t_s=t_s,
            phase="ended" if ended_because and phase != "homing" else phase,
            paused=waits,
            mode=MODE_MEANS[status.mode],
            x_m=here.x_m,
            y_m=here.y_m,
            z_m=here.z_m,
            yaw_rad=here.yaw_rad,
            # Of the world, for all of them.
            frame=(0.0, 0.0, 0.0, 0.0),
            d_m=None if measurement is None else measurement.d_m,
            margin_m=control.margin_m,
            h_m=None if measurement is None else measurement.h_m,
            height_m=flight.navigator.height_m,
            target_m=None if status.target is None else (status.target.x_m, status.target.y_m, here.z_m),
            battery_percent=flight.battery.told_percent,
            home_m=None if home is None else home.length_m,
            home_s=None if home is None else home.time_s,
            left_at_home_percent=flight.reserve.left_percent,
            reserve_percent=self._settings.mission.reserve_percent,
            completeness=completeness,
            frontiers=len(self._left),
            ended_because=ended_because,
        )

    def look_at_map(self) -> None:
        """Copy what has changed in map, way and graph. For the mission's thread."""
        flight = self._flight
        newest = flight.map.revision
        piece = flight.map.piece(flight.map.changed(self._revision))
        log = flight.log
        places = np.stack([log.column(f"estimated_{axis}_m")[self._ticks :] for axis in "xyz"], axis=1)
        graph = graph_lines([flight.navigator.graph.snapshot()])
        left: list[Place] = [(one.x_m, one.y_m, one.z_m) for one in flight.navigator.left_out(flight.estimated)]
        with self._lock:
            self._copy.put(piece)
            for x_m, y_m, z_m in places.tolist():
                if not self._way_m or np.linalg.norm(np.subtract((x_m, y_m, z_m), self._way_m[-1])) >= _STEP_M:
                    self._way_m.append((x_m, y_m, z_m))
            self._graph, self._left = graph, left
        self._revision, self._ticks = newest, len(log)


class WatchedSimulation:
    """A simulated mission; a `companion.ground.station.Station`.

    Args:
        simulation: the mission.
        name: of the mission.
        now_s: monotonic time.
    """

    def __init__(self, simulation: Simulation, name: str, now_s: Callable[[], float] = time.perf_counter) -> None:
        self._simulation = simulation
        self._now_s = now_s
        self._next_s = self._next_map_s = -float("inf")
        self._vehicles = [WatchedVehicle(flight, simulation.settings, name) for flight in simulation.flights]

    def vehicles(self) -> Sequence[WatchedVehicle]:
        """All of the mission."""
        return self._vehicles

    def look(self, *, now: bool = False) -> None:
        """Take what there is to see when it is time for that, or now. For the mission's thread."""
        if not now and self._now_s() < self._next_s:
            return
        if now or self._now_s() >= self._next_map_s:
            for vehicle in self._vehicles:
                vehicle.look_at_map()
            self._next_map_s = self._now_s() + MAP_PERIOD_S
        simulation = self._simulation
        for vehicle in self._vehicles:
            vehicle.look(simulation.t_s, simulation.completeness, simulation.ended_because)
        self._next_s = self._now_s() + LOOK_PERIOD_S
