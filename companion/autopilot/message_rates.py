"""Rates of the autopilot's messages: asked for, and asked for again when they do not come."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

from companion.autopilot.commands import command_long
from companion.autopilot.handover import CURRENT_HZ
from companion.autopilot.interface import Link
from companion.config.autopilot import AutopilotSettings
from companion.config.mission import MissionSettings
from companion.mavlink.estimator import ESTIMATOR
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd
from companion.mavlink.modes import personality

ASK_AGAIN_S = 3.0
"""Longer than the window in which rates are measured, so that an answer shows before it is asked again."""
ENOUGH = 0.5
"""Share of the rate asked for below which it is asked for again: an autopilot that restarted has forgotten it."""

_IDS = {
    "SYS_STATUS": 1,
    "ATTITUDE": 30,
    "GPS_RAW_INT": 24,
    "LOCAL_POSITION_NED": 32,
    "GLOBAL_POSITION_INT": 33,
    "MISSION_CURRENT": 42,
    "RC_CHANNELS": 65,
    "BATTERY_STATUS": 147,
    "EKF_STATUS_REPORT": 193,
    "ESTIMATOR_STATUS": 230,
    "EXTENDED_SYS_STATE": 245,
}

POLLED = {"GPS_GLOBAL_ORIGIN": 49}
"""PX4 sends it when it changes and when it is asked for, whatever interval is set."""
POLL_S = 1.0

GPS_HZ = 10.0
"""Each fix is sent once, so as often as the receiver has them: the gate notices when none comes."""
GLOBAL_POSITION_HZ = 2.0
SWITCH_HZ, SWITCH_STATUS_HZ = 10.0, 5.0
"""Within a second after it was moved a switch is obeyed."""
ESTIMATOR_HZ = 10.0
"""Often enough to stop before a lost estimate has carried the vehicle far: 0.05 m at 0.5 m/s."""


def wanted_hz(kind: AutopilotKind, settings: AutopilotSettings, mission: MissionSettings) -> dict[str, float]:
    """Message name -> rate for everything that is read of the autopilot, here and in the gate.

    Without GPS PX4 is asked for its global position: where an origin is set and no position comes, it lands elsewhere.
    A switch of the transmitter counts only while SYS_STATUS says that the transmitter is heard; the item of
    ArduCopter's mission is asked for where it may start the flight.
    """
    switched = mission.rc_switch.channel is not None
    hands_over = mission.start == "command" and personality(kind).mission is not None
    if settings.gps:
        place = {"GPS_RAW_INT": GPS_HZ}
    else:
        place = {"GLOBAL_POSITION_INT": GLOBAL_POSITION_HZ} if kind is AutopilotKind.PX4 else {}
    return place | {
        "ATTITUDE": settings.attitude_hz,
        "LOCAL_POSITION_NED": settings.position_hz,
        "SYS_STATUS": SWITCH_STATUS_HZ if switched else 1.0,
        **({"RC_CHANNELS": SWITCH_HZ} if switched else {}),
        **({"MISSION_CURRENT": CURRENT_HZ} if hands_over else {}),
        "BATTERY_STATUS": 1.0,
        "EXTENDED_SYS_STATE": 2.0,
        ESTIMATOR[kind]: ESTIMATOR_HZ,
    }


def ask(link: Link, command: int, *params: float) -> None:
    """Send a command to the autopilot, of which no acknowledgement is waited for: what comes of it is the answer."""
    link.send("COMMAND_LONG", command_long(link.system_id, command, params))


def polled_ids(settings: AutopilotSettings) -> tuple[int, ...]:
    """Messages that have to be asked for one by one."""
    return () if settings.gps else tuple(POLLED.values())


class MessageRates:
    """Asks by SET_MESSAGE_INTERVAL, without waiting for answers: the measured rate is the answer.

    Args:
        link: to the autopilot.
        wanted: message name -> rate.
        polled: ids of messages that are asked for one by one, every second.
    """

    def __init__(self, link: Link, wanted: Mapping[str, float], polled: Collection[int] = ()) -> None:
        self._link = link
        self._polled = polled
        self._polled_s = -math.inf
        self._wanted = {name: (hz, link.watch(name)) for name, hz in wanted.items()}
        self._asked_s: dict[str, float] = {}

    def ask_where_missing(self, now_s: float) -> None:
        """Ask for each message that comes too rarely and has not just been asked for, and for what is polled."""
        if now_s - self._polled_s >= POLL_S:
            self._polled_s = now_s
            for number in self._polled:
                ask(self._link, MavCmd.REQUEST_MESSAGE, float(number))
        for name, (hz, stream) in self._wanted.items():
            asked_s = self._asked_s.get(name)
            if asked_s is not None and (now_s - asked_s < ASK_AGAIN_S or stream.rate_hz(now_s) >= ENOUGH * hz):
                continue
            self._asked_s[name] = now_s
            ask(self._link, MavCmd.SET_MESSAGE_INTERVAL, float(_IDS[name]), 1e6 / hz)

    def restart(self) -> None:
        """The autopilot was started again: everything has to be asked for anew."""
        self._asked_s.clear()
