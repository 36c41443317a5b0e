"""What goes on to whom between the connections of an autopilot."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from companion.clock import MonotonicClock
from companion.model import Pose
from sitl.autopilot import ARDUPILOT, PX4, Autopilot, Personality
from sitl.autopilot.codec import Decoder
from sitl.autopilot.endpoint import Endpoint
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.routing import GROUND_STATION_SILENT_S, Routes
from tests.sitl.autopilot.rig import command_long

LOOPBACK = "127.0.0.1"
STATION, GATE = (255, 190), (1, 191)
BOTH = pytest.mark.parametrize("personality", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])


def heartbeat(kind: int) -> Message:
    return m.MAVLink_heartbeat_message(kind, m.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3)


def arrived(message: Message, source: tuple[int, int]) -> Message:
    (received,) = Decoder().messages(message.pack(m.MAVLink(None, *source)))
    return received


def to(component: int, system: int = 1) -> Message:
    return m.MAVLink_command_long_message(system, component, m.MAV_CMD_DO_PAUSE_CONTINUE, 0, *[0.0] * 7)


def routes(texts_only_to_ground_stations: bool = True) -> Routes[str]:
    """A gate at one end, a ground station at the other, and somebody who has only listened."""
    found = Routes[str](1, texts_only_to_ground_stations)
    found.heard("14540", arrived(heartbeat(m.MAV_TYPE_ONBOARD_CONTROLLER), GATE), 0.0)
    found.heard("14550", arrived(heartbeat(m.MAV_TYPE_GCS), STATION), 0.0)
    return found


@pytest.mark.parametrize(
    ("message", "goes_to"),
    [
        (to(191), ["14540"]),
        (to(192), []),
        (to(1), []),
        (to(0), ["14540"]),
        (to(0, system=0), ["14540"]),
        (to(190, system=2), []),
        (heartbeat(m.MAV_TYPE_GCS), ["14540"]),
    ],
    ids=["191", "192", "the autopilot", "all of its system", "all", "another system", "without a target"],
)
def test_a_message_goes_on_where_its_target_was_heard(message: Message, goes_to: list[str]) -> None:
    """Never back where it came from, and not at all when it is the autopilot's alone."""
    assert routes().onward("14550", arrived(message, STATION)) == goes_to


def test_texts_leave_only_where_a_ground_station_was_heard() -> None:
    """And no longer than its heartbeats come; ArduPilot sends them to all."""
    text = m.MAVLink_statustext_message(2, b"Failsafe activated\t")
    px4 = routes()
    assert [px4.takes(way, text, 1.0) for way in ("14540", "14550", "14560")] == [False, True, False]
    assert not px4.takes("14550", text, GROUND_STATION_SILENT_S + 0.1)
    assert px4.takes("14540", m.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0), 1.0)
    assert all(routes(False).takes(way, text, 1.0) for way in ("14540", "14550", "14560"))


def test_a_late_acknowledgement_goes_where_its_receiver_was_heard() -> None:
    """Not to those who have not asked."""
    acknowledgement = m.MAVLink_command_ack_message(176, 0, 0, 0, *GATE)
    assert [routes().takes(way, acknowledgement, 1.0) for way in ("14540", "14550", "14560")] == [True, False, False]


def test_a_connection_that_is_gone_is_forgotten() -> None:
    """And nobody can fill the table."""
    table = routes()
    table.forget(["14540", "14560"])
    assert table.onward("14550", arrived(to(191), STATION)) == []
    for component in range(2, 200):
        table.heard("14550", arrived(heartbeat(6), (7, component)), 0.0)
    assert table.onward("14540", arrived(to(3, system=7), GATE)) == ["14550"]
    assert table.onward("14540", arrived(to(199, system=7), GATE)) == []


