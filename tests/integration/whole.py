"""The application as it is flown: behind its gate, beside the stub and the world, in a room that is soon seen."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest

from sitl.launch.processes import Crew, FlightPlan
from tests.integration.rig import BOOT_S, process, wait_for_words
from tests.integration.witness import Witness
from validation.fault_matrix.corridor import write_box

SIZE_M = (6.0, 5.0, 3.0)
START = {"x": -0.5, "y": 0.2, "z": 1.5, "yaw": 0.3}
# A wide eye sees floor and roof of a small room soon: with the usual one the flight would take minutes.
CAMERA = {"horizontal_fov_deg": 150.0, "vertical_fov_deg": 120.0, "width_px": 128, "height_px": 128}
START_S, END_S = 120.0, 60.0


@dataclass(frozen=True, slots=True)
class Flown:
    """A flight that has begun: everything that can be asked of it.

    Attributes:
        crew: autopilot and world.
        gate: what `companion run` is: the safety gate, with the application as its child.
        witness: looks on.
        log: what gate and application say.
    """

    crew: Crew
    gate: subprocess.Popen[bytes]
    witness: Witness
    log: Path

    def wait_for(self, words: str, timeout_s: float = START_S) -> None:
        """Until they have been said."""
        wait_for_words(self.log, self.gate, words, timeout_s)

    def application(self) -> int:
        """The process id of the application that the gate has started."""
        for member in family(self.gate.pid):
            with contextlib.suppress(psutil.Error):
                if "companion.flight" in member.cmdline():
                    return member.pid
        pytest.fail(f"the application does not run: {self.said()[-1500:]}")

    def explore_for(self, duration_s: float) -> None:
        """Until it has been exploring for so long, and really flies."""
        self.wait_for("\nexploring")
        time.sleep(duration_s)
        assert self.witness.armed
        assert self.witness.pose().z_m > 1.0

    def exit_code(self, timeout_s: float = END_S) -> int:
        """Of the gate, which is that of the application, once both have ended."""
        try:
            return self.gate.wait(timeout_s)
        except subprocess.TimeoutExpired:
            pytest.fail(f"the flight did not end in {timeout_s:g} s: {self.said()[-1500:]}")

    def said(self) -> str:
        """Everything that gate and application have said."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    @property
    def folder(self) -> Path:
        """Of the flight's own files."""
        (recording,) = self.crew.plan.folder.glob("*/settings.yaml")
        return recording.parent

    def summary(self) -> dict[str, Any]:
        """What the application says of its flight."""
        found: dict[str, Any] = json.loads((self.folder / "summary.json").read_text(encoding="utf-8"))
        return found


@contextlib.contextmanager
def flown(
    folder: Path,
    personality: str,
    gps: bool = True,
    time_limit_s: float = 120.0,
    mission: dict[str, Any] | None = None,
    parameters: Sequence[str] = (),
    link: Mapping[str, Any] | None = None,
) -> Iterator[Flown]:
    """Autopilot, world, gate and application, started; all of them end with the block.

    Args:
        folder: of the flight.
        personality: px4 or ardupilot.
        gps: False: by external odometry.
        time_limit_s: of the exploring.
        mission: settings of that section, besides.
        parameters: of the autopilot, as NAME=VALUE.
        link: settings of that section.
    """
    plan = FlightPlan(
        folder=folder,
        personality=personality,
        gps=gps,
        world=str(write_box(folder / "room.ply", SIZE_M, START)),
        seed=3,
        time_limit_s=time_limit_s,
        settings={"sensors": {"camera": CAMERA}, "mission": mission or {}, "link": dict(link or {})},
        autopilot=("--boot-s", f"{BOOT_S:g}", *(part for one in parameters for part in ("--param", one))),
        world_options=("--config", str(folder / "vehicle.yaml")),
    )
    log = folder / "application.log"
    with Crew(plan) as crew, Witness(crew.ports.ground) as witness, process(log, crew.application("--fix")) as gate:
        try:
            yield Flown(crew, gate, witness, log)
        finally:
            end_family(gate.pid)


def family(group: int) -> list[psutil.Process]:
    """The processes of a process group that are still at work."""
    found = []
    for member in psutil.process_iter():
        with contextlib.suppress(psutil.Error, ProcessLookupError):
            if os.getpgid(member.pid) == group and member.status() != psutil.STATUS_ZOMBIE:
                found.append(member)
    return found


def end_family(group: int) -> None:
    """Kill what is left of a gate that was killed itself and could end no child."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)
