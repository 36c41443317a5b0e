"""The processes of one flight and their settings: started, waited for, and ended however the flight ends."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.config.load import load, merge
from companion.config.settings import Settings
from companion.errors import CompanionError

START_TIMEOUT_S = 240.0
"""The first start on a computer compiles everything, which takes a small one minutes."""

END_TIMEOUT_S = 10.0

_SERVES = {"autopilot": "standing at", "world": "waiting for its truth"}
"""What a process says when it serves; one that dies says something too."""

Sections = Mapping[str, Any]
"""Nested mappings, like those in a settings file."""


class CrewError(CompanionError):
    """A process of the flight did not start, or ended too soon."""


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """One flight over MAVLink on this computer.

    Attributes:
        folder: where logs, settings, recording and map go; exists.
        personality: px4 or ardupilot.
        gps: False: external odometry only.
        world: as for `companion sim`.
        seed: draws the start, the noise and the choices.
        time_limit_s: of the exploring.
        preset: of the application.
        settings: what is set besides what `sitl.launch.processes` and this flight need, as nested mappings like those
            in a settings file.
        autopilot: more options for `companion sitl autopilot`.
        world_options: more options for `companion sitl world`.
    """

    folder: Path
    personality: str = "px4"
    gps: bool = True
    world: str = "room"
    seed: int = 1
    time_limit_s: float = 1200.0
    preset: str = "flight"
    settings: dict[str, dict[str, Any]] | None = None
    autopilot: Sequence[str] = ()
    world_options: Sequence[str] = ()


class Crew:
    """The autopilot and the world of one flight, running; the application is started by whoever flies.

    Args:
        plan: what to fly.
    """

    def __init__(self, plan: FlightPlan) -> None:
        self.plan = plan
        self.config = plan.folder / "vehicle.yaml"
        """The settings file for the application."""
        self.to_application, self.to_ground, self.to_world, self.control_port = free_udp_ports(4)
        stream = free_tcp_port()
        self._stream_url = f"tcp://127.0.0.1:{stream}"
        self._processes: list[subprocess.Popen[bytes]] = []

    @property
    def score_file(self) -> Path:
        """Where the world writes what really happened."""
        return self.plan.folder / "truth.json"

    def score(self) -> dict[str, Any]:
        """What really happened, so far."""
        found: dict[str, Any] = json.loads(self.score_file.read_text(encoding="utf-8"))
        return found

    def __enter__(self) -> Crew:
        self.write_settings()
        try:
            self.autopilot = self._start("autopilot", self._autopilot_options())
            self._world = self._start("world", self._world_options())
            self._wait_for("autopilot", self.autopilot)
            self._wait_for("world", self._world)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def check(self) -> None:
        """Raise when a process that should be running is not."""
        for name, process in zip(("autopilot", "world"), self._processes, strict=False):
            if process.poll() is not None:
                raise CrewError(f"the process {name} ended too soon; its words: {self._words(name)}")

    def application(self, *options: str) -> list[str]:
        """The command that flies: it becomes the gate, and the application is its child."""
        return [*command("run"), "--config", str(self.config), "--seed", str(self.plan.seed), *options]

    def write_settings(self) -> Settings:
        """Write the application's settings file, as is done when the flight begins; what is in force with it."""
        plan = self.plan
        own = {
            "autopilot": {"url": f"udpin://127.0.0.1:{self.to_application}", "gps": plan.gps},
            "sensors": {"stream": {"url": self._stream_url}},
            "mission": {"start": "now", "time_limit_s": plan.time_limit_s},
            "record": {"folder": str(plan.folder), "largest_mb": 500.0},
        }
        return write_settings(self.config, plan.preset, own, plan.settings or {})

    def _autopilot_options(self) -> list[str]:
        plan = self.plan
        to = [f"127.0.0.1:{port}" for port in (self.to_application, self.to_ground, self.to_world)]
        return [
            *("--personality", plan.personality, "--seed", str(plan.seed)),
            *("--world", plan.world, "--preset", plan.preset),
            *("--control", str(self.control_port)),
            *(part for address in to for part in ("--to", address)),
            *([] if plan.gps else ["--no-gps"]),
            *plan.autopilot,
        ]

    def _world_options(self) -> list[str]:
        plan = self.plan
        hz = "30" if plan.personality == "px4" else "50"
        return [
            *("--world", plan.world, "--seed", str(plan.seed), "--preset", plan.preset),
            *("--truth", f"udp://127.0.0.1:{self.to_world}", "--stream", self._stream_url),
            *("--score", str(self.score_file), "--trajectory", str(plan.folder / "truth.csv")),
            *([] if plan.gps else ["--no-gps", "--odometry", "odometry", "--odometry-hz", hz]),
            *plan.world_options,
        ]

    def _start(self, name: str, options: Sequence[str]) -> subprocess.Popen[bytes]:
        with (self.plan.folder / f"{name}.log").open("wb") as log:
            process = subprocess.Popen(  # noqa: S603 - our own command
                [*command("sitl", name), *options],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                # Ctrl-C is for the application, which ends the flight; these two end after it.
                start_new_session=True,
            )
        self._processes.append(process)
        return process

    def _wait_for(self, name: str, process: subprocess.Popen[bytes]) -> None:
        """Until it says that it serves."""
        give_up_s = time.monotonic() + START_TIMEOUT_S
        while _SERVES[name] not in self._words(name):
            if process.poll() is not None:
                raise CrewError(f"the process {name} did not start; its words: {self._words(name)}")
            if time.monotonic() > give_up_s:
                raise CrewError(f"the process {name} was not ready in {START_TIMEOUT_S:g} s")
            time.sleep(0.05)
        self.check()

    def _words(self, name: str) -> str:
        text = (self.plan.folder / f"{name}.log").read_text(encoding="utf-8", errors="replace").strip()
        return text[-500:] or "none"

    def _end(self) -> None:
        for process in reversed(self._processes):
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for process in self._processes:
            try:
                process.wait(END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def command(*words: str) -> list[str]:
    """The command line of a `companion` command, run by this interpreter."""
    return [sys.executable, "-m", "companion", *words]


def free_udp_ports(count: int) -> list[int]:
    """Ports that nobody listens on now."""
    with contextlib.ExitStack() as stack:
        return [_bound(stack, socket.SOCK_DGRAM) for _ in range(count)]


def free_tcp_port() -> int:
    """A port that nobody listens on now."""
    with contextlib.ExitStack() as stack:
        return _bound(stack, socket.SOCK_STREAM)


def _bound(stack: contextlib.ExitStack, kind: socket.SocketKind) -> int:
    found = stack.enter_context(socket.socket(socket.AF_INET, kind))
    found.bind(("127.0.0.1", 0))
    return int(found.getsockname()[1])


@contextlib.contextmanager
def patient() -> Iterator[None]:
    """Leave Ctrl-C to the application, which lands first."""
    before = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def environment() -> dict[str, str]:
    """For the application: its output line by line, also into a file."""
    return {**os.environ, "PYTHONUNBUFFERED": "1"}


def write_settings(file: Path, preset: str, *layers: Sections) -> Settings:
    """Write a settings file: a preset, and over it the layers, the last one uppermost.

    Args:
        file: is made, or made anew.
        preset: below everything.
        layers: what is set besides.

    Returns:
        What is in force with it.

    Raises:
        InputError: these settings cannot be used.
    """
    sections: dict[str, Any] = {}
    for layer in layers:
        sections = merge(sections, layer)
    # JSON is YAML.
    file.write_text(json.dumps({"preset": preset, **sections}, indent=2) + "\n", encoding="utf-8")
    return load(file).settings
