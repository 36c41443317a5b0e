"""A flight on whose way home something happens: over MAVLink, in real time, on the stub autopilot."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.errors import CompanionError
from companion.mavlink.ids import MavCmd
from sitl.autopilot.mavlink import dialect as m
from sitl.launch.processes import Crew, FlightPlan
from sitl.launch.program import CrewError
from tests.integration.rig import BOOT_S, process, transmitter
from tests.integration.whole import end_family
from tests.integration.witness import Witness, apart_m
from validation.fault_matrix.processes import children, map_process
from validation.landed import landed_off_m, last_words, not_in_time, off_start_m

APPLICATION = 191
START_S, OUT_S = 480.0, 240.0
UNDER_WAY_S = 3.0
"""Time from the order to come home to what happens: it has turned, and flies."""

SETTLED_S = 3.0
"""After the application has ended it is looked at for so long how the vehicle stands."""


@dataclass(frozen=True, slots=True)
class Row:
    """What happens on the way home.

    Attributes:
        name: as it is asked for on the command line.
        what: what happens, as the table of docs/flying.md has it.
        ends: why the way home may end, in the words of the summary.
        happens: makes it happen, once the vehicle is under way.
        says: what the application has to tell.
        lies: where it may lie in the end: least and most distance from the start, in m.
        lands: whether it is down in the end; otherwise it is in the air, and not ours.
        from_m: so far it may lie from where it was when this happened, in m; None: anywhere.
        world: where.
        out_m: it is ordered home when it is so far from its start.
        most_s: how long the way home and the landing may take.
        battery_minutes: from full to empty.
        has_truth: whether the world goes on to write where the vehicle truly is.
        personalities: with which it is flown: both where the autopilot has a part in it.
    """

    name: str
    what: str
    ends: tuple[str, ...]
    happens: Callable[[Underway], None]
    says: str = ""
    lies: tuple[float, float] = (0.0, 100.0)
    lands: bool = True
    from_m: float | None = None
    world: str = "hazard:step"
    out_m: float = 7.0
    most_s: float = 150.0
    battery_minutes: float = 30.0
    has_truth: bool = True
    personalities: tuple[str, ...] = ("px4", "ardupilot")


@dataclass(frozen=True, slots=True)
class Came:
    """What came of it. None: not known.

    Attributes:
        row: its name.
        personality: px4 or ardupilot.
        ended: why the way home ended, as the summary says.
        lay_m: how far from its start the vehicle was in the end; in truth, where the world went on.
        went_m: how far from where it was when this happened, as that.
        mode: of the autopilot, in the end.
        armed: whether it was still armed.
        contacts: with anything, in truth.
        after_s: time from what happened to the end of the application.
        said: whether it told what it has to.
        problem: why there was no flight, or what failed.
    """

    row: str
    personality: str
    ended: str | None = None
    lay_m: float | None = None
    went_m: float | None = None
    mode: str | None = None
    armed: bool | None = None
    contacts: int | None = None
    after_s: float | None = None
    said: bool | None = None
    problem: str | None = None


@dataclass(frozen=True, slots=True)
class Underway:
    """A flight in the air, and what may be done to it.

    Attributes:
        personality: px4 or ardupilot.
        crew: autopilot and world.
        gate: the safety gate, with the application as its child.
        witness: looks on, as a ground station.
        log: what gate and application say.
    """

    personality: str
    crew: Crew
    gate: subprocess.Popen[bytes]
    witness: Witness
    log: Path

    def said(self) -> str:
        """Everything that gate and application have said."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def wait(self, what: str, holds: Callable[[], bool], timeout_s: float) -> None:
        """Until something holds.

        Raises:
            CrewError: it does not, or the flight has ended.
        """
        give_up_s = time.monotonic() + timeout_s
        while not holds():
            if self.gate.poll() is not None or time.monotonic() > give_up_s:
                raise CrewError(f"not in {timeout_s:g} s: {what}: {last_words(self.log)}")
            time.sleep(0.1)

    def order(self, command: MavCmd, parameter: float = 0.0) -> None:
        """As a ground station on the autopilot's network sends it to the application."""
        self.witness.send(m.MAVLink_command_long_message(1, APPLICATION, command, 0, parameter, *[0.0] * 6))

    def tell_autopilot(self, words: str) -> None:
        """A command to the stub: its battery, its GPS, its pilot."""
        transmitter(self.crew.control_port, words)

    def tell_world(self, number: signal.Signals) -> None:
        """A signal to the process of the sensors."""
        self.crew.world.process.send_signal(number)

    def kill_map(self) -> bool:
        """Kill the process of the map; False where there is none."""
        found = [pid for pid in map(map_process, children(self.gate.pid)) if pid is not None]
        for pid in found:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        return bool(found)


def fly(row: Row, personality: str, folder: Path, settings: Mapping[str, Any] | None = None) -> Came:
    """Fly out, order the vehicle home, let happen what happens, and look. Never raises for what goes wrong in it.

    Args:
        row: what happens.
        personality: of the stub.
        folder: of its files; exists.
        settings: of the application, besides.
    """
    plan = FlightPlan(
        folder=folder,
        personality=personality,
        world=row.world,
        time_limit_s=600.0,
        settings=dict(settings or {}),
        autopilot=("--boot-s", f"{BOOT_S:g}", "--battery-minutes", f"{row.battery_minutes:g}"),
    )
    found: dict[str, Any] = {}
    try:
        found |= _underway(row, plan)
        happened_s = found.pop("happened_s")
        (summary,) = folder.glob("*/summary.json")
        end = json.loads(summary.read_text(encoding="utf-8"))["end"]
        found["ended"] = None if end is None else end["ended_because"]
        found["contacts"] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))["contacts"]
        if row.has_truth:
            truth = folder / "truth.csv"
            found["lay_m"] = round(off_start_m(truth), 2)
            found["went_m"] = landed_off_m(truth, happened_s)
    except (CompanionError, OSError, AssertionError, KeyError, ValueError) as error:
        found["problem"] = f"{type(error).__name__}: {error}"
    return Came(row.name, personality, **found)


def _underway(row: Row, plan: FlightPlan) -> dict[str, Any]:
    """What was seen of the flight from the ground, and when it happened, by `time.monotonic`."""
    log = plan.folder / "application.log"
    with Crew(plan) as crew, Witness(crew.ports.ground) as witness, process(log, crew.application("--fix")) as gate:
        flight = Underway(plan.personality, crew, gate, witness, log)
        try:
            flight.wait("exploring", lambda: "\nexploring" in flight.said(), START_S)
            start = witness.pose()
            flight.wait(f"{row.out_m:g} m out", lambda: apart_m(start, witness.pose()) >= row.out_m, OUT_S)
            flight.order(MavCmd.NAV_RETURN_TO_LAUNCH)
            flight.wait("coming home", lambda: "coming home, " in flight.said(), 5.0)
            time.sleep(UNDER_WAY_S)
            there, happened_s = witness.pose(), time.monotonic()
            row.happens(flight)
            try:
                gate.wait(max(1.0, row.most_s - (time.monotonic() - happened_s)))
            except subprocess.TimeoutExpired:
                raise not_in_time(log) from None
            after_s = time.monotonic() - happened_s
            time.sleep(SETTLED_S)
            end = witness.poses[-1]
            return {
                "happened_s": happened_s,
                "lay_m": round(apart_m(start, end), 2),
                "went_m": round(apart_m(there, end), 2),
                "mode": witness.mode,
                "armed": witness.armed,
                "after_s": round(after_s, 1),
                "said": row.says in flight.said(),
            }
        finally:
            end_family(gate.pid)
