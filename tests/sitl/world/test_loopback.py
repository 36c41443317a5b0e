"""The whole world on loopback: a fake autopilot tells the truth over UDP, and a client reads the stream."""

from __future__ import annotations

import asyncio
import json
import math
import signal
import socket
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.cli.main import main
from companion.clock import MonotonicClock
from companion.config.settings import Settings
from companion.model import Beam, Pose
from companion.sensors.drivers.stream import StreamDriver
from companion.sensors.sink import SensorSink, Taken
from sitl.launch.processes import free_tcp_port, free_udp_ports
from sitl.scene.raycast import RayCaster
from sitl.world.connection import PeerUrl
from sitl.world.mavlink_out import Feed
from sitl.world.odometry import OdometrySettings
from sitl.world.placement import Scene
from sitl.world.server import CONTACT, TERMINATED, Plan, WorldServer
from tests.shared.beside import until
from tests.sitl.scene.test_render import box
from tests.sitl.world.messages import Ned, heartbeat, hil

STAND = Pose(0.0, 5.0, 3.0, 0.15, math.pi / 2)
"""Looking along the y axis of a room of 20 x 6 x 3 m, at a wall 3 m away."""

SETTINGS = Settings.model_validate(
    {
        "sensors": {"camera": {"width_px": 64, "height_px": 48, "rate_hz": 10.0, "mount_x_m": 0.0}},
        "sim": {"noise": {"enabled": False}},
    }
)
BOOT_YAW_RAD = 1.0
"""Where the simulator happens to look by its compass."""


@pytest.fixture(scope="module")
def scene() -> Scene:
    world = box((0.0, 0.0, 0.0), (20.0, 6.0, 3.0))
    return Scene(world, RayCaster(world), STAND)


class FakeAutopilot(asyncio.DatagramProtocol):
    """Sends heartbeats and HIL_STATE_QUATERNION at 50 Hz, and keeps what it receives."""

    def __init__(self, system_id: int = 1) -> None:
        self.ahead_m = 0.0
        self.up_m = 0.0
        self.received: list[Any] = []
        self._sender = mavlink.MAVLink(None, system_id, 1)
        self._reader = mavlink.MAVLink(None)
        self.silent = False

    def datagram_received(self, data: bytes, addr: Any) -> None:  # noqa: ARG002 - asyncio's
        self.received.append(self._reader.decode(bytearray(data)))

    def error_received(self, exc: Exception) -> None:
        """The world is not there yet."""

    def names(self) -> set[str]:
        return {message.get_type() for message in self.received}

    async def run(self, port: int) -> None:
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(lambda: self, remote_addr=("127.0.0.1", port))
        try:
            for i in range(100_000):
                place: Ned = (self.ahead_m * math.cos(BOOT_YAW_RAD), self.ahead_m * math.sin(BOOT_YAW_RAD), -self.up_m)
                if self.silent:
                    await asyncio.sleep(0.02)
                    continue
                if i % 50 == 0:
                    transport.sendto(bytes(heartbeat(12).pack(self._sender)))
                transport.sendto(bytes(hil(place, BOOT_YAW_RAD).pack(self._sender)))
                await asyncio.sleep(0.02)
        finally:
            transport.close()


class Stage:
    """World, autopilot and a client of the stream; running in a block, which ends when the world does."""

    def __init__(self, scene: Scene, **options: Any) -> None:
        (self.port,) = free_udp_ports(1)
        stream = f"tcp://127.0.0.1:{free_tcp_port()}"
        clock = MonotonicClock()
        plan = Plan(PeerUrl("udp", "127.0.0.1", self.port), stream, **options)
        self.said: list[str] = []
        self.world = WorldServer(scene, SETTINGS, 1, plan, clock, self.said.append)
        self.autopilot = FakeAutopilot()
        self.sink = SensorSink(clock)
        self.driver = StreamDriver(stream, clock)

    async def __aenter__(self) -> Self:
        running = (self.world.run(), self.autopilot.run(self.port), self.driver.run(self.sink))
        self._running = [asyncio.create_task(one) for one in running]
        return self

    async def __aexit__(self, error: type[BaseException] | None, *_: object) -> None:
        try:
            if error is None:
                await asyncio.wait_for(self._running[0], 30.0)
        finally:
            for task in self._running:
                task.cancel()
            await asyncio.gather(*self._running, return_exceptions=True)

    async def newest(self) -> Taken:
        """Readings that were all taken from now on, depth among them."""
        began_s = MonotonicClock().now_s()
        while True:
            taken = self.sink.take()
            if taken.depth is not None and taken.depth.t_s > began_s and taken.ranges:
                return taken
            await asyncio.sleep(0.13)


