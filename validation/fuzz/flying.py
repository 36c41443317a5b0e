"""A vehicle that explores, on a link without an autopilot: every part of the application that receives MAVLink."""

from __future__ import annotations

import asyncio
import json
import logging
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from companion import station_keeping
from companion.autopilot import inbox
from companion.autopilot.commands import Commands
from companion.autopilot.link import _to_wire
from companion.autopilot.status_reporter import StatusReporter
from companion.autopilot.telemetry import Telemetry
from companion.autopilot.vehicle import Vehicle
from companion.config.sensors import CameraSettings, PlanarSettings, SensorSettings
from companion.config.settings import Settings
from companion.control import standing
from companion.flight.control_loop import ControlLoop, Rate
from companion.flight.events import EventEmitter, console, recording, status_text
from companion.flight.mavlink_commands import MavlinkCommands, Refusals
from companion.flight.operator_commands import OperatorCommands
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.flight.reporting import TickReporter
from companion.mapping.process.client import MapClient
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd
from companion.mavlink.modes import personality, px4_mode
from companion.model import ABSURD, Setpoint
from companion.pipeline import Explorer, Tick
from companion.recording import Recorder
from companion.recording.channels import COMMANDED
from companion.sensors.drivers.mavlink import MavlinkDriver
from companion.sensors.sink import RawDepth, SensorSink
from companion.sensors.synchronizer import Synchronizer
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock

SETTINGS = Settings(
    sensors=SensorSettings(camera=CameraSettings(width_px=32, height_px=24), planar=PlanarSettings(enabled=True))
)
CAMERA = SETTINGS.sensors.camera.model()
WALL_M, HEIGHT_M, SPEED_MPS = 4.0, 1.5, 0.4
BOOTED_S = 937.0
"""When the autopilot was switched on, by our clock."""


