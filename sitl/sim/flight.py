"""One simulated vehicle with everything that flies it: the same tick as on the real one."""

from __future__ import annotations

import math

import numpy as np

from companion.config.settings import Settings
from companion.control.fleet import Report
from companion.control.homing.homing import WayHome
from companion.control.homing.reserve import Reserve
from companion.control.sharing import Frame, Sharing
from companion.mapping import VoxelMap
from companion.model import Measurement, Pose
from companion.pipeline import Explorer, Order, fleet_of
from sitl.mines import World
from sitl.scene.live import LiveWorld
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer
from sitl.scene.sensors import SensorRig
from sitl.sim.battery import Battery
from sitl.sim.earlier import Earlier
from sitl.sim.flight_log import FlightLog
from sitl.sim.vehicle import Vehicle

RECKONING_PERIOD_S = 2.0
"""Time between two looks at what will be left of the battery at home."""


class Flight:
    """A vehicle, its sensors, its navigator and its map.

    Args:
        vehicle_id: its number in the fleet, from 1.
        world: the mine.
        caster: rays in the mine, which may be shared by vehicles.
        settings: the whole configuration.
        start: the true pose at time 0.
        seed: draws everything that is random in this flight.
        live: what happens in the mine, which may be shared by vehicles; made here where there is none.
        earlier: what earlier sorties have left to it; None: it begins anew.

    Raises:
        ValueError: it cannot go on from that: cells or voxels are of another size.
    """

    def __init__(
        self,
        vehicle_id: int,
        world: World,
        caster: RayCaster,
        settings: Settings,
        start: Pose,
        seed: np.random.SeedSequence,
        live: LiveWorld | None = None,
        earlier: Earlier | None = None,
    ) -> None:
        to_vehicle, to_sensors, to_navigator = seed.spawn(3)
        camera = settings.sensors.camera.model()
        self._live = LiveWorld(world, caster, camera) if live is None else live
        self.vehicle = Vehicle(settings.sim.dynamics, start, np.random.default_rng(to_vehicle), self._live.wind_mps)
        self._explorer = Explorer(settings, np.random.default_rng(to_navigator))
        self.navigator = self._explorer.navigator
        self.order = Order.EXPLORE
        """What it is told to do."""
        self.map = VoxelMap(settings.mapping)
        if earlier is not None:
            self.navigator.known_ground.go_on_from(earlier.ground)
            self.map.merge(earlier.voxels)
        self.log = FlightLog(vehicle_id)
        self.battery = Battery(settings.sim.battery)
        self.reserve = Reserve(settings.turning_percent)
        self.fleet, self._separation = fleet_of(settings, vehicle_id)
        self.sharing = Sharing(vehicle_id, Frame(), self.navigator.known_ground, self.navigator.choice)
        self.measurement: Measurement | None = None
        self.estimated = start
        """Where it takes itself to be."""
        self.extended_s: list[float] = []
        """When the law helped itself where the paper's has no rule."""
        self.touched = False
        self.blind_s = 0.0
        """Time since all inputs were last fresh."""
        self._rig = SensorRig(
            settings.sensors,
            settings.sim.noise,
            caster,
            DepthRenderer(world, camera),
            np.random.default_rng(to_sensors),
            self._live,
            vehicle_id,
        )
        self._body_radius_m = settings.vehicle.body_radius_m
        self._free_until_path_m = 0.0
        self._next_reckoning_s = -math.inf

    def tick(self, dt_s: float, fleet: bool) -> None:
        """One sampling period: observe, measure, step the navigator, send the setpoint, fly on.

        Args:
            dt_s: the sampling period.
            fleet: whether other vehicles are about, so that (11) applies.
        """
        true = self.vehicle.pose
        self._live.look(true, self.log.vehicle_id)
        observation = self._rig.observe(true)
        clearance = self._separation.clearance(true.t_s) if fleet else None
        order = self.order
        if clearance is not None:
            self.navigator.height_m = clearance.height_m
            order = Order.WAIT if clearance.holds else order
        steering = self._explorer.step(observation, order, self._separation.beneath() if fleet else ())
        measurement, setpoint = steering.measurement, steering.setpoint
        if clearance is not None:
            setpoint = self._explorer.apart(setpoint, clearance, observation.pose.yaw_rad)
        if observation.frame is not None:
            self.map.integrate(observation.frame)
        self.log.append(
            true, observation.pose, measurement, self.navigator.status.mode, setpoint, self.vehicle.forward_mps
        )
        if self.navigator.status.extensions > len(self.extended_s):
            self.extended_s.append(true.t_s)
        self.measurement = measurement
        self.estimated = observation.pose
        self.blind_s = self.blind_s + dt_s if measurement.missing else 0.0
        self.vehicle.command(setpoint)
        self.vehicle.step(dt_s)
        self.battery.step(dt_s)
        self._reckon(true.t_s)
        self._check_contact()

    def way_home(self, anew: bool = False) -> WayHome | None:
        """How far it takes home to be, as of the last ten seconds or of now; None while it knows no way."""
        return None if self.measurement is None else self.navigator.way_home(self.measurement, self.estimated, anew)

    def home_pose(self) -> Pose:
        """Where it takes itself to be on its way home."""
        return self.navigator.homing.pose(self.estimated)

    def _reckon(self, t_s: float) -> None:
        percent = self.battery.told_percent
        if percent is None or t_s < self._next_reckoning_s:
            return
        self._next_reckoning_s = t_s + RECKONING_PERIOD_S
        # Nobody turns back for a way that has become shorter meanwhile.
        for anew in (False, True) if self.navigator.homing.homeward is None else (False,):
            way = self.way_home(anew)
            self.reserve.update(t_s, percent, None if way is None else way.time_s)
            if not self.reserve.is_due:
                break

    def report(self) -> Report:
        """Where the vehicle tells the others that it is."""
        pose, measured = self.estimated, self.measurement
        at_m = (pose.x_m, pose.y_m, pose.z_m)
        return self._separation.report(pose.t_s, at_m, None if measured is None else measured.h_m)

    def _check_contact(self) -> None:
        # A body that was D clear cannot touch before it has flown D: most ticks need no query.
        pose = self.vehicle.pose
        if self.vehicle.path_m < self._free_until_path_m and not self._live.is_moving(pose.t_s):
            return
        place_m = np.array([[pose.x_m, pose.y_m, pose.z_m]])
        distance_m = float(self._live.distance(np.array([pose.t_s]), place_m)[0])
        clear_m = distance_m - self._body_radius_m
        self.touched = self.touched or not math.isfinite(clear_m) or clear_m <= 0.0
        self._free_until_path_m = self.vehicle.path_m + max(clear_m, 0.0)
