"""A mission in the simulated mine, as fast as the machine allows."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from companion.config.settings import Settings
from companion.control.graph import Counts
from companion.control.left_out import LeftOut
from companion.control.navigator import Status
from companion.mapping import VoxelMap
from companion.pipeline import spacing
from companion.safety_case.passages import passages
from sitl.mines import World
from sitl.scene.fellows import Body
from sitl.scene.live import LiveWorld
from sitl.scene.raycast import RayCaster
from sitl.scene.visibility import Say, Truth, accuracy_m, precision, silent
from sitl.sim.coming_home import ComingHome
from sitl.sim.earlier import Earlier
from sitl.sim.encounters import Encounters
from sitl.sim.flight import Flight
from sitl.sim.judgement import Judgement, merged_map
from sitl.sim.start import check_room, remarks_on_start, start_poses

COMPLETE_SHARE = 0.99
"""The map counts as complete when this share of what is visible is in it (METHOD: t_f)."""

ENDED_WELL = ("complete", "done")
"""Why a mission has ended that came to the end which `sim.ends` asks for, by the truth or by the vehicle's word."""

CAN_COME_HOME = (*ENDED_WELL, "time limit", "battery needed for the way home")
"""Why an exploring has ended from which a vehicle can come home."""

CHECK_PERIOD_S = 5.0
"""Simulated time between two looks at the completeness."""

SHARING_PERIOD_S = 2.0
"""Simulated time between two messages in which vehicles tell each other of the ground."""

SURFACE_STEP_M = 0.25
"""Grid of the traveling surface: drifts that are 0.4 m wider than twice d_s are still found passable on it."""

SCORED_PERIOD_S = 0.1
"""The true distance to the walls is taken this often: every 5 cm of the way at 0.5 m/s."""

VERSIONS = ("mine-companion", "numpy", "numba", "open3d-cpu", "open3d")


@dataclass(frozen=True, slots=True)
class Progress:
    """How a mission stands."""

    t_s: float
    completeness: float
    flights: tuple[Flight, ...]


@dataclass(frozen=True, slots=True)
class Explored:
    """How far the exploring went: until when, how far in sum, how many rows of each log, and what each law has done."""

    t_s: float
    path_m: float
    ticks: tuple[int, ...]
    states: tuple[Status, ...]


