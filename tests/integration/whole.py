"""The application as it is flown: behind its gate, beside the stub and the world, in a room that is soon seen."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from sitl.launch.processes import Crew, FlightPlan
from tests.integration.rig import BOOT_S, process, wait_for_words
from tests.integration.witness import Witness

SIZE_M = (6.0, 5.0, 3.0)
START = {"x": -0.5, "y": 0.2, "z": 1.5, "yaw": 0.3}
# A wide eye sees floor and roof of a small room soon: with the usual one the flight would take minutes.
CAMERA = {"horizontal_fov_deg": 150.0, "vertical_fov_deg": 120.0, "width_px": 128, "height_px": 128}
START_S, END_S = 120.0, 60.0
_CORNERS_OF_TRIANGLES = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
    (1, 5, 7), (1, 7, 3),
)  # fmt: skip


def room(folder: Path) -> Path:
    """A box as a mesh file, with its start beside it."""
    length_m, width_m, height_m = SIZE_M
    corners = [
        (x, y, z) for x in (-length_m / 2, length_m / 2) for y in (-width_m / 2, width_m / 2) for z in (0.0, height_m)
    ]
    header = [
        *("ply", "format ascii 1.0", f"element vertex {len(corners)}"),
        *(f"property float {axis}" for axis in "xyz"),
        *(f"element face {len(_CORNERS_OF_TRIANGLES)}", "property list uchar int vertex_indices", "end_header"),
    ]
    rows = [" ".join(map(str, corner)) for corner in corners]
    rows += [" ".join(map(str, (3, *triangle))) for triangle in _CORNERS_OF_TRIANGLES]
    file = folder / "room.ply"
    file.write_text("\n".join([*header, *rows, ""]), encoding="ascii")
    file.with_suffix(".json").write_text(json.dumps({"start": START}), encoding="utf-8")
    return file


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
        for pid in family(self.gate.pid):
            with contextlib.suppress(OSError):
                if b"companion.flight" in (Path("/proc") / str(pid) / "cmdline").read_bytes().split(b"\0"):
                    return pid
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
def flown(folder: Path, personality: str, gps: bool = True, time_limit_s: float = 120.0) -> Iterator[Flown]:
    """Autopilot, world, gate and application, started; all of them end with the block."""
    plan = FlightPlan(
        folder=folder,
        personality=personality,
        gps=gps,
        world=str(room(folder)),
        seed=3,
        time_limit_s=time_limit_s,
        settings={"sensors": {"camera": CAMERA}},
        autopilot=("--boot-s", f"{BOOT_S:g}"),
        world_options=("--config", str(folder / "vehicle.yaml")),
    )
    log = folder / "application.log"
    with (
        Crew(plan) as crew,
        Witness(crew.to_ground) as witness,
        process(log, crew.application("--fix")) as gate,
    ):
        try:
            yield Flown(crew, gate, witness, log)
        finally:
            end_family(gate.pid)


def family(group: int) -> list[int]:
    """The processes of a process group that are still at work."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            with contextlib.suppress(OSError):
                # The name of a process stands in parentheses and may hold spaces.
                state, _, its_group = (entry / "stat").read_text().rpartition(")")[2].split()[:3]
                if int(its_group) == group and state != "Z":
                    found.append(int(entry.name))
    return found


def end_family(group: int) -> None:
    """End what a gate that was killed may have left, whose children cannot be told otherwise."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)
