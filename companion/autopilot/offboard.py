"""Setpoints to the autopilot, each sent once. Nothing here repeats one: silence is the signal that we fail."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Coroutine
from dataclasses import astuple
from typing import Any, TypeVar

from companion.autopilot.interface import Link, LinkError
from companion.autopilot.mode_control import POLL_S, ModeControl
from companion.clock import Clock
from companion.frames import setpoint_to_frd
from companion.mavlink.ids import VELOCITY_AND_YAW_RATE, MavComponent, MavFrame
from companion.model import Setpoint

STREAM_BEFORE_S = 0.6
"""PX4 takes the mode only when setpoints have been coming for a while."""

_log = logging.getLogger(__name__)
T = TypeVar("T")


class OffboardControl:
    """Sends setpoints while the vehicle is ours and follows them.

    Args:
        modes: knows whose the vehicle is.
        silence_s: the autopilot reacts when setpoints stop for this long.
        heartbeat_s: an autopilot that has not been heard for this long no longer hears us either, as far as we know.
    """

    def __init__(self, link: Link, clock: Clock, modes: ModeControl, silence_s: float, heartbeat_s: float) -> None:
        self.silent_because: str | None = "not engaged"
        """Why nothing was sent when that was last asked for; None when it was."""
        self._link = link
        self._clock = clock
        self._modes = modes
        self._silence_s = silence_s
        self._heartbeat_limit_s = heartbeat_s
        self._engaged = False

    @property
    def engaged(self) -> bool:
        """Whether the autopilot follows our setpoints, as far as is known."""
        return self._engaged and self._modes.taken_over is None

    async def engage(self) -> None:
        """Take the mode in which the autopilot follows setpoints, streaming zero on PX4 until it has it.

        Raises as `ModeControl` does.
        """
        if self._modes.needs_stream:
            await self.while_still(self._clock.sleep(STREAM_BEFORE_S))
            await self.while_still(self._modes.offboard())
        else:
            await self._modes.offboard()
        self._engaged = True
        # Our own silence counts from here.
        self._modes.failsafe_s = self._clock.now_s() + self._silence_s

    def release(self) -> None:
        """From here on `send` sends nothing."""
        self._engaged = False

    async def while_still(self, work: Coroutine[Any, Any, T]) -> T:
        """Do something while the vehicle is asked to stand still, 20 times a second.

        After a stall it is asked only once a heartbeat has told that it is still ours: PX4 returns to offboard on the
        first setpoint.
        """
        task = asyncio.create_task(work)
        try:
            while not task.done():
                self._modes.check_ours()
                if not self._modes.failsafe_unheard:
                    self._transmit(Setpoint(self._clock.now_s(), 0.0, 0.0, 0.0))
                await self._clock.sleep(POLL_S)
            return task.result()
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    def send(self, setpoint: Setpoint) -> bool:
        """Send one setpoint: whether it went out. When it did not, `silent_because` says why."""
        why = self._why_not(setpoint)
        if why is None:
            try:
                self._transmit(setpoint)
            except LinkError as error:
                why = str(error)
        if why is not None and why != self.silent_because:
            _log.warning("no setpoint is sent: %s", why)
        self.silent_because = why
        return why is None

    def _why_not(self, setpoint: Setpoint) -> str | None:
        if self._modes.taken_over is not None:
            return f"somebody else has the vehicle (mode {self._modes.taken_over})"
        if not self._engaged:
            return "not engaged"
        if not all(map(math.isfinite, astuple(setpoint))):
            return "the setpoint is not finite"
        if self._clock.now_s() - self._modes.heartbeat_s > self._heartbeat_limit_s:
            return f"no heartbeat of the autopilot for {self._heartbeat_limit_s:g} s"
        # PX4 returns to offboard on the first setpoint: after a silence that may have let its failsafe act, nothing is
        # sent before a heartbeat has told whether it did.
        if self._modes.failsafe_unheard:
            return "setpoints stopped for too long: waiting for the autopilot to tell its mode"
        return None

    def _transmit(self, setpoint: Setpoint) -> None:
        velocity = setpoint_to_frd(setpoint)
        fields = dict.fromkeys(("x", "y", "z", "afx", "afy", "afz", "yaw"), 0.0)
        fields |= {"vx": velocity.vx_mps, "vy": velocity.vy_mps, "vz": velocity.vz_mps}
        self._link.send(
            "SET_POSITION_TARGET_LOCAL_NED",
            {
                "time_boot_ms": int(setpoint.t_s * 1000.0) & 0xFFFFFFFF,
                "target_system": self._link.system_id,
                "target_component": MavComponent.AUTOPILOT1,
                "coordinate_frame": MavFrame.BODY_NED,
                "type_mask": VELOCITY_AND_YAW_RATE,
                **fields,
                "yaw_rate": velocity.yaw_rate_radps,
            },
        )
        self._modes.failsafe_s = self._clock.now_s() + self._silence_s
