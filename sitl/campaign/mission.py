"""One mission of a campaign: what it is made of, and the row that it leaves."""

from __future__ import annotations

import math
import threading
import traceback
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.config.settings import Settings
from sitl.mines import load_world
from sitl.sim.simulation import Simulation

Row = dict[str, object]
"""Names of figures and their values, as JSON holds them: None where something is not known."""

SLOW_MPS = 0.1
"""Below this a vehicle stands, or turns on the spot."""

FAILED = "failed"
"""Why a mission has ended that raised an error, or whose processes died."""

_ONE_A_PROCESS = threading.Lock()
"""Open3D and compiled functions use threads of their own: a process with several, as Dask has, flies one at a time."""


@dataclass(frozen=True, slots=True)
class Mission:
    """Everything that decides how a mission goes: flown anywhere, in any order, it leaves the same row.

    Attributes:
        number: its place in the campaign, from 0.
        world: as for ``companion sim --world``.
        start: x, y, z in m and yaw in rad, or None for the world's own.
        seed: draws start, noise and every choice.
        preset: name of the preset below all settings.
        case: name of the case that it belongs to; empty where there are none.
        values: full names of the settings that the campaign changes, and their values here.
        settings_json: all settings.
        vehicles: how many fly.
        time_limit_s: simulated time.
    """

    number: int
    world: str
    start: tuple[float, float, float, float] | None
    seed: int
    preset: str
    case: str
    values: Mapping[str, object]
    settings_json: str
    vehicles: int
    time_limit_s: float

    @property
    def settings(self) -> Settings:
        """All settings."""
        return Settings.model_validate_json(self.settings_json, strict=True)

    def given(self) -> Row:
        """The columns that say which mission it was; those of settings have their full names."""
        return {
            "mission": self.number,
            "given_world": self.world,
            "world": self.world,
            "seed": self.seed,
            "preset": self.preset,
            "case": self.case,
            "vehicles": self.vehicles,
            "time_limit_s": self.time_limit_s,
            **{name: plain(value) for name, value in self.values.items()},
        }


def fly(mission: Mission) -> Row:
    """Fly a mission and return its figures; one that raises is told as one that failed, with its error.

    Raises:
        KeyboardInterrupt: it was interrupted, and has no result.
    """
    try:
        with _ONE_A_PROCESS:
            world = load_world(mission.world, mission.seed, mission.start)
            simulation = Simulation(world, mission.settings, mission.seed, mission.vehicles)
            simulation.run(mission.time_limit_s)
            found = figures(simulation)
    except Exception as error:  # noqa: BLE001 - one bad mission must not end the thousand others
        return failure(f"{type(error).__name__}: {error}", traceback.format_exc())
    if simulation.ended_because == "stopped by the user":
        raise KeyboardInterrupt
    return found


def figures(simulation: Simulation) -> Row:
    """What `Simulation.score` says of a mission that has ended, and how fast and how near to walls it flew."""
    score = simulation.score()  # fills in the true distances of the logs
    speeds_mps = np.concatenate([np.abs(flight.log.column("speed_mps")) for flight in simulation.flights])
    true_d_m = np.concatenate([flight.log.column("true_d_m") for flight in simulation.flights])
    near = true_d_m[np.isfinite(true_d_m)] < simulation.settings.control.critical_margin_m
    return {
        **{name: plain(value) for name, value in score.items()},
        "speed_mps": _mean(speeds_mps, 3),
        "slow_share": _mean(speeds_mps < SLOW_MPS, 3),
        "in_d_c_share": _mean(near, 5),
        "critical_margin_m": simulation.settings.control.critical_margin_m,
        "error": None,
        "error_details": None,
    }


def failure(error: str, details: str | None = None) -> Row:
    """The figures of a mission that has none."""
    return {"ended_because": FAILED, "error": error, "error_details": details}


def plain(value: object) -> object:
    """The value as JSON holds it: what is not finite is not known."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Mapping):
        return {str(name): plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _mean(values: NDArray[np.float64] | NDArray[np.bool_], digits: int) -> float | None:
    return round(float(np.mean(values)), digits) if values.size else None
