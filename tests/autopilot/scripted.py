"""A small autopilot on a `FakeLink`, as much of PX4 and ArduPilot as the vehicle can tell apart, and a flight on it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

from companion.autopilot.interface import LinkError
from companion.autopilot.telemetry import Telemetry
from companion.autopilot.vehicle import Vehicle
from companion.config.settings import Settings
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavState
from companion.mavlink.modes import px4_mode
from companion.model import Setpoint
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock

PX4_TAKEOFF, PX4_HOLD, PX4_LAND, PX4_OFFBOARD = px4_mode(4, 2), px4_mode(4, 3), px4_mode(4, 6), px4_mode(6)
PX4_POSITION = px4_mode(3)
GUIDED, LOITER, LAND, BRAKE = 4, 5, 9, 17
ATTITUDE = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
STEP_S = 0.05
FAILSAFE_S = 0.5
IDLE_S = 10.0
HIGHEST_M = 3.0


class ScriptedLink(FakeLink):
    """A `FakeLink` whose commands are answered by a `ScriptedAutopilot`."""

    answer: Callable[[int, tuple[float, ...]], int]

    async def command(self, command: int, *params: float, timeout_s: float = 2.0) -> int:
        """Record the command and give the autopilot's answer."""
        self.commands.append((command, params))
        if self.on_command is not None:
            self.on_command(command, params)
        if self.gone:
            raise LinkError(f"no answer to command {command} within {timeout_s} s")
        return self.answer(command, params)


