"""One mission flown, and its figures: what a worker does."""

from __future__ import annotations

import threading
import traceback

import numpy as np
from numpy.typing import NDArray

from sitl.campaign.mission import Mission, Row, failure, plain
from sitl.campaign.software import software
from sitl.mines import load_world
from sitl.sim.simulation import Simulation

SLOW_MPS = 0.1
"""Below this a vehicle stands, or turns on the spot."""

_ONE_A_PROCESS = threading.Lock()
"""Open3D and compiled functions use threads of their own: a process with several, as Dask has, flies one at a time."""


def fly(mission: Mission) -> Row:
    """Fly a mission and return its figures; one that raises is told as one that failed, with its error."""
    try:
        with _ONE_A_PROCESS:
            world = load_world(mission.world, mission.seed, mission.site.start, mission.site.reading)
            simulation = Simulation(world, mission.settings, mission.seed, mission.vehicles)
            simulation.run(mission.time_limit_s)
            simulation.come_home()
            return figures(simulation)
    except Exception as error:  # noqa: BLE001 - one bad mission must not end the thousand others
        return failure(f"{type(error).__name__}: {error}", traceback.format_exc())


def figures(simulation: Simulation) -> Row:
    """What `Simulation.score` says of a mission that has ended, and how fast and how near to walls it flew.

    ``estimate_error`` is how much too high the vehicle's own estimate of its completeness was.
    """
    score = simulation.score()
    explored = list(zip(simulation.flights, simulation.explored.ticks, strict=True))
    speeds_mps = np.concatenate([np.abs(flight.log.column("speed_mps")[:ticks]) for flight, ticks in explored])
    true_d_m = np.concatenate([flight.log.column("true_d_m")[:ticks] for flight, ticks in explored])
    near = true_d_m[np.isfinite(true_d_m)] < simulation.settings.control.critical_margin_m
    return {
        **{name: plain(value) for name, value in score.items() if name != "home"},
        "speed_mps": _mean(speeds_mps, 3),
        "slow_share": _mean(speeds_mps < SLOW_MPS, 3),
        "in_d_c_share": _mean(near, 5),
        "estimate_error": None
        if simulation.estimated_completeness is None
        else round(simulation.estimated_completeness - simulation.completeness, 5),
        "critical_margin_m": simulation.settings.control.critical_margin_m,
        **_home(score["home"]),
        "software": software(),
        "error": None,
        "error_details": None,
    }


def _home(ways: object) -> Row:
    """Of the way home that ended furthest from home, its figures, each as a column of its own."""
    assert isinstance(ways, list)  # noqa: S101 - the score holds values of all types
    worst: Row = max(ways, key=lambda way: (not way["arrived"], way.get("off_m") or 0.0), default={})
    return {f"home_{name}": plain(value) for name, value in worst.items()}


def _mean(values: NDArray[np.float64] | NDArray[np.bool_], digits: int) -> float | None:
    return round(float(np.mean(values)), digits) if values.size else None
