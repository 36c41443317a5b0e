"""Who has the vehicle: us, or somebody else? Decided from the autopilot's heartbeats alone. Pure.

The rule, most important first: once somebody else has it, nothing gives it back. Whoever changes the mode has it: a
pilot, a ground station, or a failsafe of the autopilot. PX4 returns from a failsafe to offboard by itself when
setpoints come again; that does not make it ours again. A vehicle that disarmed without being told to land is not ours
either: PX4 still shows offboard after a failsafe landing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.modes import mode_name

DISARMED = "disarmed"
HEARTBEAT_LATE_S = 1.2
"""A heartbeat that is newer than an event by this much knows of it."""


@dataclass(slots=True)
class _Request:
    """Modes that we have asked for.

    Attributes:
        modes: that are ours.
        before: that may show until one of ours does.
        may_disarm: whether the vehicle disarms in them without anybody's doing, as in a landing.
        was_armed: whether it has been armed since.
    """

    modes: frozenset[int]
    before: frozenset[int]
    may_disarm: bool
    was_armed: bool


class ModeMonitor:
    """Compares each heartbeat with the modes that we asked for.

    Heartbeats come once a second and say what was up to a second ago, so the mode that was ours before may show for a
    while after a request. Any other mode is somebody else's.

    Attributes:
        mode: ``custom_mode`` of the newest heartbeat; None before the first.
        armed: whether the newest heartbeat said so.
        heartbeat_s: when the newest was received; -inf before the first.
        confirmed: whether the mode asked for last has been seen.
        taken_over: the name of the mode that somebody else chose, or `DISARMED`; None while the vehicle is ours. Set
            once, for good.
        by_failsafe: whether the heartbeat that showed it said that the autopilot is in a failsafe: then it was the
            autopilot's own doing, and no person's.
    """

    def __init__(self, kind: AutopilotKind) -> None:
        self.mode: int | None = None
        self.armed = False
        self.heartbeat_s = -math.inf
        self.confirmed = False
        self.taken_over: str | None = None
        self.by_failsafe = False
        self._kind = kind
        self._request: _Request | None = None
        self._requests = 0

    @property
    def ours(self) -> frozenset[int]:
        """The modes asked for last; empty before anything was asked for."""
        return frozenset() if self._request is None else self._request.modes

    def maybe_armed(self, armed_s: float) -> bool:
        """Whether it is armed, or was at ``armed_s`` and no heartbeat can have said so yet; infinite: it was not."""
        return self.armed or self.heartbeat_s < armed_s + HEARTBEAT_LATE_S < math.inf

    def request(self, modes: frozenset[int], may_disarm: bool = False, passing: frozenset[int] = frozenset()) -> int:
        """From now on these modes are ours, and any other is somebody else's. Gives the number of this request.

        Args:
            modes: the mode that is about to be asked for, and those into which the autopilot goes on by itself.
            may_disarm: whether the vehicle disarms in them without anybody's doing, as in a landing.
            passing: modes that may show on the way to them.
        """
        shown = frozenset() if self.mode is None else frozenset({self.mode})
        self._request = _Request(modes, self.ours | passing | shown, may_disarm, self.armed)
        self.confirmed = False
        self._requests += 1
        return self._requests

    def on_refused(self, number: int) -> None:
        """This request came to nothing: the modes from before are ours, unless others were asked for since."""
        if self._request is None or number != self._requests:
            return
        self._request = _Request(self._request.before, frozenset(), False, self._request.was_armed)
        self.confirmed = True

    def on_heartbeat(self, custom_mode: int, armed: bool, received_s: float, critical: bool = False) -> None:
        """Judge one heartbeat. Each may be handed in more than once; one from the past is judged but not the newest.

        Args:
            custom_mode: as the heartbeat has it.
            armed: whether it says so.
            received_s: when it came.
            critical: whether its ``system_status`` says that the autopilot is in a failsafe.
        """
        if received_s >= self.heartbeat_s:
            self.mode, self.armed, self.heartbeat_s = custom_mode, armed, received_s
        request = self._request
        if request is None or self.taken_over is not None:
            return
        request.was_armed = request.was_armed or armed
        if request.was_armed and not armed:
            if not request.may_disarm:
                self.taken_over = DISARMED
            return
        if custom_mode in request.modes:
            self.confirmed = True
        elif self.confirmed or custom_mode not in request.before:
            self.taken_over = mode_name(self._kind, custom_mode)
            self.by_failsafe = critical
