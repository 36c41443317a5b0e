"""The application as it is flown: a process of its own, beside the stub and the world, in a room that is soon seen."""

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

from sitl.together.crew import Crew, FlightPlan
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
    """A flight that has begun: everything that can be asked of it."""

    crew: Crew
    application: subprocess.Popen[bytes]
    witness: Witness
    log: Path

    def wait_for(self, words: str, timeout_s: float = START_S) -> None:
        """Until the application has said them."""
        wait_for_words(self.log, self.application, words, timeout_s)

    def explore_for(self, duration_s: float) -> None:
        """Until it has been exploring for so long, and really flies."""
        self.wait_for("\nexploring")
        time.sleep(duration_s)
        assert self.witness.armed
        assert self.witness.pose().z_m > 1.0

    def exit_code(self, timeout_s: float = END_S) -> int:
        """Of the application, once it has ended."""
        try:
            return self.application.wait(timeout_s)
        except subprocess.TimeoutExpired:
            pytest.fail(f"the application did not end in {timeout_s:g} s: {self.said()[-1500:]}")

    def said(self) -> str:
        """Everything that the application has said."""
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
    """Autopilot, world and application, started; all of them end with the block."""
    plan = FlightPlan(
        folder=folder,
        personality=personality,
        gps=gps,
        world=str(room(folder)),
        seed=3,
        time_limit_s=time_limit_s,
        settings={"sensors": {"camera": CAMERA}},
        autopilot=("--boot-s", f"{BOOT_S:g}"),
        beside=("--config", str(folder / "vehicle.yaml")),
    )
    log = folder / "application.log"
    with (
        Crew(plan) as crew,
        Witness(crew.to_ground) as witness,
        process(log, crew.application("--fix")) as application,
    ):
        try:
            yield Flown(crew, application, witness, log)
        finally:
            end_family(application.pid)


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
    """End what an application that was killed may have left, whose children cannot be told otherwise."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)
