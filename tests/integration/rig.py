"""What a flight over loopback needs: the stub as a process, the vehicle as the application flies it, in real time."""

from __future__ import annotations

import asyncio
import contextlib
import signal
import socket
import subprocess
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from companion.autopilot.link import MavsdkLink
from companion.autopilot.telemetry import Telemetry
from companion.autopilot.vehicle import Vehicle
from companion.clock import MonotonicClock
from companion.config.autopilot import AutopilotSettings
from companion.config.settings import Settings
from companion.flight.tasks import background
from companion.model import Setpoint
from sitl.launch.processes import command, environment, free_udp_ports
from tests.autopilot.loopback import UdpTransport
from tests.integration.relay import LOOPBACK, UdpRelay
from tests.integration.witness import Witness
from tests.shared.beside import until

PERSONALITIES = ("px4", "ardupilot")
BOOT_S = 2.0
HEIGHT_M = 1.5
PERIOD_S = 0.05
SILENCE = {
    "px4": ("COM_OF_LOSS_T=0.5", "COM_OBL_RC_ACT=5"),
    "ardupilot": ("GUID_TIMEOUT=0.5", "AVOID_ENABLE=0"),
}
"""What pre-flight would set."""
PILOTS_MODE = {"px4": "position", "ardupilot": "loiter"}


@contextlib.contextmanager
def process(log: Path, arguments: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """A process of ours that ends with the block, however the block ends; what it says goes to a file."""
    with log.open("wb") as words:
        running = subprocess.Popen(
            list(arguments),
            stdin=subprocess.DEVNULL,
            stdout=words,
            stderr=subprocess.STDOUT,
            env=environment(),
            start_new_session=True,
        )
    try:
        yield running
    finally:
        running.send_signal(signal.SIGTERM)
        try:
            running.wait(15.0)
        except subprocess.TimeoutExpired:
            running.kill()
            running.wait()


def wait_for_words(log: Path, running: subprocess.Popen[bytes], words: str, timeout_s: float) -> None:
    """Until a process has said something; the test fails when it ends before, or does not say it."""
    give_up_s = time.monotonic() + timeout_s
    while words not in (said := log.read_text(encoding="utf-8", errors="replace")):
        if running.poll() is not None or time.monotonic() > give_up_s:
            pytest.fail(f"{log.name} did not say {words!r} (exit code {running.poll()}): {said[-1500:]}")
        time.sleep(0.05)


class Stub:
    """The flight controller made of software, as a process of its own.

    Args:
        folder: for its log.
        personality: px4 or ardupilot.
        to: UDP ports of this computer to which it sends.
        system_id: its MAVLink number.
        boot_s: until it arms.
        parameters: NAME=VALUE, besides those of `SILENCE`.
    """

    def __init__(
        self,
        folder: Path,
        personality: str,
        to: Sequence[int],
        system_id: int = 1,
        boot_s: float = BOOT_S,
        parameters: Sequence[str] | None = None,
    ) -> None:
        self._folder, self._personality, self._to = folder, personality, to
        self._system_id, self._boot_s = system_id, boot_s
        self._parameters = SILENCE[personality] if parameters is None else parameters
        (self._control_port,) = free_udp_ports(1)

    @contextlib.contextmanager
    def running(self) -> Iterator[Stub]:
        """While the block lasts."""
        log = self._folder / f"autopilot-{self._system_id}.log"
        arguments = [
            *command("sitl", "autopilot"),
            *("--personality", self._personality, "--system-id", str(self._system_id)),
            *("--boot-s", str(self._boot_s), "--control", str(self._control_port)),
            *(part for port in self._to for part in ("--to", f"{LOOPBACK}:{port}")),
            *(part for parameter in self._parameters for part in ("--param", parameter)),
        ]
        with process(log, arguments) as running:
            wait_for_words(log, running, "standing at", 60.0)
            yield self

    def pilot_takes_over(self) -> None:
        """The switch on the transmitter."""
        take_over(self._control_port)


@dataclass(frozen=True, slots=True)
class Stage:
    """One autopilot, the link between it and the application, and somebody who looks on."""

    personality: str
    port: int
    relay: UdpRelay
    witness: Witness


@contextlib.contextmanager
def stage(
    folder: Path,
    personality: str,
    lost_share: float = 0.0,
    boot_s: float = BOOT_S,
    parameters: Sequence[str] | None = None,
) -> Iterator[Stage]:
    """Everything but the application, while the block lasts."""
    (port,) = free_udp_ports(1)
    own = folder / personality
    own.mkdir()
    with UdpRelay(port, lost_share) as relay, Witness() as witness:
        stub = Stub(own, personality, (relay.port, witness.port), boot_s=boot_s, parameters=parameters)
        with stub.running():
            yield Stage(personality, port, relay, witness)


@contextlib.contextmanager
def both(
    folder: Path, lost_share: float = 0.0, boot_s: float = BOOT_S, parameters: Sequence[str] | None = None
) -> Iterator[list[Stage]]:
    """Both personalities side by side, each on a link of its own: most of a flight is waiting, so they share it."""
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(stage(folder, name, lost_share, boot_s, parameters)) for name in PERSONALITIES]


