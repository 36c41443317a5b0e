"""The vehicle as the application flies it: take off, engage, one setpoint a tick, hold, land.

Left behind, it holds or lands. When somebody else takes it, a pilot or a failsafe of the autopilot, they are obeyed at
once and it is never taken back.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from typing import Self

from companion.autopilot.interface import Link
from companion.autopilot.mode_control import POLL_S, FlightError, ModeControl, TakenOver
from companion.autopilot.offboard import OffboardControl
from companion.autopilot.take_off import TakeOff
from companion.autopilot.telemetry import Telemetry
from companion.clock import Clock
from companion.config.settings import Settings
from companion.control.ramp import Ramp
from companion.errors import CompanionError
from companion.model import Setpoint
from companion.station_keeping import PATIENCE_S, STANDS_MPS

LAND_S = 60.0
LAND_MPS = 0.3
"""Downward, where we land by setpoints: slow enough to touch down with."""
LEAVE_S = 8.0
"""The end of the block may take this long: two modes to ask for, each shown by a heartbeat."""
LEAVE_COMMAND_S = 2.0
"""Time for each acknowledgement then."""

__all__ = ["FlightError", "TakenOver", "Vehicle"]
_log = logging.getLogger(__name__)


class Vehicle:
    """One vehicle on a link, as an async context manager: leaving the block leaves it holding or landing.

    Raises:
        FlightError: by every manoeuvre, when the autopilot refuses, with its own texts.
        TakenOver: by every manoeuvre, when somebody else has the vehicle.
        LinkError: by every manoeuvre, when the autopilot does not answer.
    """

    def __init__(self, link: Link, telemetry: Telemetry, settings: Settings, clock: Clock) -> None:
        self._telemetry = telemetry
        self._settings = settings
        self._clock = clock
        self._link = link
        self._modes = ModeControl(link, telemetry, clock, settings.autopilot.command_timeout_s)
        self._offboard = OffboardControl(
            link, clock, self._modes, settings.autopilot.silence_s, settings.safety.stale.heartbeat_s
        )
        self._start_z_m: float | None = None

    @property
    def taken_over(self) -> str | None:
        """The mode in which a pilot or a failsafe of the autopilot has the vehicle, or ``disarmed``; None: it is ours.

        Set once, for good.
        """
        return self._modes.taken_over

    @property
    def by_failsafe(self) -> bool:
        """Whether it was the autopilot's own failsafe that took it, by its word."""
        return self._modes.by_failsafe

    async def take_off(self, height_m: float, measured_height_m: Callable[[], float | None]) -> None:
        """Arm, take off, and return when the measured height has been within 0.2 m of ``height_m`` for 1 s.

        The vehicle may be engaged already when this returns, so `engage` should follow at once.

        Args:
            height_m: above ground.
            measured_height_m: the measured height above ground, None while it is not known.

        Raises:
            FlightError: also when the height was not reached in time.
        """
        pose = self._telemetry.poses.newest()
        self._start_z_m = None if pose is None else pose.z_m
        await self._take_off(measured_height_m).run(height_m)

    async def take_over(self, height_m: float, measured_height_m: Callable[[], float | None]) -> None:
        """Take a vehicle that is handed over in the air, and return as `take_off` does. Arguments and errors as there.

        The vehicle is engaged when this returns.
        """
        await self._take_off(measured_height_m).take_over(height_m)

    def _take_off(self, measured_height_m: Callable[[], float | None]) -> TakeOff:
        return TakeOff(
            self._link, self._clock, self._modes, self._offboard, self._settings, measured_height_m, self._risen_m
        )

    async def engage(self) -> None:
        """Make the autopilot follow our setpoints: offboard on PX4, guided on ArduPilot. Returns when it does.

        Setpoints must follow within ``autopilot.silence_s``.

        Raises:
            FlightError: also when it does not fly.
        """
        self._modes.check_ours()
        if not self._modes.maybe_armed:
            raise FlightError("cannot engage: the vehicle is not armed, it has to take off first")
        if not self._offboard.engaged:
            await self._offboard.engage()

    def send(self, setpoint: Setpoint) -> bool:
        """Send one setpoint to the autopilot, now and once.

        Nothing is sent when the vehicle is not engaged, when somebody else has it, when the setpoint is not finite,
        when the autopilot has not been heard for ``safety.stale.heartbeat_s``, and when setpoints had stopped for
        longer than ``autopilot.silence_s`` and no heartbeat has told yet what the autopilot made of it.

        Returns:
            Whether it went out; the log says why it did not.
        """
        return self._offboard.send(setpoint)

    async def hold(self) -> None:
        """Stop and stay: hold on PX4, which refuses it without a global origin, brake on ArduPilot."""
        await self._hold(None)

    async def land(self, timeout_s: float = LAND_S) -> bool:
        """Land where it is.

        Returns:
            True when it has landed and disarmed, False when that took longer than ``timeout_s``: it lands on.
        """
        give_up_s = self._clock.now_s() + timeout_s
        if self._offboard.engaged and self._is_moving():
            # Where it is, and not half a metre on: a landing that begins at speed ends there.
            await self._offboard.while_still(self._until_it_stands())
        if self._lands_elsewhere():
            return await self._descend(give_up_s)
        self._offboard.release()
        await self._modes.land()
        while self._modes.maybe_armed:
            self._modes.check_ours()
            if self._clock.now_s() > give_up_s:
                return False
            await self._clock.sleep(POLL_S)
        return True

    def _lands_elsewhere(self) -> bool:
        """Whether the autopilot's own landing would fly to 0°/0° first: it has an origin and no global position."""
        state = self._telemetry.state(self._clock.now_s())
        return self._offboard.engaged and state.origin_set and not state.global_position

    async def _descend(self, give_up_s: float) -> bool:
        """Land by setpoints, where it is; the autopilot disarms when it is down. Gives as `land` does."""
        _log.warning("landing by setpoints: the autopilot's own landing would fly to 0°/0°")
        self._modes.may_disarm()
        ramp = Ramp(self._settings.control.max_accel_mps2, POLL_S)
        while self._modes.maybe_armed:
            self._modes.check_ours()
            if self._clock.now_s() > give_up_s:
                return False
            self._offboard.send(ramp.limit(Setpoint(self._clock.now_s(), 0.0, -LAND_MPS, 0.0)))
            await self._clock.sleep(POLL_S)
        return True

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        leaving = asyncio.create_task(self._leave())
        cancelled: asyncio.CancelledError | None = None
        while not leaving.done():
            try:
                await asyncio.shield(leaving)
            except asyncio.CancelledError as cancellation:
                # Whoever is in a hurry waits: it is over within seconds, and the vehicle must not fly on.
                cancelled = cancellation
        leaving.result()
        if cancelled is not None and error is None:
            raise cancelled

    async def _leave(self) -> None:
        """Hold or land, whatever happened, within `LEAVE_S`. What goes wrong is logged: what led here is to be seen."""
        try:
            async with asyncio.timeout(LEAVE_S):
                await self._end()
        except TakenOver as taken_over:
            _log.warning("%s", taken_over)
        except (CompanionError, TimeoutError) as failure:
            _log.error(
                "the vehicle could not be told to hold or land (%s): nothing more is sent, and the autopilot's own "
                "failsafe has to end this flight",
                str(failure) or f"no answer within {LEAVE_S:g} s",
            )
        finally:
            self._offboard.release()

    async def _end(self) -> None:
        modes, holds = self._modes, self._settings.mission.end_action == "hold"
        if not (modes.asked_to_arm and modes.maybe_armed):
            return
        await modes.confirm_ours()
        # In the air the autopilot refuses to disarm, which is why it may be asked at all.
        if self._telemetry.state(self._clock.now_s()).landed and await modes.disarm(LEAVE_COMMAND_S):
            return
        if modes.lands(or_holds=holds):
            return
        if not holds:
            self._offboard.release()
        end, other = (self._hold, modes.land) if holds else (modes.land, self._hold)
        try:
            await end(LEAVE_COMMAND_S)
        except TakenOver:
            raise
        except CompanionError as refusal:
            _log.warning("%s", refusal)
            await other(LEAVE_COMMAND_S)

    async def _hold(self, timeout_s: float | None) -> None:
        """Come to stand by zero velocity, which ArduCopter's brake needs twice the way for, and stay.

        Args:
            timeout_s: for the acknowledgement, in s; by default as configured.
        """
        if self._offboard.engaged:
            await self._offboard.while_still(self._until_it_stands())
        self._offboard.release()
        await self._modes.hold(timeout_s)

    async def _until_it_stands(self) -> None:
        begun_s = self._clock.now_s()
        while self._clock.now_s() - begun_s < PATIENCE_S:
            if self._is_moving() is False:
                return
            await self._clock.sleep(POLL_S)

    def _is_moving(self) -> bool | None:
        """By the newest pose; None when there is none."""
        pose = self._telemetry.poses.newest()
        return None if pose is None else math.hypot(pose.vx_mps, pose.vy_mps) >= STANDS_MPS

    def _risen_m(self) -> float | None:
        pose = self._telemetry.poses.newest()
        if pose is None or self._start_z_m is None:
            return None
        return pose.z_m - self._start_z_m
