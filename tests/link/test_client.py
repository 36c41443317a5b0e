"""The application's end of the link: what it gives and takes, and a process that dies or hangs."""

from __future__ import annotations

import asyncio
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from companion.config.link import LinkSettings
from companion.control.graph import Graph
from companion.errors import InputError
from companion.link.drawing import Drawing
from companion.link.ground.station import LinkStation
from companion.link.vehicle import client as clients
from companion.link.vehicle.client import LinkClient
from companion.link.words import Answer, Command
from sitl.launch.processes import free_tcp_port
from tests.link.exchange import MAP, Mine
from tests.link.rig import telemetry
from tests.mapping.journal.journals import held

STARTS_S = 60.0


async def until(holds: Callable[[], object], client: LinkClient, timeout_s: float = STARTS_S) -> None:
    """Until something holds; telemetry goes out meanwhile, as in a flight."""
    give_up_s = time.monotonic() + timeout_s
    number = int(time.monotonic() * 100)
    while not holds():
        assert time.monotonic() < give_up_s, "it did not happen in time"
        number += 1
        client.offer(telemetry(number))
        await asyncio.sleep(0.05)


def process_of_the_link() -> psutil.Process:
    """The newest child of this process that is of `multiprocessing`."""
    children = [one for one in psutil.Process().children() if "spawn_main" in " ".join(one.cmdline())]
    return max(children, key=lambda one: float(one.create_time()))


@pytest.fixture
def mine(tmp_path: Path) -> Mine:
    made = Mine(tmp_path / "vehicle")
    made.grow()
    return made


@pytest.mark.long
@pytest.mark.timeout(180)
async def test_a_process_that_dies_or_hangs_is_started_again_and_costs_the_flight_nothing(
    tmp_path: Path, mine: Mine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects the flight from its link, and the operator from a link that is gone for good."""
    monkeypatch.setattr(clients, "REST_S", (0.1,))
    monkeypatch.setattr(clients, "HUNG_S", 2.0)
    settings = LinkSettings(enabled=True, name="drone1", listen=(f"tcp/127.0.0.1:{free_tcp_port()}",), finish_s=20.0)
    obeyed: list[tuple[Command, str]] = []

    def obey(command: Command, who: str) -> Answer:
        obeyed.append((command, who))
        return Answer(accepted=False, reason="not now")

    journal = mine.folder / "map.journal"
    with LinkStation(tmp_path / "ground", connect=list(settings.listen), name="anna") as ground:
        async with LinkClient(settings, journal, obey, pytest.fail) as client:
            assert client.silent_s > 1e9, "nobody was heard yet"

            def heard() -> bool:
                return any(vehicle.age_s < 0.5 for vehicle in ground.vehicles())

            await until(heard, client)
            (vehicle,) = ground.vehicles()
            await client.draw(Drawing(Graph(), ((1.0, 2.0, 3.0),)))
            await until(lambda: client.silent_s < 2.0, client)
            for restarts, number in enumerate((signal.SIGKILL, signal.SIGSTOP), 1):
                process_of_the_link().send_signal(number)
                offered_s = time.monotonic()
                for _ in range(500):
                    client.offer(telemetry())
                assert time.monotonic() - offered_s < 0.5, "a pipe that nobody empties holds up nothing"
                await until(lambda: not heard(), client)
                await until(heard, client)
                assert client.restarts == restarts
            answers: list[Answer | None] = []
            vehicle.ask(Command.STOP, answers.append)
            await until(lambda: answers, client)
            assert answers == [Answer(accepted=False, reason="not now")]
            assert obeyed == [(Command.STOP, "anna")]
            mine.grow()
            await client.finish()
            assert held(vehicle.source()) == held(mine.journal), "the ground has fetched the end of the map"
    assert (tmp_path / "ground" / "drone1" / MAP).is_dir()


async def test_a_link_that_cannot_listen_is_told_of_and_is_tried_again(
    mine: Mine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects who looks for the reason why the ground hears nothing; the flight goes on."""
    monkeypatch.setattr(clients, "REST_S", (0.1,))
    told: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as other:
        settings = LinkSettings(enabled=True, listen=(f"tcp/127.0.0.1:{other.getsockname()[1]}",))
        journal = mine.folder / "map.journal"
        async with LinkClient(settings, journal, lambda *_: Answer(accepted=True), told.append) as client:
            await until(lambda: told and client.restarts, client)
    assert len(told) == 1, "once is enough"
    assert "is another program there" in told[0]


async def test_nobody_takes_off_with_certificates_that_can_never_do(tmp_path: Path, mine: Mine) -> None:
    settings = LinkSettings(enabled=True, certificates=str(tmp_path), listen=("tls/127.0.0.1:7447",))
    with pytest.raises(InputError, match="make it with `companion keys`"):
        async with LinkClient(settings, mine.folder / "map.journal", lambda *_: Answer(accepted=True), pytest.fail):
            pass