async def fly_all(stages: Sequence[Stage], flight: Callable[[Stage], Coroutine[Any, Any, None]]) -> None:
    """The same flight with each of them at the same time; the first that fails fails the test."""
    await asyncio.gather(*(flight(one) for one in stages))


def take_over(control_port: int) -> None:
    """A pilot's hand on the mode switch of the transmitter of the stub with this control port."""
    transmitter(control_port, "takeover")


def transmitter(control_port: int, words: str) -> None:
    """What a pilot does with it: "rc on", "rc off", "rc channel 7 2000"."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hand:
        hand.sendto(words.encode(), (LOOPBACK, control_port))


@dataclass(frozen=True, slots=True)
class Aboard:
    """Everything between the application's logic and the wire."""

    clock: MonotonicClock
    link: MavsdkLink
    telemetry: Telemetry
    vehicle: Vehicle
    settings: Settings

    def height_m(self) -> float | None:
        """Above the place where the autopilot booted: the ground there is level."""
        pose = self.telemetry.poses.newest()
        return None if pose is None or self.clock.now_s() - pose.t_s > 0.5 else pose.z_m

    async def ready(self) -> None:
        """Until the autopilot knows where it is: what a pre-flight check would wait for."""
        await until(
            lambda: self.telemetry.state(self.clock.now_s()).position_valid, "the estimator is valid", timeout_s=20.0
        )

    async def stream(
        self, duration_s: float, speed_mps: float = 0.0, while_true: Callable[[], bool] | None = None
    ) -> int:
        """One setpoint each period: how many went out. Ends early when ``while_true`` no longer holds."""
        sent = 0
        end_s = self.clock.now_s() + duration_s
        while (now_s := self.clock.now_s()) < end_s and (while_true is None or while_true()):
            height_m = self.height_m()
            climb_mps = 0.0 if height_m is None else max(-0.3, min(0.3, HEIGHT_M - height_m))
            sent += self.vehicle.send(Setpoint(now_s, speed_mps, climb_mps, 0.0))
            await asyncio.sleep(PERIOD_S)
        return sent

    async def fly(self) -> None:
        """Take off and engage."""
        await self.ready()
        await self.vehicle.take_off(HEIGHT_M, self.height_m)
        await self.vehicle.engage()


@asynccontextmanager
async def aboard(port: int, system_id: int = 1, connect_timeout_s: float = 30.0) -> AsyncIterator[Aboard]:
    """Connected, with telemetry running. The vehicle is not entered: each test says where its flight ends."""
    clock = MonotonicClock()
    settings = Settings(
        autopilot=AutopilotSettings(
            url=f"udpin://{LOOPBACK}:{port}", system_id=system_id, connect_timeout_s=connect_timeout_s, silence_s=0.5
        )
    )
    async with MavsdkLink(settings.autopilot, clock, UdpTransport(port)) as link:
        telemetry = Telemetry(link, clock, settings)
        async with background(telemetry.run()):
            yield Aboard(clock, link, telemetry, Vehicle(link, telemetry, settings, clock), settings)
