"""One flight that comes home: over MAVLink, in real time, on the stub autopilot; and what truth says of it."""

from __future__ import annotations

import json
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.errors import CompanionError
from companion.recording.replay import replay
from sitl.launch.processes import Crew, FlightPlan
from tests.integration.rig import process
from tests.integration.whole import end_family
from validation.landed import not_in_time, off_start_m

AROUND_S = 300.0
"""Boot, checks, take-off, the way home, landing and the writing of the map, besides the time of the exploring."""


@dataclass(frozen=True, slots=True)
class Task:
    """What is to be flown.

    Attributes:
        personality: px4 or ardupilot.
        gps: False: by external odometry.
        world: as for `companion sim`.
        seed: draws everything.
        time_limit_s: of the exploring.
        battery_minutes: from full to empty.
    """

    personality: str
    gps: bool
    world: str
    seed: int
    time_limit_s: float
    battery_minutes: float

    @property
    def name(self) -> str:
        """For its folder."""
        return f"{self.personality}-{'gps' if self.gps else 'nogps'}-{self.world.replace(':', '-')}-{self.seed}"


@dataclass(frozen=True, slots=True)
class Flown:
    """What came of a flight. None: not known.

    Attributes:
        task: what was to be flown.
        ended_because: why the exploring ended.
        end: how the way home was, by the application's own account: ``end`` of its summary.
        off_start_m: true horizontal distance from where it stood before the take-off to where it lies.
        contacts: with a wall, in truth.
        least_m: least true distance to a wall, from the middle.
        replay_differing: setpoints of the recording flown again that are not the recorded ones.
        lasted_s: from the start of the autopilot on.
        problem: why there was no flight, or what else failed.
    """

    task: Task
    ended_because: str | None = None
    end: dict[str, Any] | None = None
    off_start_m: float | None = None
    contacts: int | None = None
    least_m: float | None = None
    replay_differing: int | None = None
    lasted_s: float = 0.0
    problem: str | None = None


def fly(task: Task, folder: Path) -> Flown:
    """Fly. Never raises for what goes wrong in the flight: that is told.

    Args:
        task: what.
        folder: of its files; exists.
    """
    began_s = time.monotonic()
    plan = FlightPlan(
        folder=folder,
        personality=task.personality,
        gps=task.gps,
        world=task.world,
        seed=task.seed,
        time_limit_s=task.time_limit_s,
        autopilot=("--battery-minutes", f"{task.battery_minutes:g}"),
    )
    found: dict[str, Any] = {}
    try:
        _underway(plan)
        found |= _come_of(folder)
    except (CompanionError, OSError, AssertionError, KeyError, ValueError) as error:
        found["problem"] = f"{type(error).__name__}: {error}"
    return Flown(task, **found, lasted_s=round(time.monotonic() - began_s, 1))


def _underway(plan: FlightPlan) -> None:
    log = plan.folder / "application.log"
    with Crew(plan) as crew, process(log, crew.application("--fix")) as gate:
        try:
            gate.wait(plan.time_limit_s + AROUND_S)
            crew.check()
        except subprocess.TimeoutExpired:
            raise not_in_time(log) from None
        finally:
            end_family(gate.pid)


def _come_of(folder: Path) -> dict[str, Any]:
    """What truth, summary and recording say, once everything has ended."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    (summary,) = folder.glob("*/summary.json")
    said = json.loads(summary.read_text(encoding="utf-8"))
    return {
        "ended_because": said["ended_because"],
        "end": said["end"],
        "off_start_m": round(off_start_m(folder / "truth.csv"), 3),
        "contacts": truth["contacts"],
        "least_m": truth["least_d_m"],
        "replay_differing": replay(summary.with_name("flight.mcap")).differing,
    }
