"""A vehicle's process of the link beside an application of a few lines, and a network that fails."""

from __future__ import annotations

import contextlib
import random
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from companion.config.link import LinkSettings
from companion.errors import CompanionError
from companion.link.ground.station import LinkStation
from companion.link.ground.vehicle import LinkedVehicle
from companion.link.vehicle.pipe import Kind, pair, receive, send
from companion.link.vehicle.process import LinkProcess
from companion.link.wire import Order, decoded, encoded
from companion.link.words import Answer, Command, Telemetry
from sitl.launch.processes import free_tcp_port, free_udp_ports
from tests.link.exchange import MAP, Mine

WAIT_S = 50.0
"""What takes a second takes half a minute on a computer that flies a vehicle beside and over a network that loses."""


def until(holds: Callable[[], object], timeout_s: float = WAIT_S) -> None:
    """Until something holds."""
    give_up_s = time.monotonic() + timeout_s
    while not holds():
        assert time.monotonic() < give_up_s, "it did not happen in time"
        time.sleep(0.01)


class RiggedVehicle:
    """The process of the link in a thread, and an application that obeys everything.

    Attributes:
        obeyed: commands that reached the application, and who gave them.
        refused: what the process says of those that did not.
        endpoint: where it listens.
    """

    def __init__(self, mine: Mine, **settings: Any) -> None:
        self.obeyed: list[tuple[Command, str]] = []
        self.refused: list[str] = []
        self.obeys = True
        self.endpoint = settings.setdefault("listen", [f"tcp/127.0.0.1:{free_tcp_port()}"])[0]
        self.settings = LinkSettings.model_validate({"enabled": True, "name": "drone1", **settings})
        self._mine = mine
        self._number = 0
        self._closing = threading.Event()
        self.start()

    def start(self) -> None:
        self._end, theirs = pair()
        try:
            self._process = LinkProcess(theirs, self.settings, self._mine.folder / "map.journal")
        except CompanionError:
            self._end.close()
            theirs.close()
            raise
        self._closing.clear()
        self._threads = [threading.Thread(target=target, daemon=True) for target in (self._process.run, self._apply)]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        self._closing.set()
        self._threads[1].join(5.0)
        self._end.close()
        self._threads[0].join(5.0)
        self._process.close()

    def _apply(self) -> None:
        next_s = 0.0
        while not self._closing.is_set():
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + 0.2
                self._number += 1
                place = 0.3 * self._number
                send(self._end, Kind.TELEMETRY, encoded(telemetry(self._number, x_m=place, y_m=0.0, z_m=1.0)))
            if not select.select([self._end], [], [], 0.02)[0]:
                continue
            packet = receive(self._end)
            if packet is None:
                continue
            kind, data = packet
            if kind is Kind.ORDER and self.obeys:
                order = decoded(Order, data)
                self.obeyed.append((order.command, order.by))
                send(self._end, Kind.ANSWER, order.id.encode() + encoded(Answer(accepted=True)))
            elif kind is Kind.REFUSED:
                self.refused.append(data.decode())


def telemetry(number: int = 1, **known: Any) -> Telemetry:
    return Telemetry("drone1", MAP, number, 1.0 * number, "exploring", **known)


@contextlib.contextmanager
def rigged(mine: Mine, **settings: Any) -> Iterator[RiggedVehicle]:
    """A vehicle in the block."""
    vehicle = RiggedVehicle(mine, **settings)
    try:
        yield vehicle
    finally:
        vehicle.stop()


def known(station: LinkStation) -> LinkedVehicle:
    """The one vehicle, once it has been heard."""
    until(lambda: any(one.telemetry is not None for one in station.vehicles()))
    (vehicle,) = station.vehicles()
    return vehicle


def answer_to(vehicle: LinkedVehicle, command: Command) -> Answer | None:
    """What became of a command."""
    answers: list[Answer | None] = []
    vehicle.ask(command, answers.append)
    until(lambda: answers)
    return answers[0]


class BadNetwork:
    """A relay of UDP that loses some, and is silent when it is told to. A context manager.

    Args:
        to: where it goes.
        loss: share that gets lost, in each direction.

    Attributes:
        silent: whether nothing comes through.
        port: where it listens.
    """

    def __init__(self, to: int, loss: float) -> None:
        self.silent = False
        self.passed = self.lost = 0
        (self.port,) = free_udp_ports(1)
        self._loss = loss
        self._to = ("127.0.0.1", to)
        self._random = random.Random(3)  # noqa: S311
        self._front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._front.bind(("127.0.0.1", self.port))
        self._backs: dict[tuple[str, int], socket.socket] = {}
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> BadNetwork:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join(5.0)
        for one in (self._front, *self._backs.values()):
            one.close()

    def _run(self) -> None:
        while not self._closing.is_set():
            ready, _, _ = select.select([self._front, *self._backs.values()], [], [], 0.05)
            for one in ready:
                with contextlib.suppress(ConnectionRefusedError):
                    data, sender = one.recvfrom(65_536)
                    self._pass(one, data, sender)

    def _pass(self, one: socket.socket, data: bytes, sender: tuple[str, int]) -> None:
        if self.silent or self._random.random() < self._loss:
            self.lost += 1
            return
        self.passed += 1
        if one is self._front:
            if sender not in self._backs:
                self._backs[sender] = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                self._backs[sender].bind(("127.0.0.1", 0))
            self._backs[sender].sendto(data, self._to)
        else:
            back = next(address for address, end in self._backs.items() if end is one)
            self._front.sendto(data, back)


def station(folder: Path, endpoint: str, **more: Any) -> LinkStation:
    """A ground that connects to a vehicle."""
    return LinkStation(folder, connect=[endpoint], name="anna", **more)
