"""The processes of one flight and their settings: started, waited for, and ended however the flight ends."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from companion.config.load import load, merge
from companion.config.settings import Settings
from companion.interruption import handled
from sitl.launch.fleet import Seat
from sitl.launch.program import Ports, Program, Running, tied
from sitl.launch.real import RealAutopilot

START_TIMEOUT_S = 240.0
"""The first start on a computer compiles everything, which takes a small one minutes."""

AUTOPILOT_SERVES, WORLD_SERVES = "standing at", "waiting for its truth"
"""What the stub and the world say when they serve."""

Sections = Mapping[str, Any]
"""Nested mappings, like those in a settings file."""


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """One flight over MAVLink on this computer.

    Attributes:
        folder: where logs, settings, recording and map go; exists.
        personality: px4 or ardupilot.
        gps: False: external odometry only.
        world: as for `companion sim`.
        mesh: options that say how its file is to be read.
        seed: draws the start, the noise and the choices.
        time_limit_s: of the exploring.
        preset: of the application.
        settings: what is set besides what `sitl.launch.processes` and this flight need, as nested mappings like those
            in a settings file.
        autopilot: more options for `companion sitl autopilot`.
        world_options: more options for `companion sitl world`.
        real: the autopilot that flies in the place of the stub.
        parameters: of the real one, set before it boots.
        seat: which of several vehicles this is; None: it flies alone.
    """

    folder: Path
    personality: str = "px4"
    gps: bool = True
    world: str = "room"
    mesh: Sequence[str] = ()
    seed: int = 1
    time_limit_s: float = 1200.0
    preset: str = "flight"
    settings: dict[str, dict[str, Any]] | None = None
    autopilot: Sequence[str] = ()
    world_options: Sequence[str] = ()
    real: RealAutopilot | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    seat: Seat | None = None


class Crew:
    """The autopilot and the world of one flight, running; the application is started by whoever flies.

    Args:
        plan: what to fly.
    """

    def __init__(self, plan: FlightPlan) -> None:
        self.plan = plan
        self.config = plan.folder / "vehicle.yaml"
        """The settings file for the application."""
        *free, self.control_port, self.world_port = free_udp_ports(5)
        self.ports = Ports(*free) if plan.real is None else plan.real.ports
        """Where the autopilot sends to."""
        self._stream_url = f"tcp://127.0.0.1:{free_tcp_port()}"
        self._running: list[Running] = []

    @property
    def score_file(self) -> Path:
        """Where the world writes what really happened."""
        return self.plan.folder / "truth.json"

    def score(self) -> dict[str, Any]:
        """What really happened, so far."""
        found: dict[str, Any] = json.loads(self.score_file.read_text(encoding="utf-8"))
        return found

    def __enter__(self) -> Crew:
        settings = self.write_settings()
        try:
            self.autopilot = self._start(self._autopilot(settings))
            self.world = self._start(self._world())
            for one in self._running:
                one.wait(START_TIMEOUT_S)
            self.check()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def check(self) -> None:
        """Raise when a process that should be running is not."""
        for one in self._running:
            one.check()

    def about_the_mine(self) -> list[str]:
        """What the world said of its mine before it served."""
        lines = self.world.said().splitlines()
        return lines[: next((k for k, line in enumerate(lines) if WORLD_SERVES in line), 0)]

    def application(self, *options: str) -> list[str]:
        """The command that flies: it becomes the gate, and the application is its child."""
        # Vehicles that drew the same would choose the same.
        seed = self.plan.seed + (0 if self.plan.seat is None else self.plan.seat.number - 1)
        return [*command("run"), "--config", str(self.config), "--seed", str(seed), *options]

    def write_settings(self) -> Settings:
        """Write the application's settings file, as is done when the flight begins; what is in force with it."""
        plan = self.plan
        own: dict[str, dict[str, Any]] = {
            "autopilot": {"url": f"udpin://127.0.0.1:{self.ports.application}", "gps": plan.gps},
            "sensors": {"stream": {"url": self._stream_url}},
            "mission": {"start": "now", "time_limit_s": plan.time_limit_s},
            "record": {"folder": str(plan.folder), "largest_mb": 500.0},
        }
        if plan.seat is not None:
            own["autopilot"]["system_id"] = plan.seat.number
            own |= plan.seat.settings()
        return write_settings(self.config, plan.preset, own, plan.settings or {})

    def _autopilot(self, settings: Settings) -> Program:
        plan, ports = self.plan, self.ports
        if plan.real is not None:
            return plan.real.program(plan.folder, settings, plan.parameters)
        to = [f"127.0.0.1:{port}" for port in (ports.application, ports.ground, ports.world)]
        options = (
            *("--personality", plan.personality, "--seed", str(plan.seed)),
            *("--world", plan.world, *plan.mesh, "--preset", plan.preset),
            *("--control", str(self.control_port)),
            *(part for address in to for part in ("--to", address)),
            *([] if plan.gps else ["--no-gps"]),
            *(() if plan.seat is None else (*plan.seat.start_options(), "--system-id", str(plan.seat.number))),
            *plan.autopilot,
        )
        return Program("autopilot", (*command("sitl", "autopilot"), *options), AUTOPILOT_SERVES)

    def _world(self) -> Program:
        plan = self.plan
        options = (
            *("--world", plan.world, *plan.mesh, "--seed", str(plan.seed), "--preset", plan.preset),
            *("--truth", f"udp://127.0.0.1:{self.ports.world}", "--stream", self._stream_url),
            *("--control", str(self.world_port)),
            *("--score", str(self.score_file), "--trajectory", str(plan.folder / "truth.csv")),
            *(() if plan.gps else odometry_options(plan.personality)),
            *(() if plan.seat is None else plan.seat.world_options()),
            *plan.world_options,
        )
        return Program("world", (*command("sitl", "world"), *options), WORLD_SERVES)

    def _start(self, program: Program) -> Running:
        running = Running(program, self.plan.folder)
        self._running.append(running)
        return running

    def _end(self) -> None:
        for one in reversed(self._running):
            one.ask_to_end()
        for one in self._running:
            one.end()


