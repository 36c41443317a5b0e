"""What one control tick costs: observation to setpoint, with a fresh depth frame in it, on one core.

python -m bench.flight.tick
"""

from __future__ import annotations

import time

import numpy as np

from bench.common import Row, parser, quantiles, show, with_camera
from companion.config.load import load_settings
from companion.config.settings import Settings
from companion.control.navigator import Navigator
from companion.model import Observation
from companion.perception import Extractor
from sitl.mines import load_world
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer
from sitl.scene.sensors import SensorRig
from sitl.sim.start import start_poses
from sitl.sim.vehicle import Vehicle

TICKS = 2000
SIZES = ((160, 120), (320, 240), (640, 480))


def observations(settings: Settings, ticks: int) -> list[Observation]:
    """A real flight's observations, so that walls, turns and dropouts are in them."""
    world = load_world("complex", 1)
    caster = RayCaster(world)
    rng = np.random.default_rng(1)
    start = start_poses(world, caster, settings, 1, rng)[0]
    vehicle = Vehicle(settings.sim.dynamics, start, rng)
    renderer = DepthRenderer(world, settings.sensors.camera.model())
    rig = SensorRig(settings.sensors, settings.sim.noise, caster, renderer, rng)
    extractor = Extractor(settings.sensors, settings.vehicle, settings.control.height_m)
    navigator = Navigator(settings.control, rng)
    seen = []
    for _ in range(ticks):
        observation = rig.observe(vehicle.pose)
        seen.append(observation)
        measurement = extractor.measure(observation)
        vehicle.command(navigator.step(measurement, observation.pose, observation.t_s))
        vehicle.step(settings.control.period_s)
    return seen


def cost(width_px: int, height_px: int) -> Row:
    """Milliseconds a tick, over all ticks and over those that hold a frame."""
    settings = with_camera(load_settings(None, "flight"), width_px=width_px, height_px=height_px)
    seen = observations(settings, TICKS if width_px < 640 else TICKS // 4)
    extractor = Extractor(settings.sensors, settings.vehicle, settings.control.height_m)
    navigator = Navigator(settings.control, np.random.default_rng(1))
    every, with_frame = [], []
    for observation in seen:
        began = time.perf_counter()
        measurement = extractor.measure(observation)
        navigator.step(measurement, observation.pose, observation.t_s)
        took_ms = (time.perf_counter() - began) * 1e3
        every.append(took_ms)
        if observation.frame is not None:
            with_frame.append(took_ms)
    return {
        "camera": f"{width_px} x {height_px}",
        "ticks": len(every),
        **quantiles("all", every),
        **quantiles("with frame", with_frame),
        "worst, ms": max(every),
    }


def main() -> None:
    """Print the table."""
    arguments = parser(__doc__).parse_args()
    rows = [cost(*size) for size in SIZES]
    show(rows, list(rows[0]), arguments.json)


if __name__ == "__main__":
    main()