class ScriptedAutopilot:
    """Answers commands, flies up and down, and tells once a second what it is up to.

    Attributes:
        highest_m: that it has flown.
        lifts: whether it takes off at all.
        ends_take_off_at: share of the height asked for at which PX4's take-off turns into hold and creeps no further.
        hold_allowed: whether it can hold.
        refuses_to_arm: texts with which it refuses, used up in order.
        refuses_to_take_off: whether it does that.
        ignores_modes: accepts modes and does not take them.
        heartbeats: whether it still sends any.
        deaf: whether setpoints no longer reach it.
    """

    def __init__(self, link: ScriptedLink, clock: HandClock) -> None:
        self.link, self.clock = link, clock
        self.px4 = link.kind is AutopilotKind.PX4
        self.mode = PX4_HOLD if self.px4 else BRAKE
        self.armed = False
        self.height_m = self.highest_m = 0.0
        self.lifts = True
        self.ends_take_off_at = 1.0
        self.hold_allowed = True
        self.refuses_to_arm: list[str] = []
        self.refuses_to_take_off = False
        self.ignores_modes = False
        self.heartbeats = True
        self.deaf = False
        self.events: list[tuple[float, Callable[[], None]]] = []
        self.suppressed = False
        self._failsafe = False
        self._target_m = 0.0
        self._climb_mps = 0.0
        self._setpoint_s = -1e9
        self._armed_s = 0.0
        self._heartbeat_s = clock.now_s()
        link.params.setdefault("MIS_TAKEOFF_ALT", 2.5)
        link.answer = self._command
        link.on_send = self._send
        clock.pass_by = self._pass_by

    def at(self, after_s: float, what: Callable[[], None]) -> None:
        """Something happens some time from now."""
        self.events.append((self.clock.now_s() + after_s, what))

    def measured_m(self) -> float | None:
        """What the beam that looks down measures."""
        return self.height_m + 0.1

    def heartbeat(self) -> None:
        """Says what it is up to, and whether it stands on the ground."""
        self.link.deliver("EXTENDED_SYS_STATE", {"landed_state": 1 if self.height_m == 0.0 else 2})
        status = MavState.CRITICAL if self._failsafe else MavState.ACTIVE
        self.link.deliver(
            "HEARTBEAT",
            {"custom_mode": self.mode, "base_mode": 128 if self.armed else 0, "system_status": status},
        )

    def moves(self, speed_mps: float) -> None:
        """Says how fast it is, by a position and the attitude of the same time."""
        boot_ms = round(1000.0 * self.clock.now_s())
        self.link.deliver("ATTITUDE", {"time_boot_ms": boot_ms, **dict.fromkeys(ATTITUDE, 0.0)})
        position = {"x": 0.0, "y": 0.0, "z": -self.height_m, "vx": speed_mps, "vy": 0.0, "vz": 0.0}
        self.link.deliver("LOCAL_POSITION_NED", {"time_boot_ms": boot_ms, **position})

    def say(self, text: str) -> None:
        """A STATUSTEXT."""
        self.link.deliver("STATUSTEXT", {"severity": 2, "text": text})

    def _pass_by(self, time_s: float) -> None:
        until_s = self.clock.now_s() + time_s
        while (left_s := until_s - self.clock.now_s()) > 1e-9:
            self._step(min(STEP_S, left_s))

    def _step(self, dt_s: float) -> None:
        self.clock.advance(dt_s)
        now_s = self.clock.now_s()
        for event in [event for event in self.events if event[0] <= now_s]:
            self.events.remove(event)
            event[1]()
        if self.armed:
            self._fly(dt_s, now_s)
        if self.heartbeats and now_s - self._heartbeat_s >= 1.0:
            self._heartbeat_s = now_s
            self.heartbeat()

    def _fly(self, dt_s: float, now_s: float) -> None:
        streaming = now_s - self._setpoint_s < FAILSAFE_S
        if self.mode == PX4_OFFBOARD and not streaming:
            self.mode, self._failsafe = PX4_HOLD, True
        if self.mode in (PX4_OFFBOARD, GUIDED) and streaming and not self.suppressed:
            self.height_m = min(max(self.height_m + self._climb_mps * dt_s, 0.0), HIGHEST_M)
        elif self.mode in (PX4_LAND, LAND):
            self.height_m = max(self.height_m - 0.5 * dt_s, 0.0)
            if self.height_m == 0.0:
                self.armed = False
        elif self._target_m > 0.0 and self.mode in (PX4_TAKEOFF, GUIDED) and self.lifts and not self.suppressed:
            self.height_m = min(self.height_m + 0.4 * dt_s, self._target_m)
            if self.mode == PX4_TAKEOFF and self.height_m == self._target_m:
                self.mode = PX4_HOLD
        self.highest_m = max(self.highest_m, self.height_m)
        if self.height_m == 0.0 and now_s - self._armed_s > IDLE_S:
            self.armed = False

    def _command(self, command: int, params: tuple[float, ...]) -> int:
        now_s = self.clock.now_s()
        result = 0
        if command == 176:
            mode = px4_mode(int(params[1]), int(params[2])) if self.px4 else int(params[1])
            if mode == PX4_HOLD and not self.hold_allowed:
                result = 1
                self.say("Hold not available")
            elif mode == PX4_OFFBOARD and now_s - self._setpoint_s > FAILSAFE_S:
                result = 1
            elif not self.ignores_modes:
                self.mode, self._failsafe = mode, False
        elif command == 400 and params[0] == 1.0:
            if self.mode == BRAKE:
                self.say("Arm: BRAKE mode not armable")
                result = 4
            elif self.refuses_to_arm:
                self.say(self.refuses_to_arm.pop(0))
                result = 4
            else:
                self.armed, self._armed_s = True, now_s
        elif command == 400:
            result = 0 if self.height_m == 0.0 else 4
            self.armed = self.armed and result != 0
        elif command == 22 and self.refuses_to_take_off:
            result = 2
        elif command == 22:
            height_m = float(self.link.params["MIS_TAKEOFF_ALT"]) if self.px4 else params[6]
            self._target_m = (height_m - 0.1) * self.ends_take_off_at
            if self.px4:
                self.mode = PX4_TAKEOFF
        return result

    def _send(self, name: str, fields: dict[str, Any]) -> None:
        if name != "SET_POSITION_TARGET_LOCAL_NED":
            return
        if self.deaf:
            return
        self._setpoint_s = self.clock.now_s()
        if self._failsafe and self.mode == PX4_HOLD:
            # As measured: it returns to offboard by itself, at once.
            self.mode, self._failsafe = PX4_OFFBOARD, False
        self._climb_mps = -fields["vz"]
        if not self.px4 and self.height_m == 0.0:
            self.suppressed = True


# A vehicle on an autopilot that does what the real ones did, and no time but what the test lets pass.


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
        return self.link.sent_named("SET_POSITION_TARGET_LOCAL_NED")

    @property
    def modes_asked(self) -> list[tuple[float, ...]]:
        """The parameters of all commands that ask for a mode."""
        return [params for command, params in self.link.commands if command == 176]


@asynccontextmanager
async def flying(kind: AutopilotKind, gps: bool = True, end: str = "land") -> AsyncIterator[Flight]:
    """A vehicle that follows setpoints while the block lasts, and is left at its end."""
    one = Flight(kind, gps, end)
    async with one.vehicle:
        await one.up_and_engaged()
        yield one