class Simulation:
    """One mission: a world, one or several vehicles, an end.

    Args:
        world: the mine.
        settings: the whole configuration.
        seed: draws start, sensors, noise and the choices of every vehicle.
        vehicles: how many fly.
        say: hears how far the preparation is.
        earlier: what earlier sorties have left to each of them; None: they begin anew.

    Raises:
        InputError: the start is inside a wall, there is no room for the vehicles to start, or the mine is too large.
        ValueError: they cannot go on from what is left: cells or voxels are of another size.
    """

    def __init__(
        self,
        world: World,
        settings: Settings,
        seed: int,
        vehicles: int = 1,
        say: Say = silent,
        earlier: Earlier | None = None,
    ) -> None:
        self.world = world
        self.settings = settings
        self.seed = seed
        self.caster = RayCaster(world)
        to_start, *to_flights = np.random.SeedSequence(seed).spawn(1 + vehicles)
        starts = start_poses(world, self.caster, settings, vehicles, np.random.default_rng(to_start))
        self.remarks = (*world.remarks, *remarks_on_start(world, self.caster))
        """What people should know of the mine before the vehicle flies."""
        first = starts[0]
        check_room(world, self.caster, first, settings)
        self.truth = Truth.of(
            world,
            self.caster,
            (first.x_m, first.y_m, first.z_m),
            settings.control.height_m,
            settings.control.margin_m,
            settings.mapping.voxel_m,
            settings.mapping.max_range_m,
            step_m=SURFACE_STEP_M,
            start_margin_m=settings.control.critical_margin_m,
            # Roofs that the camera never looks up to would leave every map of a high mine incomplete for ever.
            elevations_rad=settings.sensors.camera.elevations_rad(),
            say=say,
        )
        self._body = Body(settings.vehicle.body_radius_m, settings.vehicle.body_height_m)
        self._live = LiveWorld(
            world, self.caster, settings.sensors.camera.model(), self._body if vehicles > 1 else None
        )
        self.flights = tuple(
            Flight(number, world, self.caster, settings, start, flight_seed, self._live, earlier)
            for number, (start, flight_seed) in enumerate(zip(starts, to_flights, strict=True), start=1)
        )
        self.t_s = 0.0
        self.completed_at_s: float | None = None
        self.ended_because = ""
        self.wall_time_s = 0.0
        self.completeness = 0.0
        self.progress: list[tuple[float, float]] = []
        self.encounters = Encounters(self._body, spacing(settings))
        """What came of vehicles that met."""
        self.judgement = Judgement(self.flights, settings)
        self.completeness_when_done: float | None = None
        self.estimated_completeness: float | None = None
        """What the vehicles take their map for at the end of `run`; None before."""
        self.left_out: tuple[LeftOut, ...] = ()
        """What they have seen the beginning of and not looked into, at the end of `run`."""
        self.coming_home: tuple[ComingHome, ...] = ()
        """The ways home, once they are flown."""
        self._starts = starts
        self._explored: Explored | None = None
        self._found = np.zeros(len(self.truth.samples_m), np.bool_)
        self._next_check_s = 0.0
        self._next_sharing_s = 0.0

    def run(
        self,
        time_limit_s: float,
        show: Callable[[Progress], None] | None = None,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Fly until the end that `sim.ends` names, or a contact, or long without inputs, or until the time is up.

        Args:
            time_limit_s: simulated time, in s.
            show: called at every look at the completeness.
            stop: asked before every tick: whether the user wants the end.
        """
        began = time.perf_counter()
        dt_s = self.settings.control.period_s
        while not self.ended_because:
            if self.t_s >= self._next_check_s:
                self._check()
                if show is not None:
                    show(Progress(self.t_s, self.completeness, self.flights))
                self.ended_because = self._end()
                if self.ended_because:
                    break
            if stop():
                self.ended_because = "stopped by the user"
                break
            self._tick(dt_s)
            if any(flight.touched for flight in self.flights):
                self.ended_because = "contact"
            elif self.encounters.collisions:
                self.ended_because = "collision"
            elif any(flight.blind_s > self.settings.mission.input_timeout_s for flight in self.flights):
                # As in a real flight: over a hole without ground it would hover until something pushes it.
                self.ended_because = "inputs lost"
            elif any(flight.battery.is_empty for flight in self.flights):
                self.ended_because = "battery empty"
            elif any(flight.reserve.is_due for flight in self.flights):
                self.ended_because = "battery needed for the way home"
            elif self.t_s >= time_limit_s:
                self.ended_because = "time limit"
        self._explored = self.explored
        self.wall_time_s = time.perf_counter() - began
        self._measure_true_distances()
        self.completeness = self._exact_completeness()
        self.progress.append((self.t_s, self.completeness))
        self.estimated_completeness = self.judgement.completeness(self.t_s)
        self.left_out = self.judgement.left_out(self.t_s)

    def come_home(
        self, show: Callable[[Progress], None] | None = None, stop: Callable[[], bool] = lambda: False
    ) -> None:
        """After `run`, fly every vehicle home, where `mission.end_action` says so and nothing has failed.

        Args:
            show: called every `CHECK_PERIOD_S` of simulated time.
            stop: asked before every tick: whether the user wants the end.
        """
        if self.settings.mission.end_action != "home" or self.ended_because not in CAN_COME_HOME:
            return
        ways = [ComingHome(*one, self.settings) for one in zip(self.flights, self._starts, strict=True)]
        self.coming_home = tuple(ways)
        next_show_s = self.t_s
        while sum(way.look() for way in ways) < len(ways):
            if show is not None and self.t_s >= next_show_s:
                next_show_s = self.t_s + CHECK_PERIOD_S
                show(Progress(self.t_s, self.completeness, self.flights))
            why = "stopped by the user" if stop() else "collision" if self.encounters.collisions else ""
            if why:
                for way in ways:
                    way.stop(why)
                break
            self._tick(self.settings.control.period_s)
        self._measure_true_distances()

    def _end(self) -> str:
        """Why the mission ends by itself now; empty when it goes on."""
        done = self.judgement.look(self.t_s)
        if done and self.completeness_when_done is None:
            self.completeness_when_done = self._exact_completeness()
        if self.settings.sim.ends == "done":
            return "done" if done else ""
        return "complete" if self.completed_at_s is not None else ""

    @property
    def explored(self) -> Explored:
        """The exploring, without the way home; so far, while it goes on."""
        if self._explored is not None:
            return self._explored
        flights = self.flights
        return Explored(
            t_s=self.t_s,
            path_m=sum(flight.vehicle.path_m for flight in flights),
            ticks=tuple(len(flight.log) for flight in flights),
            states=tuple(flight.navigator.status for flight in flights),
        )

    def merged_map(self) -> VoxelMap:
        """V: the union of what every vehicle has mapped (paper eq. (5))."""
        return merged_map(self.flights, self.settings.mapping)

    def score(self) -> dict[str, object]:
        """The figures of `summary.json`, of what has been flown by the end of `run` and of `come_home`."""
        voxels = self.merged_map()
        occupied = voxels.occupied()
        off_m = self.caster.distance(occupied) if len(occupied) else np.zeros(0)
        explored = self.explored
        every = self._scored_every
        parts = [
            np.split(flight.log.column("true_d_m")[::every], [math.ceil(ticks / every)])
            for flight, ticks in zip(self.flights, explored.ticks, strict=True)
        ]
        true_d = np.concatenate([exploring for exploring, _ in parts])
        margin_m = self.settings.control.margin_m
        states = explored.states
        extended_s = [flight.extended_s[: state.extensions] for flight, state in zip(self.flights, states, strict=True)]
        gaps = [gap for times_s in extended_s for gap in np.diff(times_s)]
        graphs = [flight.navigator.graph.snapshot().counts() for flight in self.flights]
        sim_time_s = round(explored.t_s, 3)
        return {
            "world": self.world.name,
            "origin_m": list(self.world.origin_m),
            "remarks": list(self.remarks),
            "seed": self.seed,
            "vehicles": len(self.flights),
            "completeness": _rounded(self.completeness, 5),
            "precision": _rounded(precision(off_m, voxels.voxel_m), 5),
            "accuracy_m": _rounded(accuracy_m(off_m), 4),
            "completed_at_s": None if self.completed_at_s is None else round(self.completed_at_s, 2),
            "estimated_completeness": _rounded(_or_nan(self.estimated_completeness), 5),
            "done_at_s": _rounded(_or_nan(self.judgement.done_at_s), 2),
            "completeness_when_done": _rounded(_or_nan(self.completeness_when_done), 5),
            "left_out": [place.as_json() for place in self.left_out],
            "sim_time_s": sim_time_s,
            "wall_time_s": round(self.wall_time_s, 2),
            "times_real_time": round(sim_time_s / self.wall_time_s, 2) if self.wall_time_s > 0.0 else None,
            "path_length_m": round(explored.path_m, 2),
            "contacts": sum(flight.touched for flight in self.flights),
            "least_d_m": _rounded(float(np.min(true_d, initial=math.inf)), 3),
            "least_clearance_m": _rounded(min(map(self._least_clearance_m, self.flights), default=math.inf), 3),
            "time_below_d_s_fraction": _rounded(_mean(true_d < margin_m), 5),
            "time_below_d_s_minus_15cm_fraction": _rounded(_mean(true_d < margin_m - 0.15), 5),
            "least_distance_between_vehicles_m": _rounded(self.encounters.least_apart_m, 3),
            "vehicles_too_near_s": round(self.encounters.too_near_s, 2),
            "collisions": self.encounters.collisions,
            "mode_changes": sum(state.mode_changes for state in states),
            "draws": sum(state.draws for state in states),
            "draws_accepted": sum(state.accepted for state in states),
            "graph": {name: sum(getattr(counts, name) for counts in graphs) for name in Counts._fields},
            "extensions": sum(state.extensions for state in states),
            "least_time_between_extensions_s": _rounded(min(gaps, default=math.inf), 1),
            "occupied_voxels": len(occupied),
            "voxel_m": voxels.voxel_m,
            "visible_share_of_surface": _rounded(self.truth.area_share_visible, 4),
            "camera": f"{self.settings.sensors.camera.width_px} x {self.settings.sensors.camera.height_px} at "
            f"{self.settings.sensors.camera.rate_hz:g} Hz",
            "ended_because": self.ended_because,
            "home": [
                way.score() | {"least_d_m": _rounded(float(np.min(d_m, initial=math.inf)), 3)}
                for way, (_, d_m) in zip(self.coming_home, parts, strict=False)
            ],
            "passages": asdict(passages(self.settings)),
            "versions": _versions(),
        }

    def missed_m(self) -> NDArray[np.float32]:
        """The (n, 3) visible points of the true surface that are not in the map, as of the end of `run`."""
        missed: NDArray[np.float32] = self.truth.samples_m[~self._found]
        return missed

    def _tick(self, dt_s: float) -> None:
        several = len(self.flights) > 1
        if several:
            self._exchange(dt_s)
        for flight in self.flights:
            flight.tick(dt_s, fleet=several)
        self.t_s = self.flights[0].vehicle.pose.t_s

    def _exchange(self, dt_s: float) -> None:
        """Every vehicle gets the reports of all others, and how near they truly are is watched."""
        reports = [(flight.log.vehicle_id, flight.report()) for flight in self.flights]
        for flight in self.flights:
            for number, report in reports:
                flight.fleet.on_report(number, report)
        if self.t_s >= self._next_sharing_s:
            self._next_sharing_s = self.t_s + SHARING_PERIOD_S - 1e-6
            self._share()
        self.encounters.look([flight.vehicle.pose for flight in self.flights], dt_s)

    def _share(self) -> None:
        """Every vehicle hears what the others know of the ground, and where they are going."""
        for flight in self.flights:
            news, claim = flight.sharing.news(), flight.sharing.claim(self.t_s)
            for other in self.flights:
                if other is flight:
                    continue
                if news is not None:
                    other.sharing.learn(news)
                other.sharing.on_claim(flight.log.vehicle_id, claim, self.t_s)
        for flight in self.flights:
            flight.sharing.look(self.t_s)

    def _check(self) -> None:
        """Look at the completeness: only at what had not been found, until that says it is complete."""
        self._next_check_s = self.t_s + CHECK_PERIOD_S - 1e-6
        for flight in self.flights:
            open_points = np.flatnonzero(~self._found)
            self._found[open_points] = flight.map.occupied_near(self.truth.samples_m[open_points])
        self.completeness = self._found_share()
        if self.completeness >= COMPLETE_SHARE and self.completed_at_s is None:
            # A voxel that was occupied may have been carved away since: what counts is the map as it is.
            self.completeness = self._exact_completeness()
            if self.completeness >= COMPLETE_SHARE:
                self.completed_at_s = self.t_s
        self.progress.append((self.t_s, self.completeness))

    def _exact_completeness(self) -> float:
        self._found = self.merged_map().occupied_near(self.truth.samples_m)
        return self._found_share()

    def _found_share(self) -> float:
        """Share of the visible surface, by area: a voxel that a slanted wall only grazes holds little of it."""
        areas = self.truth.sample_areas_m2.astype(np.float64)
        return float(areas[self._found].sum() / areas.sum()) if areas.size else 0.0

    def _least_clearance_m(self, flight: Flight) -> float:
        """Between the body, the ball of its radius, and any rock, above and below too: a contact is where this is 0."""
        if len(flight.log.positions_m) == 0:
            return math.inf
        pose = flight.vehicle.pose
        places_m = np.vstack([flight.log.positions_m, [pose.x_m, pose.y_m, pose.z_m]])
        times_s = np.append(flight.log.column("t_s"), pose.t_s)
        return float(self._live.distance(times_s, places_m).min()) - self.settings.vehicle.body_radius_m

    @property
    def _scored_every(self) -> int:
        """Of how many ticks one has its true distance taken."""
        return max(1, round(SCORED_PERIOD_S / self.settings.control.period_s))

    def _measure_true_distances(self) -> None:
        """Fill in, where it is not yet, the true least horizontal distance from the centre to the walls.

        Over the height of the body.
        """
        half_height_m = self.settings.vehicle.body_height_m / 2.0
        for flight in self.flights:
            scored = slice(None, None, self._scored_every)
            true_d_m = flight.log.column("true_d_m")[scored]
            new = np.isnan(true_d_m)
            true_d_m[new] = self._live.horizontal_clearance(
                flight.log.column("t_s")[scored][new], flight.log.positions_m[scored][new], half_height_m
            )


def _mean(values: NDArray[np.bool_]) -> float:
    return float(np.mean(values)) if values.size else math.nan


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _rounded(value: float, digits: int) -> float | None:
    return round(value, digits) if math.isfinite(value) else None


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in VERSIONS:
        try:
            found[name] = version(name)
        except ModuleNotFoundError:  # PackageNotFoundError: of open3d's two names only one is installed
            continue
    return found
