"""One flight of the matrix: the processes, started and ended, and everything that a fault may lay its hands on."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from companion.config.load import merge
from companion.config.settings import Settings
from companion.errors import CompanionError
from companion.flight.request import FlightRequest, application, module, sealed
from companion.gate.plan import Plan
from companion.safety_case.gate_plan import to_plan
from sitl.launch.processes import (
    WORLD_SERVES,
    Sections,
    command,
    environment,
    free_tcp_port,
    free_udp_ports,
    odometry_options,
    with_odometry,
    write_settings,
)
from sitl.launch.program import Ports, Program, Running, tied
from tests.integration.relay import UdpRelay
from tests.integration.witness import Witness, speed_mps
from validation.fault_matrix.corridor import LENGTH_M, corridor
from validation.fault_matrix.injection import Injection
from validation.fault_matrix.processes import children, map_process
from validation.fault_matrix.stand import Stand
from validation.fault_matrix.standstill import Standstill
from validation.fault_matrix.stream_relay import StreamRelay
from validation.fault_matrix.true_way import TrueWay

LOOPBACK = "127.0.0.1"
ROOT = Path(__file__).parents[2]
START_S = 150.0
"""Until it explores: on a computer that has never flown everything is compiled first."""
REACH_S = 40.0
"""Until it is near the wall."""
LOOK_S = 0.01
"""Half a centimetre of the way."""
LEAST_MPS = 0.3
"""Slower than this it does not fly towards the wall, or has been stopped for something else."""
NICENESS, HARDWARE_NICENESS = -5, -10
"""A vehicle's computer does nothing else besides; and autopilot, sensors and wires do not wait for its processors. For
an ordinary user this has no effect."""
CAMERA = {"width_px": 128, "height_px": 96}


class SceneError(CompanionError):
    """The flight did not come as far as its fault: nothing was shown, neither good nor bad."""


@dataclass(frozen=True, slots=True)
class Flight:
    """A flight under way.

    Attributes:
        folder: of its files and logs.
        personality: px4 or ardupilot.
        config: the settings file that it was started with.
        settings: what stood in it.
        plan: what the gate was started with.
        gate: its process, whose child is the application.
        gate_port: where the gate receives from the autopilot.
        relay: between autopilot and gate.
        stream: between world and application.
        witness: a ground station that only looks on.
        truth: where the vehicle is.
        standstill: tells when the computer did not run what has to run.
        world: its process.
        autopilot: its process.
        control_port: of the stub: takeover, battery PERCENT, gps on|off.
        world_port: of the world: what goes wrong with its odometry.
        flyer_port: of the application: the words of `flyer_faults`.
    """

    folder: Path
    personality: str
    config: Path
    settings: Settings
    plan: Plan
    gate: subprocess.Popen[bytes]
    gate_port: int
    relay: UdpRelay
    stream: StreamRelay
    witness: Witness
    truth: TrueWay
    standstill: Standstill
    world: Running
    autopilot: Running
    control_port: int
    world_port: int
    flyer_port: int

    @property
    def flyer_pid(self) -> int:
        """The application's process, as long as the gate lives."""
        found = children(self.gate.pid)
        if not found:
            raise SceneError("the gate has no child")
        return found[0]

    @property
    def mapper_pid(self) -> int:
        found = map_process(self.flyer_pid)
        if found is None:
            raise SceneError("the application has no process of the map")
        return found

    def wall_m(self) -> float:
        """From the middle of the vehicle to the wall ahead, in truth; far away as long as that is not known."""
        newest = self.truth.newest()
        return math.inf if newest is None else LENGTH_M / 2.0 - newest.x_m

    def said(self) -> str:
        """What gate and application have said."""
        return (self.folder / "gate.log").read_text(encoding="utf-8", errors="replace")

    def tell_flyer(self, words: str) -> None:
        """Trigger a fault inside the application."""
        _tell(self.flyer_port, words)

    def tell_autopilot(self, words: str) -> None:
        """A hand on the transmitter, the battery, the antenna."""
        _tell(self.control_port, words)

    def tell_world(self, words: str) -> None:
        """A hand on the tracking camera."""
        _tell(self.world_port, words)

    def wait(self, what: str, ready: Callable[[], bool], timeout_s: float) -> None:
        """Until it has come about.

        Raises:
            SceneError: it did not.
        """
        give_up_s = time.monotonic() + timeout_s
        while not ready():
            if self.gate.poll() is not None:
                raise SceneError(f"the gate ended ({self.gate.returncode}) before {what}: {self.said()[-1500:]}")
            if time.monotonic() > give_up_s:
                raise SceneError(f"not within {timeout_s:g} s: {what}: {self.said()[-1500:]}")
            time.sleep(LOOK_S)


