"""One whole flight on a real autopilot: from its boot to what came of it."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from companion.errors import CompanionError
from companion.recording import open_recording
from companion.recording.content import ENDED, Topic
from companion.recording.flight_stats import figures
from companion.recording.read import log_line
from companion.recording.replay import replay
from sitl.launch.processes import Crew, FlightPlan
from sitl.launch.real import RealAutopilot
from tests.integration.rig import process
from tests.integration.whole import end_family
from validation.landed import landed_off_m, last_words, not_in_time, off_start_m
from validation.real.station import Station

AROUND_S, HOMING_S = 240.0, 300.0
"""Boot, checks, take-off, landing and the writing of the map, and the way home, besides the time of the exploring."""
DISARM_S = 15.0


@dataclass(frozen=True, slots=True)
class Task:
    """What is to be flown.

    Attributes:
        personality: px4 or ardupilot.
        gps: False: by external odometry.
        world: as for `companion sim`.
        seed: draws everything.
        time_limit_s: of the exploring.
    """

    personality: str
    gps: bool
    world: str
    seed: int
    time_limit_s: float

    @property
    def name(self) -> str:
        """For its folder."""
        return f"{self.personality}-{'gps' if self.gps else 'nogps'}-{self.world}-{self.seed}"


@dataclass(frozen=True, slots=True)
class Ways:
    """How all flights of a campaign are flown.

    Attributes:
        skip: checks that are skipped.
        world_options: for `companion sitl world`.
        parameters: of the autopilot, set before its boot.
        settings: of the application.
    """

    skip: Sequence[str] = ()
    world_options: Sequence[str] = ()
    parameters: dict[str, float] = field(default_factory=dict)
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Flown:
    """What came of a flight. ``None``: not known.

    Attributes:
        task: what was to be flown.
        exit_code: of the gate, which is the application's.
        ended_because: what the application says.
        complete: whether it found the map to be.
        contacts: with a wall, in truth.
        least_m: least true distance to a wall, from the middle.
        path_m: flown in truth.
        landed_off_m: true horizontal distance from where LAND was ordered, to where it lies: where the exploring ended,
            or its way home.
        disarmed: in the end.
        setpoint_p99_s, setpoint_longest_s: time from one setpoint of the application to the next.
        replay_compared, replay_differing: setpoints of the recording flown again.
        lasted_s: from the start of the autopilot on.
        texts: what the autopilot said to a ground station.
        problem: why there was no flight, or what else failed.
        off_start_m: true horizontal distance from where it started, when it came home.
    """

    task: Task
    exit_code: int | None = None
    ended_because: str | None = None
    complete: bool | None = None
    contacts: int | None = None
    least_m: float | None = None
    path_m: float | None = None
    landed_off_m: float | None = None
    disarmed: bool | None = None
    setpoint_p99_s: float | None = None
    setpoint_longest_s: float | None = None
    replay_compared: int | None = None
    replay_differing: int | None = None
    lasted_s: float = 0.0
    texts: tuple[str, ...] = ()
    problem: str | None = None
    off_start_m: float | None = None


def fly(real: RealAutopilot, task: Task, folder: Path, ways: Ways) -> Flown:
    """Fly. Never raises for what goes wrong in the flight: that is told.

    Args:
        real: the autopilot.
        task: what.
        folder: of its files; exists.
        ways: how.
    """
    began_s = time.monotonic()
    plan = FlightPlan(
        folder=folder,
        personality=task.personality,
        gps=task.gps,
        world=task.world,
        seed=task.seed,
        time_limit_s=task.time_limit_s,
        settings=ways.settings,
        world_options=ways.world_options,
        real=real,
        parameters=ways.parameters,
    )
    found: dict[str, Any] = {}
    try:
        _underway(plan, ways, found)
        found |= _come_of(folder)
    except (CompanionError, OSError, AssertionError, KeyError, ValueError) as error:
        found["problem"] = f"{type(error).__name__}: {error}"
    return Flown(task, **found, lasted_s=round(time.monotonic() - began_s, 1))


def _underway(plan: FlightPlan, ways: Ways, found: dict[str, Any]) -> None:
    """From the boot until the application has ended, and the vehicle lies."""
    log = plan.folder / "application.log"
    options = ["--fix", *(word for name in ways.skip for word in ("--skip", name))]
    with Crew(plan) as crew, Station(crew.ports.ground) as station, process(log, crew.application(*options)) as gate:
        try:
            found["exit_code"] = gate.wait(plan.time_limit_s + AROUND_S + HOMING_S)
            _wait_for_disarmed(station)
            crew.check()
        except subprocess.TimeoutExpired:
            raise not_in_time(log) from None
        finally:
            end_family(gate.pid)
            found["disarmed"] = station.ever_armed and not station.armed
            found["texts"] = tuple(station.texts)
    if not station.ever_armed:
        found["problem"] = f"it was never armed: {last_words(log)}"


def _wait_for_disarmed(station: Station) -> None:
    give_up_s = time.monotonic() + DISARM_S
    while station.armed and time.monotonic() < give_up_s:
        time.sleep(0.1)


def _come_of(folder: Path) -> dict[str, Any]:
    """What truth, summary and recording say, once everything has ended."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    found: dict[str, Any] = {
        "contacts": truth["contacts"],
        "least_m": truth["least_d_m"],
        "path_m": truth["path_length_m"],
    }
    recording = next(folder.glob("*/flight.mcap"), None)
    if recording is None:
        return found
    summary, home_s = recording.with_name("summary.json"), 0.0
    if summary.exists():
        said = json.loads(summary.read_text(encoding="utf-8"))
        found |= {"ended_because": said["ended_because"], "complete": said["ended_because"] == "complete"}
        if said["end"] is not None:
            home_s = said["end"]["homing_s"] or 0.0
            found["off_start_m"] = round(off_start_m(folder / "truth.csv"), 3)
    interval = figures(recording).setpoint_interval_s
    if interval is not None:
        found |= {"setpoint_p99_s": round(interval.p99, 4), "setpoint_longest_s": round(interval.largest, 4)}
    again = replay(recording)
    found |= {"replay_compared": again.compared, "replay_differing": again.differing}
    ended_s = _ended_s(recording)
    if ended_s is not None:
        found["landed_off_m"] = landed_off_m(folder / "truth.csv", ended_s + home_s)
    return found


def _ended_s(file: Path) -> float | None:
    """When the exploring ended, on the clock of the truth."""
    recording = open_recording(file)
    for entry in recording.entries():
        if entry.topic == Topic.LOG and log_line(entry).name == ENDED:
            return (entry.t_ns - recording.wall_ns) / 1e9 + recording.start_s
    return None