async def test_what_the_vehicle_sees_is_what_stands_before_it(scene: Scene, tmp_path: Path) -> None:
    """It hovers 1.35 m up, 1 m ahead of its start: the wall is 2 m away, whatever its compass said at boot.

    And a SIGTERM ends it in good order, with the score of what happened.
    """
    async with Stage(
        scene,
        feed=Feed.ODOMETRY,
        odometry=OdometrySettings(position_noise_m=0.0, drift_share=0.0, attitude_noise_rad=0.0),
        send_distance_sensor=True,
        send_obstacle_distance=True,
        gps=False,
        score=tmp_path / "score.json",
        trajectory=tmp_path / "trajectory.csv",
    ) as stage:
        await until(lambda: stage.sink.take().depth is not None)
        stage.autopilot.up_m = 1.35
        await asyncio.sleep(0.3)
        stage.autopilot.ahead_m = 1.0
        await asyncio.sleep(0.3)
        taken = await asyncio.wait_for(stage.newest(), 10.0)
        assert taken.depth is not None
        # The grid of the truth leaves 2.2 cm, twice, along either axis.
        assert float(taken.depth.depth_m[24, 32]) == pytest.approx(2.0, abs=0.05)
        ranges = {reading.beam: reading.range_m for reading in taken.ranges}
        assert ranges[Beam.FRONT] == pytest.approx(2.0, abs=0.05)
        assert ranges[Beam.DOWN] == pytest.approx(1.5, abs=0.01)
        assert ranges[Beam.LEFT] == pytest.approx(5.0, abs=0.05)
        wanted = {"ODOMETRY", "DISTANCE_SENSOR", "OBSTACLE_DISTANCE", "HEARTBEAT", "SET_GPS_GLOBAL_ORIGIN"}
        await until(lambda: wanted <= stage.autopilot.names())
        odometry = [m for m in stage.autopilot.received if m.get_type() == "ODOMETRY"][-1]
        assert (odometry.x, odometry.y, odometry.z) == pytest.approx((1.0, 0.0, -1.35), abs=0.05)
        signal.raise_signal(signal.SIGTERM)
    assert len(stage.said) == 1, "one line at the start"
    score = json.loads((tmp_path / "score.json").read_text())
    assert score["ended_because"] == TERMINATED
    assert score["contacts"] == 0
    assert score["least_d_m"] == pytest.approx(2.0, abs=0.05)
    assert score["path_length_m"] == pytest.approx(2.35, abs=0.15)
    assert score["odometry_sent"] > 10
    assert len((tmp_path / "trajectory.csv").read_text().splitlines()) > 10