@contextlib.contextmanager
def flying(folder: Path, stand: Stand, injection: Injection) -> Iterator[Flight]:
    """Take off and explore; all processes end with the block."""
    gate_port, control_port, world_port, flyer_port, odometry_port = free_udp_ports(5)
    world_tcp, wanted = free_tcp_port(), stand.wanted()
    with contextlib.ExitStack() as stack:
        relay = stack.enter_context(UdpRelay(gate_port, port=wanted.application))
        stream = stack.enter_context(StreamRelay(world_tcp))
        witness = stack.enter_context(stand.witness(wanted.ground))
        truth_port = free_udp_ports(1)[0]
        to_world = stack.enter_context(UdpRelay(truth_port, port=wanted.world))
        truth = TrueWay()
        to_world.alter_down = lambda message: truth.hear(message, time.monotonic())
        config = folder / "vehicle.yaml"
        own = merge({"autopilot": {"gps": stand.gps}}, injection.settings)
        guarded_port = odometry_port if injection.guarded else None
        own = own if guarded_port is None else with_odometry(own, guarded_port)
        settings = write_config(config, gate_port, stream.url, own)
        ports = Ports(relay.port, witness.port, to_world.port)
        # Side by side: each of them takes seconds to load. What is started last ends first.
        world = _serve(stack, folder, _world(folder, stand, config, guarded_port, truth_port, world_tcp, world_port))
        autopilot = _serve(stack, folder, stand.program(folder, settings, ports, control_port))
        plan, gate = _gate(stack, folder, settings, flyer_port)
        standstill = stack.enter_context(Standstill({"the gate": gate.pid, "the autopilot": autopilot.process.pid}))
        flight = Flight(
            *(folder, stand.personality, config, settings, plan, gate, gate_port),
            *(relay, stream, witness, truth, standstill, world, autopilot),
            *(control_port, world_port, flyer_port),
        )
        stack.enter_context(_precedence())
        for one in (autopilot, world):
            one.wait(START_S)
        flight.wait("ready", lambda: "flyer: loaded" in flight.said(), START_S)
        flight.wait("a heartbeat of the autopilot", lambda: bool(flight.witness.beats), START_S)
        if injection.before is not None:
            injection.before(flight)
        flight.tell_flyer("go")
        flight.wait("exploring", lambda: "\nexploring" in flight.said(), START_S)
        if injection.exploring is not None:
            injection.exploring(flight)
        yield flight


def approach(flight: Flight, trigger_m: float) -> None:
    """Until the moment for the fault, so far from the wall.

    Raises:
        SceneError: it does not come near, or comes near without flying.
    """
    flight.wait("near the wall", lambda: flight.wall_m() <= trigger_m, REACH_S)
    now_mps = speed_mps(flight.witness.pose())
    if not flight.witness.armed or now_mps < LEAST_MPS:
        raise SceneError(f"it came near the wall with {now_mps:.2f} m/s: {flight.said()[-1500:]}")


@contextlib.contextmanager
def _precedence() -> Iterator[None]:
    """For the relays, in this process: wires take no time either."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, HARDWARE_NICENESS)
    try:
        yield
    finally:
        with contextlib.suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, before)


def _tell(port: int, words: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hand:
        hand.sendto(words.encode(), (LOOPBACK, port))


def write_config(config: Path, gate_port: int, stream_url: str, settings: Sections) -> Settings:
    """Write the settings file of a flight, with ``settings`` over what every flight has; what is in force with it."""
    every = {
        "autopilot": {"url": f"udpin://{LOOPBACK}:{gate_port}"},
        "sensors": {"stream": {"url": stream_url}, "camera": CAMERA},
        # A clock is known to half a round trip, which other work on this computer makes longer than 30 ms.
        # Where it ends it lands: what its flyer is to fly at a fault is a straight line, and no way back.
        "mission": {"start": "now", "time_limit_s": 300.0, "end_action": "land", "skip_checks": ["clock"]},
        "record": {"folder": str(config.parent), "largest_mb": 200.0},
    }
    return write_settings(config, "flight", every, settings)


def _world(folder: Path, stand: Stand, config: Path, odometry_port: int | None, *ports: int) -> Program:
    truth_port, stream_port, control_port = ports
    options = (
        *("--world", str(corridor(folder)), "--config", str(config), "--control", str(control_port)),
        *("--truth", f"udp://{LOOPBACK}:{truth_port}", "--stream", f"tcp://{LOOPBACK}:{stream_port}"),
        *("--score", str(folder / "truth.json"), "--trajectory", str(folder / "truth.csv")),
        *(() if stand.gps else odometry_options(stand.personality, odometry_port)),
        *stand.world_options,
    )
    return Program("world", (*command("sitl", "world"), *options), WORLD_SERVES)


def _serve(stack: contextlib.ExitStack, folder: Path, program: Program) -> Running:
    """Started, and ended with the flight."""
    running = Running(program, folder, HARDWARE_NICENESS)
    stack.callback(running.end)
    return running


def _gate(
    stack: contextlib.ExitStack, folder: Path, settings: Settings, flyer_port: int
) -> tuple[Plan, subprocess.Popen[bytes]]:
    """The gate as `companion run` starts it, with the test's own application."""
    request = FlightRequest("run", settings, "flight", seed=1, fix=True)
    first, again = request.sealed(), request.started_by("command").sealed()
    flyer, control = "validation.fault_matrix.flyer", ("--control", str(flyer_port))
    plan = to_plan(
        settings,
        command=(*application(first, flyer), *control, "--wait"),
        restart_command=(*application(again, flyer), *control),
        inherit=(first, again),
    )
    plan_fd = sealed("plan", plan.dumps())
    with (folder / "gate.log").open("wb") as log:
        gate = subprocess.Popen(
            ["nice", "-n", str(NICENESS), *module("companion.gate"), "--plan-fd", str(plan_fd)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment(),
            cwd=ROOT,
            pass_fds=(first, again, plan_fd),
            start_new_session=True,
            preexec_fn=tied(),
        )
    for number in (first, again, plan_fd):
        os.close(number)
    stack.callback(_end_family, gate)
    return plan, gate


def _end_family(gate: subprocess.Popen[bytes]) -> None:
    """The flight has been judged: nothing of it is wanted any more, stopped or hung or not."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(gate.pid, signal.SIGKILL)
    gate.wait()
