"""A vehicle on an autopilot that does what the real ones did, and no time but what the test lets pass."""

from __future__ import annotations

from typing import Any

from companion.autopilot.telemetry import Telemetry
from companion.autopilot.vehicle import Vehicle
from companion.config.settings import Settings
from companion.mavlink.firmware import AutopilotKind
from companion.model import Setpoint
from tests.autopilot.scripted import ScriptedAutopilot, ScriptedLink
from tests.shared.clocks import HandClock

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
KINDS = (PX4, ARDUPILOT)
H_M = 1.5


class Flight:
    """A vehicle on a scripted autopilot, and a clock that only its sleeping moves."""

    def __init__(self, kind: AutopilotKind, gps: bool = True, end: str = "land") -> None:
        self.clock = HandClock()
        self.link = ScriptedLink(self.clock, kind)
        self.autopilot = ScriptedAutopilot(self.link, self.clock)
        self.settings = Settings.model_validate({"autopilot": {"gps": gps}, "mission": {"end_action": end}})
        self.telemetry = Telemetry(self.link, self.clock, self.settings)
        self.vehicle = Vehicle(self.link, self.telemetry, self.settings, self.clock)
        self.autopilot.heartbeat()

    async def up(self) -> None:
        """Take off."""
        await self.vehicle.take_off(H_M, self.autopilot.measured_m)

    async def up_and_engaged(self) -> None:
        """Take off, and have the autopilot follow setpoints."""
        await self.up()
        await self.vehicle.engage()

    async def cruise(self, time_s: float, speed_mps: float = 0.5) -> list[bool]:
        """Send a setpoint every 50 ms, as the application does."""
        went: list[bool] = []
        until_s = self.clock.now_s() + time_s
        while self.clock.now_s() < until_s:
            went.append(self.vehicle.send(Setpoint(self.clock.now_s(), speed_mps, 0.0, 0.0)))
            await self.clock.sleep(0.05)
        return went

    @property
    def setpoints(self) -> list[dict[str, Any]]:
        """All that were sent."""
        return self.link.sent_named("SET_POSITION_TARGET_LOCAL_NED")

    @property
    def modes_asked(self) -> list[tuple[float, ...]]:
        """The parameters of all commands that ask for a mode."""
        return [params for command, params in self.link.commands if command == 176]