@asynccontextmanager
async def between(personality: Personality) -> AsyncIterator[tuple[Endpoint, socket.socket, socket.socket]]:
    """An endpoint that sends to two sockets of ours: the application's and the ground station's."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as application,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
    ):
        for end in (application, station):
            end.bind((LOOPBACK, 0))
            end.setblocking(False)
        vehicle = Autopilot(personality, Pose(0.0, 0.0, 0.0, 0.0, 0.0), gps=False, boot_s=0.2)
        to_both = [application.getsockname(), station.getsockname()]
        endpoint = Endpoint(vehicle, MonotonicClock(), to_both, bind=(LOOPBACK, 0))
        ready = asyncio.Event()
        task = asyncio.create_task(endpoint.run(ready.set))
        try:
            async with asyncio.timeout(25.0):
                await ready.wait()
                yield endpoint, application, station
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)


async def said_for(end: socket.socket, seconds: float) -> list[Message]:
    """Everything that arrives there."""
    loop, found = asyncio.get_running_loop(), list[Message]()
    until_s = loop.time() + seconds
    while (left_s := until_s - loop.time()) > 0.0:
        try:
            found += Decoder().messages(await asyncio.wait_for(loop.sock_recv(end, 4096), left_s))
        except TimeoutError:
            break
    return found


@BOTH
async def test_a_ground_station_reaches_the_gate_through_the_autopilot(personality: Personality) -> None:
    """Its stop to component 191 arrives at 14540, with its own sender; the answer comes back."""
    async with between(personality) as (endpoint, application, station):
        at = (LOOPBACK, endpoint.udp_port or 0)
        application.sendto(heartbeat(m.MAV_TYPE_ONBOARD_CONTROLLER).pack(m.MAVLink(None, *GATE)), at)
        await asyncio.sleep(0.05)
        station.sendto(to(191).pack(m.MAVLink(None, *STATION)), at)
        heard = await said_for(application, 0.3)
        (stop,) = [x for x in heard if x.get_type() == "COMMAND_LONG"]
        assert (stop.get_srcSystem(), stop.get_srcComponent()) == STATION
        answer = m.MAVLink_command_ack_message(stop.command, 0, 0, 0, *STATION)
        application.sendto(answer.pack(m.MAVLink(None, *GATE)), at)
        acknowledged = [x for x in await said_for(station, 0.3) if x.get_type() == "COMMAND_ACK"]
        assert [x.get_srcComponent() for x in acknowledged] == [191]


@BOTH
async def test_refusals_reach_the_application_as_text_or_as_event(personality: Personality) -> None:
    """PX4 tells the application with an EVENT, and a ground station in words too."""
    async with between(personality) as (endpoint, application, station):
        at = (LOOPBACK, endpoint.udp_port or 0)
        station.sendto(heartbeat(m.MAV_TYPE_GCS).pack(m.MAVLink(None, *STATION)), at)
        await asyncio.sleep(0.05)
        arming = command_long(m.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        application.sendto(arming.pack(m.MAVLink(None, *GATE)), at)
        heard, seen = await asyncio.gather(said_for(application, 0.4), said_for(station, 0.4))
        kinds = {x.get_type() for x in heard} & {"STATUSTEXT", "EVENT"}
        assert kinds == ({"EVENT"} if personality is PX4 else {"STATUSTEXT"})
        assert "STATUSTEXT" in {x.get_type() for x in seen}


async def test_a_slow_clock_is_slow_for_vehicle_and_stamps() -> None:
    """As a simulator that cannot keep up."""
    vehicle = Autopilot(PX4, Pose(0.0, 0.0, 0.0, 0.0, 0.0), boot_s=0.2)
    clock = MonotonicClock()
    endpoint = Endpoint(vehicle, clock, [], bind=(LOOPBACK, 0), clock_rate=0.9)
    begun_s = clock.now_s()
    task = asyncio.create_task(endpoint.run())
    await asyncio.sleep(1.0)
    share = vehicle.state.since_boot_s / (clock.now_s() - begun_s)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
    assert share == pytest.approx(0.9, abs=0.04)
