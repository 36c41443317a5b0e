"""Waiting for an autopilot that has just been switched on: what it lacks in its first minute is no failure yet."""

from __future__ import annotations

import contextlib
import math

from companion.autopilot.global_origin import GlobalOrigin
from companion.autopilot.interface import Link, LinkError
from companion.autopilot.message_rates import ask
from companion.autopilot.telemetry import Telemetry
from companion.autopilot.vehicle_state import PrearmState
from companion.clock import Clock
from companion.config.autopilot import AutopilotSettings
from companion.flight.events import Event, EventEmitter
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd

LOOK_PERIOD_S = 0.2
"""How often it is asked whether something has come about."""
ASK_PREARM_S = 5.0
"""ArduPilot looks and says by itself what is in the way every 30 s."""
QUIET_S = 3.0
"""What comes within this time is not announced as waited for."""


async def until_ready(
    link: Link, telemetry: Telemetry, settings: AutopilotSettings, clock: Clock, events: EventEmitter
) -> None:
    """Wait for all that an autopilot needs time for, ``autopilot.ready_timeout_s`` at most; never raises.

    Meanwhile one without GPS is told its origin on the globe, where it is to have one; that changes no setting.
    """
    origin = GlobalOrigin(link, settings)
    prearm_asked_s = -math.inf
    began_s = now_s = clock.now_s()
    announced: str | None = None
    while now_s < began_s + settings.ready_timeout_s:
        with contextlib.suppress(LinkError):  # the check of the link says it better
            origin.tell_where_missing(now_s)
            if link.kind is AutopilotKind.ARDUPILOT and now_s - prearm_asked_s >= ASK_PREARM_S:
                prearm_asked_s = now_s
                ask(link, MavCmd.RUN_PREARM_CHECKS)
        awaited = _awaited(link.kind, telemetry, origin, now_s)
        if awaited is None:
            return
        if awaited != announced and now_s > began_s + QUIET_S:
            announced = awaited
            events.emit(Event.NOT_READY_YET, what=awaited, timeout_s=settings.ready_timeout_s)
        await clock.sleep(LOOK_PERIOD_S)
        now_s = clock.now_s()


def _awaited(kind: AutopilotKind, telemetry: Telemetry, origin: GlobalOrigin, now_s: float) -> str | None:
    state = telemetry.state(now_s)
    if not state.position_valid:
        return "the autopilot's position"
    if not origin.can_be_judged(now_s):
        return "the autopilot's origin on the globe"
    if kind is AutopilotKind.ARDUPILOT and state.prearm in (PrearmState.UNKNOWN, PrearmState.FAILING):
        return "the autopilot's own checks before arming"
    return None