class Faults(logging.Handler):
    """Collects what listeners did not digest: the inbox catches it, so that nothing else would show it."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.seen: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.seen.append(f"{record.getMessage()[:300]}: {record.exc_info and record.exc_info[1]!r}")


class StrictLink(FakeLink):
    """Takes only what the real link would put on the wire."""

    def send(self, name: str, fields: Any) -> None:
        json.dumps({key: _to_wire(value) for key, value in fields.items()}, allow_nan=False)
        super().send(name, fields)


class Flying:
    """The application in the air. The true vehicle flies north at a constant speed; `good` says what of it comes in.

    Attributes:
        good: which of the true inputs come: "pose", "depth", "down", "heartbeat".
        mode: what the true heartbeat says.
    """

    def __init__(self, kind: AutopilotKind = AutopilotKind.PX4) -> None:
        self.clock = HandClock()
        self.link = StrictLink(self.clock, kind)
        self.modes = personality(kind)
        self.mode, self.armed = self.modes.hold, True
        self.good = {"pose", "depth", "down", "heartbeat"}
        self.sink = SensorSink(self.clock)
        self.telemetry = Telemetry(self.link, self.clock, SETTINGS)
        self.vehicle = Vehicle(self.link, self.telemetry, SETTINGS, self.clock)
        self.flight = PhaseMachine()
        self.operator = OperatorCommands(by_command=True, flight=self.flight)
        MavlinkCommands(self.operator, self.link, Refusals(EventEmitter(console(self._say)), self.clock))
        self.commands = Commands(self.link.send, 1)
        self.link.events("COMMAND_ACK", self.commands.acknowledged)
        self.status_reporter = StatusReporter(self.link, self.clock)
        self.driver = MavlinkDriver(self.link, self.clock, {"DISTANCE_SENSOR": 20.0, "OBSTACLE_DISTANCE": 10.0})
        self.said: list[str] = []
        explorer = Explorer(SETTINGS, np.random.default_rng(1))
        recorder = cast("Recorder", SimpleNamespace(event=lambda _name, text, *_: text.encode()))
        reporter = TickReporter(
            EventEmitter(console(self._say), status_text(self.status_reporter), recording(recorder)),
            self.status_reporter,
            self.telemetry,
            cast("MapClient", SimpleNamespace(status=SimpleNamespace(completeness=0.5, frontiers=3, problem=""))),
            self.flight,
            self.sink.warnings,
        )
        self.control_loop = ControlLoop(
            Synchronizer(self.sink, self.telemetry.poses),
            explorer,
            Rate(self.clock, SETTINGS.control.period_s),
            self.flight,
            self.vehicle.send,
            (reporter,),
        )
        self.faults = Faults()
        self.count = 0

    def heartbeat(self) -> dict[str, Any]:
        """The true one."""
        return {"type": 2, "autopilot": 12, "base_mode": 128 if self.armed else 0, "custom_mode": self.mode} | {
            "system_status": 4,
            "mavlink_version": 3,
        }

    def north_m(self) -> float:
        """Where the vehicle truly is."""
        return SPEED_MPS * (self.clock.now_s() - 1000.0)

    def attitude(self) -> dict[str, Any]:
        """The true one."""
        stamp = {"time_boot_ms": int(1000.0 * (self.clock.now_s() - BOOTED_S))}
        return stamp | {"roll": 0.01, "pitch": -0.02, "yaw": 0.0, "rollspeed": 0.0, "pitchspeed": 0.0, "yawspeed": 0.0}

    def position(self) -> dict[str, Any]:
        """The true one."""
        stamp = {"time_boot_ms": int(1000.0 * (self.clock.now_s() - BOOTED_S))}
        return stamp | {"x": self.north_m(), "y": 0.0, "z": -HEIGHT_M, "vx": SPEED_MPS, "vy": 0.0, "vz": 0.0}

    def distance(self) -> dict[str, Any]:
        """The true one, downwards."""
        stamp = {"time_boot_ms": int(1000.0 * (self.clock.now_s() - BOOTED_S))}
        return stamp | {
            "min_distance": 10,
            "max_distance": 800,
            "current_distance": int(100 * HEIGHT_M),
            "type": 0,
            "id": 1,
            "orientation": 25,
            "covariance": 0,
            "signal_quality": 0,
        }

    def step(self) -> None:
        """25 ms pass, and what is true comes in."""
        self.count += 1
        self.clock.advance(0.025)
        if "heartbeat" in self.good and self.count % 40 == 0:
            self.link.deliver("HEARTBEAT", self.heartbeat())
        if "pose" in self.good:
            self.link.deliver("ATTITUDE", self.attitude())
            self.link.deliver("LOCAL_POSITION_NED", self.position())
        if "down" in self.good:
            self.link.deliver("DISTANCE_SENSOR", self.distance())
        if "depth" in self.good:
            # No two images of a camera are alike to the last bit: a frozen one is not believed.
            depth_m = np.full((CAMERA.height_px, CAMERA.width_px), WALL_M + 0.001 * (self.count % 50), np.float32)
            self.sink.depth(RawDepth(self.clock.now_s() - 0.03, depth_m, CAMERA))

    def tick(self) -> Tick:
        """One tick of the application, and whether it still makes sense."""
        before = len(self.link.sent)
        if self.count % 4 == 0:
            self.telemetry.ask(self.clock.now_s())
        record = self.control_loop.tick(self.clock.now_s())
        self.status_reporter.tick()
        self.check_state()
        for name, fields in self.link.sent[before:]:
            if name == "SET_POSITION_TARGET_LOCAL_NED":
                check_setpoint(fields)
        if record.observation is not None:
            check_pose(record.observation.pose)
            if record.observation.frame is not None:
                check_pose(record.observation.frame.pose)
        assert record.sent == ("SET_POSITION_TARGET_LOCAL_NED" in [name for name, _ in self.link.sent[before:]])
        assert self.faults.seen == [], self.faults.seen
        del self.link.sent[:]
        return record

    def check_state(self) -> None:
        """What the telemetry says of the vehicle is possible."""
        state = self.telemetry.state(self.clock.now_s())
        assert state.battery_percent is None or 0.0 <= state.battery_percent <= 100.0
        assert state.heartbeat_age_s >= 0.0
        assert len(self.telemetry.texts) <= 20
        assert all(len(text.text) <= 300 for text in self.telemetry.texts)

    def moves(self, setpoint: Setpoint | None) -> bool:
        """Whether a setpoint asks for any motion."""
        return setpoint is not None and any(getattr(setpoint, name) for name in COMMANDED)

    def _say(self, line: str) -> None:
        """Prints as a terminal in UTF-8 would."""
        line.encode()
        assert line.isprintable(), line
        self.said.append(line)
        del self.said[:-20]

    def obey(self, command: int, parameters: tuple[float, ...]) -> None:
        """The autopilot takes the mode that it is asked for."""
        if command == MavCmd.DO_SET_MODE:
            is_px4 = self.link.kind is AutopilotKind.PX4
            self.mode = px4_mode(int(parameters[1]), int(parameters[2])) if is_px4 else int(parameters[1])
            self.link.deliver("HEARTBEAT", self.heartbeat())


def check_setpoint(fields: dict[str, Any]) -> None:
    """Within the configured limits, to our autopilot, as body velocity."""
    law = SETTINGS.control
    assert (fields["target_system"], fields["target_component"]) == (1, 1)
    assert (fields["coordinate_frame"], fields["type_mask"]) == (8, 0x5C7)
    # Backward and sideways goes only what has crept away from where it stands, or what a wall has come near.
    most_mps = max(standing.AWAY_MPS, station_keeping.MOST_MPS) + 1e-6
    assert -most_mps <= fields["vx"] <= law.speed_mps + 1e-9, fields
    assert abs(fields["vy"]) <= most_mps, fields
    assert abs(fields["vz"]) <= law.max_climb_mps + 1e-9, fields
    assert abs(fields["yaw_rate"]) <= law.max_yaw_rate_radps + 1e-9, fields


def check_pose(pose: Any) -> None:
    """Finite, and on this planet."""
    values = [getattr(pose, name) for name in pose.__slots__]
    assert all(isinstance(value, float) and math.isfinite(value) and abs(value) < ABSURD for value in values), pose


@asynccontextmanager
async def flying(kind: AutopilotKind = AutopilotKind.PX4, explore: bool = True) -> AsyncIterator[Flying]:
    """A vehicle on the ground side of things: connected, and when ``explore`` also engaged and exploring."""
    bench = Flying(kind)
    logger = logging.getLogger(inbox.__name__)
    logger.addHandler(bench.faults)
    driving = asyncio.create_task(bench.driver.run(bench.sink))
    try:
        await asyncio.sleep(0)
        bench.link.deliver("HEARTBEAT", bench.heartbeat())
        if explore:
            bench.link.on_command = bench.obey
            await bench.vehicle.engage()
            bench.flight.phase = FlightPhase.EXPLORING
        yield bench
    finally:
        driving.cancel()
        await asyncio.gather(driving, return_exceptions=True)
        logger.removeHandler(bench.faults)
