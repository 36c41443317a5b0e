"""Modes, arming and take-off: asked for, confirmed by heartbeats, refused in the autopilot's own words."""

from __future__ import annotations

import logging
import math

from companion.autopilot.interface import Link, LinkError, Message
from companion.autopilot.telemetry import Telemetry
from companion.autopilot.vehicle_state import integer
from companion.clock import Clock
from companion.errors import CompanionError
from companion.mavlink.ids import MavCmd, MavModeFlag, MavResult, MavState
from companion.mavlink.mode_monitor import HEARTBEAT_LATE_S, ModeMonitor
from companion.mavlink.modes import mode_name, personality, result_name

POLL_S = 0.05
MODE_GRACE_S = 2.5
"""A mode that was asked for may take this long to show: the heartbeat that tells comes once a second."""
MODE_LIMIT_S = 5.0
"""After this it is given up even when no heartbeat came at all."""
UNHEARD_S = 1.5
"""Heartbeats come once a second: one that is older was missed, and so may be what came with it."""
FAILSAFE_SHOWS_S = 0.3
"""A failsafe acts up to 0.12 s after its time limit; only a heartbeat from after that can tell."""
TOLD_WITHIN_S = 3.0
"""So long the next heartbeat is waited for; a link that is silent for longer carries no order either."""
ARM_PATIENCE_S = 10.0
"""Reasons not to arm may pass by themselves: without GPS, PX4 is ready 5 s after it was told its origin."""
ARM_PERIOD_S = 2.0

_log = logging.getLogger(__name__)


class FlightError(CompanionError):
    """The autopilot did not do what the flight needs; the message has its own words for it."""


class ModeRefused(FlightError):  # noqa: N818  what happened is no fault
    """The autopilot, or the gate before it, does not take a mode that was asked for: the vehicle is whose it was."""


class TakenOver(FlightError):  # noqa: N818  what happened is no fault
    """Somebody else has the vehicle: a pilot, a ground station, or a failsafe of the autopilot."""


