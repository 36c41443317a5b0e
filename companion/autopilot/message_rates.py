"""Rates of the autopilot's messages: asked for, and asked for again when they do not come."""

from __future__ import annotations

from collections.abc import Mapping

from companion.autopilot.commands import command_long
from companion.autopilot.interface import Link
from companion.config.autopilot import AutopilotSettings
from companion.mavlink.estimator import ESTIMATOR
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd

ASK_AGAIN_S = 3.0
"""Longer than the window in which rates are measured, so that an answer shows before it is asked again."""
ENOUGH = 0.5
"""Share of the rate asked for below which it is asked for again: an autopilot that restarted has forgotten it."""

_IDS = {
    "SYS_STATUS": 1,
    "GPS_RAW_INT": 24,
    "ATTITUDE": 30,
    "LOCAL_POSITION_NED": 32,
    "BATTERY_STATUS": 147,
    "EKF_STATUS_REPORT": 193,
    "ESTIMATOR_STATUS": 230,
    "EXTENDED_SYS_STATE": 245,
}

ESTIMATOR_HZ = 10.0
"""Often enough to stop before a lost estimate has carried the vehicle far: 0.05 m at 0.5 m/s."""

GPS_HZ = 5.0
"""Of the position fix, which the gate misses after `safety.stale.gps_s`; ArduPilot tells it only to who asks."""


def wanted_hz(kind: AutopilotKind, settings: AutopilotSettings) -> dict[str, float]:
    """Message name -> rate for everything that telemetry and the safety gate read."""
    fix = {"GPS_RAW_INT": GPS_HZ} if settings.gps else {}
    return fix | {
        "ATTITUDE": settings.attitude_hz,
        "LOCAL_POSITION_NED": settings.position_hz,
        "SYS_STATUS": 1.0,
        "BATTERY_STATUS": 1.0,
        "EXTENDED_SYS_STATE": 2.0,
        ESTIMATOR[kind]: ESTIMATOR_HZ,
    }


def ask(link: Link, command: int, *params: float) -> None:
    """Send a command to the autopilot, of which no acknowledgement is waited for: what comes of it is the answer."""
    link.send("COMMAND_LONG", command_long(link.system_id, command, params))


class MessageRates:
    """Asks by SET_MESSAGE_INTERVAL, without waiting for answers: the measured rate is the answer."""

    def __init__(self, link: Link, wanted: Mapping[str, float]) -> None:
        self._link = link
        self._wanted = {name: (hz, link.watch(name)) for name, hz in wanted.items()}
        self._asked_s: dict[str, float] = {}

    def ask_where_missing(self, now_s: float) -> None:
        """Ask for each message that comes too rarely and has not just been asked for."""
        for name, (hz, stream) in self._wanted.items():
            asked_s = self._asked_s.get(name)
            if asked_s is not None and (now_s - asked_s < ASK_AGAIN_S or stream.rate_hz(now_s) >= ENOUGH * hz):
                continue
            self._asked_s[name] = now_s
            ask(self._link, MavCmd.SET_MESSAGE_INTERVAL, float(_IDS[name]), 1e6 / hz)

    def restart(self) -> None:
        """The autopilot was started again: everything has to be asked for anew."""
        self._asked_s.clear()