def command(*words: str) -> list[str]:
    """The command line of a `companion` command, run by this interpreter."""
    return [sys.executable, "-m", "companion", *words]


def odometry_options(personality: str, port: int | None = None) -> tuple[str, ...]:
    """For `companion sitl world`, when the autopilot has no GPS: odometry for it.

    Args:
        personality: px4 or ardupilot.
        port: of the gate, through which it passes; None: to the autopilot itself.
    """
    hz = "30" if personality == "px4" else "50"
    to = () if port is None else ("--odometry-to", f"udpout://127.0.0.1:{port}")
    return ("--no-gps", "--odometry", "odometry", "--odometry-hz", hz, *to)


def with_odometry(settings: Sections, port: int) -> dict[str, Any]:
    """These settings of the application, with odometry through its gate, at this UDP port, beside who is attached."""
    others = settings.get("safety", {}).get("attached", ())
    odometry = {"url": f"udpin://127.0.0.1:{port}", "may": "odometry"}
    return merge(settings, {"safety": {"attached": [*others, odometry]}})


def free_udp_ports(count: int) -> list[int]:
    """Ports that nobody listens on now."""
    with contextlib.ExitStack() as stack:
        return [_bound(stack, socket.SOCK_DGRAM) for _ in range(count)]


def free_tcp_port() -> int:
    """A port that nobody listens on now."""
    (port,) = free_tcp_ports(1)
    return port


def free_tcp_ports(count: int) -> list[int]:
    """As `free_udp_ports`, of TCP."""
    with contextlib.ExitStack() as stack:
        return [_bound(stack, socket.SOCK_STREAM) for _ in range(count)]


def _bound(stack: contextlib.ExitStack, kind: socket.SocketKind) -> int:
    found = stack.enter_context(socket.socket(socket.AF_INET, kind))
    found.bind(("127.0.0.1", 0))
    return int(found.getsockname()[1])


def run_to_its_end(command: Sequence[str]) -> int:
    """Run the application, which lands first whatever ends it; its exit code.

    Ctrl-C reaches it from the terminal, as it reaches all of them. SIGTERM and SIGHUP come to this process alone: they
    are handed on. When this process is killed, the gate hears of it, and ends the flight as after SIGTERM.
    """
    with (
        subprocess.Popen(command, env=environment(), preexec_fn=tied()) as child,  # noqa: S603
        handled((signal.SIGINT,), lambda *_: None),
        handled((signal.SIGTERM, signal.SIGHUP), lambda *_: child.send_signal(signal.SIGINT)),
    ):
        return child.wait()


def run_all_to_their_ends(commands: Sequence[Sequence[str]], logs: Sequence[Path]) -> list[int]:
    """As `run_to_its_end` for several applications at once, each with a log of its own."""
    with contextlib.ExitStack() as stack:
        children = [
            stack.enter_context(
                subprocess.Popen(  # noqa: S603 - our own command
                    command,
                    env=environment(),
                    stdout=stack.enter_context(log.open("wb")),
                    stderr=subprocess.STDOUT,
                    preexec_fn=tied(),
                )
            )
            for command, log in zip(commands, logs, strict=True)
        ]

        def stop(*_: object) -> None:
            for child in children:
                if child.poll() is None:
                    child.send_signal(signal.SIGINT)

        stack.enter_context(handled((signal.SIGINT,), lambda *_: None))
        stack.enter_context(handled((signal.SIGTERM, signal.SIGHUP), stop))
        return [child.wait() for child in children]


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
