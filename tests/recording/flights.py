"""Small flights to record: made by hand, and flown by the real tick in a simulated room."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from companion.config.mission import RecordSettings
from companion.config.sensors import CameraSettings, PlanarSettings, SensorSettings
from companion.config.settings import Settings
from companion.mapping.files.ground_file import ground_of_content
from companion.model import (
    HIT,
    Beam,
    Camera,
    DepthFrame,
    Measurement,
    Mode,
    Observation,
    Pose,
    RangeReading,
    Scan,
    Setpoint,
)
from companion.pipeline import Explorer, Order, Tick
from companion.recording import FlightInfo, Recorder
from sitl.mines import load_world
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer
from sitl.scene.sensors import SensorRig
from sitl.sim.vehicle import Vehicle
from tests.shared.clocks import HandClock

SETTINGS = Settings(
    sensors=SensorSettings(
        camera=CameraSettings(width_px=64, height_px=48), planar=PlanarSettings(enabled=True, rays=90)
    )
)
CAMERA = SETTINGS.sensors.camera.model()
BINS = 90


def make_info(settings: Settings = SETTINGS, seed: int = 1) -> FlightInfo:
    return FlightInfo.of(settings, np.random.default_rng(seed))


def make_scan() -> Scan:
    bearings = -math.pi + (np.arange(BINS) + 0.5) * 2.0 * math.pi / BINS
    return Scan(bearings, np.full(BINS, 2.0), np.full(BINS, HIT, np.uint8), np.ones(BINS, np.bool_))


def make_frame(t_s: float, camera: Camera = CAMERA) -> DepthFrame:
    depth = np.random.default_rng(round(t_s * 1000)).uniform(0.3, 9.0, (camera.height_px, camera.width_px))
    depth[0, :3] = np.nan, np.inf, 0.0
    return DepthFrame(t_s, depth.astype(np.float32), camera, Pose(t_s, 1.0, 2.0, 1.5, 0.1))


def make_tick(
    t_s: float,
    *,
    frame: DepthFrame | None = None,
    mode: Mode = Mode.BOUNDARY,
    sent: bool = True,
    d_m: float | None = 1.0,
    duration_s: float = 0.002,
) -> Tick:
    """A tick at ``t_s`` whose depth is 0.1 s old, pose 0.02 s and height 0.05 s."""
    reading = RangeReading(Beam.DOWN, t_s - 0.05, 1.5, 8.0)
    return Tick(
        t_s=t_s,
        observation=Observation(t_s, Pose(t_s - 0.02, 1.0, 2.0, 1.5, 0.1, 0.02, -0.03), frame, (reading,)),
        measurement=Measurement(t_s, 0.1, make_scan(), 1.5, None, None, d_m, 0.3, d_m, -0.1, 2.0, 0.05),
        setpoint=Setpoint(t_s, 0.4, 0.01, -0.2),
        mode=mode,
        sent=sent,
        height_m=1.5,
        duration_s=duration_s,
        stepped=True,
    )


def fly_in_room(
    file: Path,
    duration_s: float,
    seed: int = 1,
    record: RecordSettings | None = None,
    settings: Settings = SETTINGS,
    order: Callable[[float], Order] = lambda _: Order.EXPLORE,
    earlier: bytes = b"",
) -> Recorder:
    """A recorded flight in the simulated room: looks for one second, then flies as it is ordered to at each time.

    It goes on from the known ground of an ``earlier`` one, the content of its file.
    """
    to_vehicle, to_sensors, to_navigator = np.random.SeedSequence(seed).spawn(3)
    world = load_world("room", seed=seed)
    caster = RayCaster(world)
    rig = SensorRig(
        settings.sensors,
        settings.sim.noise,
        caster,
        DepthRenderer(world, settings.sensors.camera.model()),
        np.random.default_rng(to_sensors),
    )
    first = world.start_area_m[len(world.start_area_m) // 2]
    start = Pose(0.0, float(first[0]), float(first[1]), float(first[2]) + settings.control.height_m, 0.3)
    vehicle = Vehicle(settings.sim.dynamics, start, np.random.default_rng(to_vehicle))
    rng = np.random.default_rng(to_navigator)
    info = replace(FlightInfo.of(settings, rng), known_ground=earlier)
    explorer = Explorer(settings, rng)
    if earlier:
        explorer.navigator.known_ground.go_on_from(ground_of_content(earlier, "earlier"))
    clock = HandClock(0.0)
    with Recorder(file, record or RecordSettings(), info, clock) as recorder:
        for _ in range(round(duration_s / settings.control.period_s)):
            clock.time_s = vehicle.pose.t_s
            observation = rig.observe(vehicle.pose)
            exploring, told = clock.time_s >= 1.0, Order.EXPLORE
            setpoint: Setpoint | None = None
            if exploring:
                # As in a fleet, where (11) changes H while flying.
                explorer.navigator.height_m = 1.5 if clock.time_s < duration_s / 2.0 else 1.3
                told = order(clock.time_s)
                steering = explorer.step(observation, told)
                # As in flight, where it is asked now and then, and not at all when it is flown again.
                explorer.navigator.way_home(steering.measurement, observation.pose)
                measurement, setpoint = steering.measurement, steering.setpoint
                vehicle.command(setpoint)
            else:
                measurement = explorer.look(observation)
            status = explorer.navigator.status
            height_m = explorer.navigator.height_m
            record_tick = (clock.time_s, observation, measurement, setpoint, status.mode, exploring, height_m, 0.001)
            recorder.tick(Tick(*record_tick, stepped=exploring, order=told))
            vehicle.step(settings.control.period_s)
            while recorder.recording and recorder.waiting > 4:
                time.sleep(0.0005)  # much faster than real time, for which the queue is made
    return recorder