async def test_odometry_that_has_an_address_of_its_own_goes_there_alone(scene: Scene, tmp_path: Path) -> None:
    """Protects the gate's view of it: what also went to the autopilot directly would hide what the gate holds back."""
    gate = FakeAutopilot()
    there = ("127.0.0.1", free_udp_ports(1)[0])
    options: dict[str, Any] = {"feed": Feed.ODOMETRY, "odometry_to": PeerUrl("udpout", *there, "--odometry-to")}
    async with Stage(scene, **options, send_distance_sensor=True, gps=False, score=tmp_path / "score.json") as stage:
        await until(lambda: stage.sink.take().depth is not None)
        # The gate comes later than the world, which goes on.
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(lambda: gate, local_addr=there)
        await until(lambda: {"ODOMETRY", "HEARTBEAT"} <= gate.names())
        wanted = {"HEARTBEAT", "DISTANCE_SENSOR", "SET_GPS_GLOBAL_ORIGIN"}
        await until(lambda: wanted <= stage.autopilot.names())
        stage.world.stop("done")
    transport.close()
    assert gate.names() == {"ODOMETRY", "HEARTBEAT"}
    assert "ODOMETRY" not in stage.autopilot.names()
    assert {m.type for m in gate.received if m.get_type() == "HEARTBEAT"} == {mavlink.MAV_TYPE_ONBOARD_CONTROLLER}
    assert str(there[1]) in stage.said[0]
    assert json.loads((tmp_path / "score.json").read_text())["odometry_sent"] > 10


async def test_a_contact_ends_it_where_that_was_asked_for(scene: Scene, tmp_path: Path) -> None:
    """A test of a flight must not go on for minutes after the vehicle has hit the wall."""
    async with Stage(scene, stop_on_contact=True, score=tmp_path / "score.json") as stage:
        await until(lambda: stage.sink.take().depth is not None)
        stage.autopilot.up_m = 1.35
        await asyncio.sleep(0.5)
        stage.autopilot.ahead_m = 2.8
    score = json.loads((tmp_path / "score.json").read_text())
    assert (score["ended_because"], score["contacts"]) == (CONTACT, 1)


async def test_another_vehicle_on_the_port_moves_nothing(scene: Scene, tmp_path: Path) -> None:
    """Two vehicles and a wrong port number: theirs is counted, ours is shown."""
    other = FakeAutopilot(system_id=2)
    other.ahead_m, other.up_m = 2.8, 1.35
    async with Stage(scene, score=tmp_path / "score.json") as stage:
        task = asyncio.create_task(other.run(stage.port))
        await until(lambda: stage.sink.take().depth is not None)
        await asyncio.sleep(0.5)
        task.cancel()
        stage.world.stop("done")
    score = json.loads((tmp_path / "score.json").read_text())
    assert (score["ended_because"], score["contacts"], score["path_length_m"]) == ("done", 0, 0.0)
    assert other.received == []


async def test_a_silent_simulator_is_a_silent_world(scene: Scene) -> None:
    """No truth, no readings: repeating the last picture would tell a navigator that all is well."""
    async with Stage(scene) as stage:
        await until(lambda: stage.sink.take().depth is not None)
        stage.autopilot.silent = True
        await asyncio.sleep(0.3)
        stage.sink.take()
        await asyncio.sleep(0.5)
        assert stage.sink.take() == Taken(None, (), None)
        stage.world.stop("done")


def test_ports_that_are_taken_are_the_users_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    """One plain line with the option, before minutes of loading where that is possible."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        for arguments, said in (
            (["--truth", "14560"], "--truth"),
            (["--odometry", "odometry", "--truth-from", "local"], "--truth-from local"),
            (["--odometry", "odometry", "--odometry-hz", "100"], "--truth-hz"),
            (["--odometry-to", "udpout://127.0.0.1:1"], "needs --odometry odometry"),
            (["--odometry", "odometry", "--odometry-to", "udp://127.0.0.1:1"], "give udpout://HOST:PORT"),
            (["--world", "room", "--truth", f"udp://127.0.0.1:{port}", "--stream", "tcp://127.0.0.1:0"], str(port)),
        ):
            with pytest.raises(SystemExit) as ended:
                main(["sitl", "world", *arguments])
            assert ended.value.code == 2
            assert said in capsys.readouterr().err


async def test_the_camera_of_the_stream_is_that_of_the_settings(scene: Scene) -> None:
    """What is rendered and what the client is sent must be one camera."""
    async with Stage(scene) as stage:
        taken = await asyncio.wait_for(stage.newest(), 10.0)
        assert taken.depth is not None
        assert taken.depth.camera == SETTINGS.sensors.camera.model()
        assert taken.depth.depth_m.dtype == np.float32
        stage.world.stop("done")