class ModeControl:
    """Modes, arming and take-off, each confirmed; and the one judgement of whose the vehicle is.

    Args:
        timeout_s: how long to wait for the acknowledgement of a command.

    Attributes:
        asked_to_arm: whether this flight is ours to end.
        failsafe_s: when the autopilot acts by itself, unless another setpoint comes; told by whoever sends them.

    Raises:
        FlightError: by everything that is asked for, when it is refused, with the autopilot's reasons, or never shows.
        TakenOver: by everything that is asked for, when somebody else has the vehicle or another mode shows.
        LinkError: by everything that is asked for, when there is no answer.
    """

    def __init__(self, link: Link, telemetry: Telemetry, clock: Clock, timeout_s: float) -> None:
        self.asked_to_arm = False
        self.failsafe_s = -math.inf
        self._link = link
        self._telemetry = telemetry
        self._clock = clock
        self._timeout_s = timeout_s
        self._personality = personality(link.kind)
        self._monitor = ModeMonitor(link.kind)
        self._armed_s = math.inf
        self._heartbeats = link.watch("HEARTBEAT")
        link.events("HEARTBEAT", self._on_heartbeat)

    @property
    def taken_over(self) -> str | None:
        """The mode that somebody else chose, or ``disarmed``; None while the vehicle is ours. Set once, for good."""
        return self._judged().taken_over

    @property
    def by_failsafe(self) -> bool:
        """Whether it was the autopilot's own failsafe that took the vehicle, and no person."""
        return self._judged().by_failsafe

    @property
    def heartbeat_s(self) -> float:
        """When the newest heartbeat came; -inf before the first."""
        return self._judged().heartbeat_s

    @property
    def failsafe_unheard(self) -> bool:
        """Whether a failsafe of the autopilot may have acted of which no heartbeat can have told yet."""
        return self._clock.now_s() > self.failsafe_s and self.heartbeat_s < self.failsafe_s + FAILSAFE_SHOWS_S

    @property
    def armed(self) -> bool:
        """Whether the newest heartbeat says so."""
        return self._judged().armed

    @property
    def maybe_armed(self) -> bool:
        """Whether the vehicle is armed, or we have armed it and no heartbeat can have said otherwise yet."""
        return self._judged().maybe_armed(self._armed_s)

    @property
    def needs_stream(self) -> bool:
        """Whether the autopilot follows setpoints only once they have been coming for a while."""
        return self._personality.streams_before_mode

    def check_ours(self) -> None:
        """Raise TakenOver when somebody else has the vehicle."""
        if self.taken_over is not None:
            raise TakenOver(f"{self._whose()}: the application keeps its hands off")

    def may_disarm(self) -> None:
        """From now on the vehicle may disarm in the mode that it is in: it is landed by setpoints."""
        self._monitor.request(self._monitor.ours, may_disarm=True)

    async def confirm_ours(self) -> None:
        """Wait until the autopilot has told its mode, where it may have changed unheard, and raise as `check_ours`.

        After a stall of ours, or of the link, a pilot or a failsafe may have the vehicle: an order would overrule them.

        Raises:
            LinkError: it does not tell.
        """
        asked_s = self._clock.now_s()
        while self._clock.now_s() - self.heartbeat_s > UNHEARD_S or self.failsafe_unheard:
            self.check_ours()
            if self._clock.now_s() - asked_s > TOLD_WITHIN_S:
                raise LinkError(
                    f"the autopilot has not told its mode for {self._clock.now_s() - self.heartbeat_s:.1f} s: nothing "
                    "is ordered unseen, and its own failsafe has the vehicle"
                )
            await self._clock.sleep(POLL_S)
        self.check_ours()

    def lands(self, or_holds: bool = False) -> bool:
        """Whether the autopilot shows that it lands, or if wanted that it holds, because we asked for that."""
        monitor = self._judged()
        ends = {self._personality.land, self._personality.hold} if or_holds else {self._personality.land}
        return monitor.confirmed and monitor.ours <= ends

    async def offboard(self) -> None:
        """Have the autopilot follow setpoints: offboard on PX4, guided on ArduPilot."""
        await self._enter(self._personality.offboard)

    async def hold(self, timeout_s: float | None = None) -> None:
        """Stop and stay: hold on PX4, brake on ArduPilot. Returns when a heartbeat shows it.

        Args:
            timeout_s: for the acknowledgement, in s; by default as configured.
        """
        await self._enter(self._personality.hold, timeout_s=timeout_s)

    async def land(self, timeout_s: float | None = None) -> None:
        """Begin to land where it is; the vehicle may then disarm by itself. Arguments as of `hold`."""
        await self._enter(self._personality.land, may_disarm=True, timeout_s=timeout_s)

    async def take_off(self, *parameters: float) -> None:
        """Begin the autopilot's own take-off, with these parameters of MAV_CMD_NAV_TAKEOFF."""
        self.check_ours()
        asked_s = self._clock.now_s()
        self._monitor.request(self._personality.taking_off)
        result = await self._command(MavCmd.NAV_TAKEOFF, *parameters)
        if result != MavResult.ACCEPTED:
            raise self.failure(f"the autopilot refuses to take off ({result_name(result)})", asked_s)

    async def arm(self) -> None:
        """Arm; a refusal is tried again for a while, since many of its reasons pass."""
        began_s = self._clock.now_s()
        while True:
            self.check_ours()
            # Accepted or not: once it was asked for, the vehicle may be armed.
            self.asked_to_arm = True
            self._armed_s = self._clock.now_s()
            result = await self._command(MavCmd.COMPONENT_ARM_DISARM, 1.0)
            self._armed_s = self._clock.now_s() if result == MavResult.ACCEPTED else math.inf
            if result == MavResult.ACCEPTED:
                return
            if self._clock.now_s() - began_s >= ARM_PATIENCE_S:
                checks = "; ".join(self._link.arming_problems)
                because = f", because of its own checks: {checks}" if checks else ""
                raise self.failure(f"the autopilot refuses to arm ({result_name(result)}){because}", began_s)
            await self._clock.sleep(ARM_PERIOD_S)

    def take_charge(self) -> None:
        """From now on the flight of a vehicle that is armed already is ours to end."""
        self.asked_to_arm = True

    def give_back(self) -> None:
        """It is not: whoever had it has it."""
        self.asked_to_arm = False

    async def disarm(self, timeout_s: float) -> bool:
        """Whether it disarmed, which in the air it refuses. An answer that does not come within the time is no."""
        try:
            result = await self._command(MavCmd.COMPONENT_ARM_DISARM, 0.0, timeout_s=timeout_s)
        except LinkError:
            return False
        return result == MavResult.ACCEPTED

    def failure(self, what: str, since_s: float, kind: type[FlightError] = FlightError) -> FlightError:
        """An error with everything that the autopilot has said since then."""
        said = dict.fromkeys(text.text.strip("\0 ") for text in self._telemetry.texts if text.received_s >= since_s)
        return kind(f"{what}. The autopilot said: {'; '.join(said) or 'nothing'}")

    async def _command(self, command: int, *parameters: float, timeout_s: float | None = None) -> int:
        return await self._link.command(command, *parameters, timeout_s=timeout_s or self._timeout_s)

    async def _enter(self, mode: int, may_disarm: bool = False, timeout_s: float | None = None) -> None:
        await self.confirm_ours()
        name = mode_name(self._link.kind, mode)
        asked_s = self._clock.now_s()
        request = self._monitor.request(frozenset({mode}), may_disarm, self._personality.passing_to(mode))
        happened = False
        try:
            result = await self._command(
                MavCmd.DO_SET_MODE, *self._personality.set_mode_parameters(mode), timeout_s=timeout_s
            )
            if result not in (MavResult.ACCEPTED, MavResult.IN_PROGRESS):
                raise self.failure(
                    f"the autopilot refused the mode {name} ({result_name(result)})", asked_s, ModeRefused
                )
            await self._shown(name, asked_s)
            happened = True
        finally:
            if not happened:
                self._monitor.on_refused(request)

    async def _shown(self, name: str, asked_s: float) -> None:
        accepted_s = self._clock.now_s()
        while True:
            self.check_ours()
            if self._monitor.confirmed:
                return
            waited_s = self._clock.now_s() - accepted_s
            shown = self._monitor.heartbeat_s > accepted_s + HEARTBEAT_LATE_S
            if (waited_s > MODE_GRACE_S and shown) or waited_s > MODE_LIMIT_S:
                raise self.failure(f"the autopilot accepted the mode {name} but does not show it", asked_s)
            await self._clock.sleep(POLL_S)

    def _whose(self) -> str:
        who = "the autopilot's own failsafe" if self._monitor.by_failsafe else "somebody else"
        return f"{who} has the vehicle (mode {self._monitor.taken_over})"

    def _judged(self) -> ModeMonitor:
        """With the newest heartbeat judged: after a hang of the event loop it is here before its event is."""
        if self._heartbeats.newest is not None:
            self._on_heartbeat(self._heartbeats.newest)
        return self._monitor

    def _on_heartbeat(self, message: Message) -> None:
        mode, flags = integer(message, "custom_mode"), integer(message, "base_mode")
        if mode is not None and flags is not None:
            before = self._monitor.taken_over
            critical = integer(message, "system_status") in (MavState.CRITICAL, MavState.EMERGENCY)
            self._monitor.on_heartbeat(mode, bool(flags & MavModeFlag.SAFETY_ARMED), message.received_s, critical)
            if before is None and self._monitor.taken_over is not None:
                _log.warning("%s", self._whose())
