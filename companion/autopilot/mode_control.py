"""Asks the autopilot for things, sees whether they happen, and has its own words for it when they do not."""

from __future__ import annotations

import logging
import math

from companion.autopilot.interface import Link, Message
from companion.autopilot.telemetry import Telemetry
from companion.autopilot.vehicle_state import integer
from companion.clock import Clock
from companion.errors import CompanionError
from companion.mavlink.ids import MavCmd, MavModeFlag, MavResult
from companion.mavlink.mode_monitor import HEARTBEAT_LATE_S, ModeWatch
from companion.mavlink.modes import mode_name, personality, result_name

POLL_S = 0.05
MODE_GRACE_S = 2.5
"""A mode that was asked for may take this long to show: the heartbeat that tells comes once a second."""
MODE_LIMIT_S = 5.0
"""After this it is given up even when no heartbeat came at all."""
ARM_PATIENCE_S = 10.0
"""Reasons not to arm may pass by themselves: without GPS, PX4 is ready 5 s after it was told its origin."""
ARM_PERIOD_S = 2.0

_log = logging.getLogger(__name__)


class FlightError(CompanionError):
    """The autopilot did not do what the flight needs; the message has its own words for it."""


class TakenOver(FlightError):  # noqa: N818  what happened is no fault
    """Somebody else has the vehicle: a pilot, a ground station, or a failsafe of the autopilot."""


class Commander:
    """Modes and commands, each confirmed.

    Args:
        link: to the autopilot.
        telemetry: knows what it says.
        clock: what time it is.
        timeout_s: how long to wait for the acknowledgement of a command.

    Attributes:
        watch: whose the vehicle is.
        asked_to_arm: whether this flight is ours to end.
    """

    def __init__(self, link: Link, telemetry: Telemetry, clock: Clock, timeout_s: float) -> None:
        self.link = link
        self.clock = clock
        self.personality = personality(link.kind)
        self.watch = ModeWatch(link.kind)
        self.asked_to_arm = False
        self._telemetry = telemetry
        self._timeout_s = timeout_s
        self._armed_s = math.inf
        self._heartbeats = link.watch("HEARTBEAT")
        link.events("HEARTBEAT", self._on_heartbeat)

    @property
    def maybe_armed(self) -> bool:
        """Whether the vehicle is armed, or we have armed it and no heartbeat can have said otherwise yet."""
        return self.watch.maybe_armed(self._armed_s)

    def look(self) -> None:
        """Judge the newest heartbeat now: after a hang of the event loop it is here before its event is."""
        if self._heartbeats.newest is not None:
            self._on_heartbeat(self._heartbeats.newest)

    def check_ours(self) -> None:
        """Raise TakenOver when somebody else has the vehicle."""
        self.look()
        if self.watch.taken_over is not None:
            raise TakenOver(
                f"somebody else has the vehicle (mode {self.watch.taken_over}): the application keeps its hands off"
            )

    async def command(self, command: int, *parameters: float, timeout_s: float | None = None) -> int:
        """The MAV_RESULT of a command.

        Raises:
            LinkError: no answer.
        """
        return await self.link.command(command, *parameters, timeout_s=timeout_s or self._timeout_s)

    async def mode(self, mode: int, may_disarm: bool = False, timeout_s: float | None = None) -> None:
        """Ask for a mode and wait until a heartbeat shows it.

        Args:
            mode: as ``custom_mode``.
            may_disarm: whether the vehicle disarms in it by itself.
            timeout_s: for the acknowledgement, in s; by default as configured.

        Raises:
            FlightError: refused, or it never showed.
            TakenOver: another mode showed instead.
            LinkError: no answer.
        """
        self.check_ours()
        name = mode_name(self.link.kind, mode)
        asked_s = self.clock.now_s()
        request = self.watch.ask(frozenset({mode}), may_disarm, self.personality.passing_to(mode))
        happened = False
        try:
            result = await self.command(
                MavCmd.DO_SET_MODE, *self.personality.set_mode_parameters(mode), timeout_s=timeout_s
            )
            if result not in (MavResult.ACCEPTED, MavResult.IN_PROGRESS):
                raise self.failure(f"the autopilot refused the mode {name} ({result_name(result)})", asked_s)
            await self._seen(name, asked_s)
            happened = True
        finally:
            if not happened:
                self.watch.refused(request)

    async def _seen(self, name: str, asked_s: float) -> None:
        accepted_s = self.clock.now_s()
        while True:
            self.check_ours()
            if self.watch.confirmed:
                return
            waited_s = self.clock.now_s() - accepted_s
            told = self.watch.heartbeat_s > accepted_s + HEARTBEAT_LATE_S
            if (waited_s > MODE_GRACE_S and told) or waited_s > MODE_LIMIT_S:
                raise self.failure(f"the autopilot accepted the mode {name} but does not show it", asked_s)
            await self.clock.sleep(POLL_S)

    async def arm(self) -> None:
        """Arm; a refusal is tried again for a while, since many of its reasons pass.

        Raises:
            FlightError: refused, with the autopilot's reasons.
            TakenOver: somebody else changed the mode.
            LinkError: no answer.
        """
        began_s = self.clock.now_s()
        while True:
            self.check_ours()
            # Accepted or not: once it was asked for, the vehicle may be armed.
            self.asked_to_arm = True
            self._armed_s = self.clock.now_s()
            result = await self.command(MavCmd.COMPONENT_ARM_DISARM, 1.0)
            self._armed_s = self.clock.now_s() if result == MavResult.ACCEPTED else math.inf
            if result == MavResult.ACCEPTED:
                return
            if self.clock.now_s() - began_s >= ARM_PATIENCE_S:
                raise self.failure(f"the autopilot refuses to arm ({result_name(result)})", began_s)
            await self.clock.sleep(ARM_PERIOD_S)

    def failure(self, what: str, since_s: float) -> FlightError:
        """An error with everything that the autopilot has said since then."""
        said = dict.fromkeys(text.text.strip("\0 ") for text in self._telemetry.texts if text.received_s >= since_s)
        return FlightError(f"{what}. The autopilot said: {'; '.join(said) or 'nothing'}")

    def _on_heartbeat(self, message: Message) -> None:
        mode, flags = integer(message, "custom_mode"), integer(message, "base_mode")
        if mode is not None and flags is not None:
            before = self.watch.taken_over
            self.watch.heartbeat(mode, bool(flags & MavModeFlag.SAFETY_ARMED), message.received_s)
            if before is None and self.watch.taken_over is not None:
                _log.warning("somebody else has the vehicle: mode %s", self.watch.taken_over)
