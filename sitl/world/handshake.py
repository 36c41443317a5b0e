"""The handshake with the autopilot: heartbeats, requests for the true pose, and the origin on the globe."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Collection
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.global_origin import ALTITUDE_MM
from sitl.world.mavlink_out import LocalFrame
from sitl.world.truth_messages import MESSAGES, Fix, TruthKind, TruthReader

log = logging.getLogger(__name__)

ENOUGH = 0.8
"""Truth that comes at less than this share of the wanted rate is asked for again."""

ASK_S, ASKED_OFTEN, ASK_SELDOM_S = 2.0, 10, 10.0
RATE_WINDOW_S = 2.0
SILENT_S = 10.0
"""After this long without a message a warning says what may be wrong."""

REBOOT_S = 3.0
"""After a gap in the heartbeats this long the autopilot may be another, or the same one that forgot its origin."""

ORIGIN_AFTER_S, ORIGIN_EVERY_S, ORIGIN_TRIES = 2.0, 2.0, 15

SOMEWHERE = Fix(47.397742, 8.545594, 489.4)
"""Where PX4's simulators boot: the origin when the truth came without latitude and longitude."""

_IDS: dict[str, int] = {
    name: getattr(mavlink, f"MAVLINK_MSG_ID_{name}") for names in MESSAGES.values() for name in names
}
_OWN = {mavlink.MAV_AUTOPILOT_PX4: "HIL_STATE_QUATERNION", mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "SIM_STATE"}


def wanted_ids(kind: TruthKind) -> frozenset[int]:
    """Ids of the messages that the world listens to."""
    own = {mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN}
    return frozenset(own | {_IDS[name] for name in MESSAGES[kind]})


def told_an_origin(gps: bool, frame: LocalFrame) -> frozenset[int]:
    """The autopilots (MAV_AUTOPILOT) that are told an origin: without GPS, and not PX4 with odometry as LOCAL_FRD.

    With an origin and LOCAL_FRD every landing of PX4 flies to latitude 0, longitude 0.
    """
    if gps:
        return frozenset()
    px4 = {mavlink.MAV_AUTOPILOT_PX4} if frame is LocalFrame.LOCAL_NED else set()
    return frozenset({mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA} | px4)


def send_heartbeat(sender: Any) -> None:
    """Says that the world is there; to be called once a second."""
    sender.heartbeat_send(
        *(mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE)
    )


class Handshake:
    """The exchange with one autopilot: heartbeat, message intervals, origin.

    Args:
        sender: pymavlink's encoder.
        system_id: of the vehicle.
        reader: knows whose truth is taken, and the place of the first.
        truth_hz: how often truth is wanted.
        origin_for: the autopilots (MAV_AUTOPILOT) that are told an origin, because they have no GPS.
    """

    def __init__(
        self, sender: Any, system_id: int, reader: TruthReader, truth_hz: float, origin_for: Collection[int]
    ) -> None:
        self.autopilot: int | None = None
        """MAV_AUTOPILOT of the heartbeat; None before the first."""
        self.armed = False
        self.origin_confirmed = False
        self._sender = sender
        self._system_id = system_id
        self._reader = reader
        self._truth_hz = truth_hz
        self._origin_for = origin_for
        self._truth_s: deque[float] = deque(maxlen=1024)
        self._heartbeat_s = -math.inf
        self._first_heartbeat_s = math.inf
        self._began_s: float | None = None
        self._asked = 0
        self._ask_s = -math.inf
        self._origin_s = -math.inf
        self._origin_tries = 0
        self._warned: set[str] = set()

    @property
    def is_ardupilot(self) -> bool:
        """Whether ArduPilot is at the other end."""
        return bool(self.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)

    def on_message(self, message: Any, received_s: float) -> None:
        """Takes note of a heartbeat, or of the answer to an origin."""
        name = message.get_type()
        if name == "HEARTBEAT":
            if received_s - self._heartbeat_s > REBOOT_S:
                self.restart(received_s)
            self._heartbeat_s = received_s
            self.autopilot = message.autopilot
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        elif name == "GPS_GLOBAL_ORIGIN":
            self.origin_confirmed = True

    def restart(self, now_s: float) -> None:
        """The autopilot has forgotten everything: it is another, or was started again."""
        self._first_heartbeat_s = now_s
        self.origin_confirmed = False
        self._origin_tries = self._asked = 0

    def on_truth(self, received_s: float) -> None:
        """Takes note of a truth message."""
        self._truth_s.append(received_s)

    def truth_hz(self, now_s: float) -> float:
        """How often truth has come over the last two seconds."""
        return sum(now_s - RATE_WINDOW_S < t_s <= now_s for t_s in self._truth_s) / RATE_WINDOW_S

    def send_due(self, now_s: float) -> None:
        """Sends what is due; to be called once a second."""
        if self._began_s is None:
            self._began_s = now_s
        send_heartbeat(self._sender)
        if self.truth_hz(now_s) < ENOUGH * self._truth_hz:
            self._ask(now_s)
        if self.autopilot in self._origin_for and not self.origin_confirmed:
            self._send_origin(now_s)
        self._warn_of_silence(now_s, now_s - self._began_s)

    def _ask(self, now_s: float) -> None:
        if now_s - self._ask_s < (ASK_S if self._asked < ASKED_OFTEN else ASK_SELDOM_S) - 0.1:
            return
        self._ask_s = now_s
        self._asked += 1
        names = MESSAGES[self._reader.kind]
        if self._reader.kind is TruthKind.AUTO and self.autopilot in _OWN:
            names = (_OWN[self.autopilot],)
        for name in names:
            self._sender.command_long_send(
                *(self._system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0),
                *(_IDS[name], 1e6 / self._truth_hz, 0, 0, 0, 0, 0),
            )

    def _send_origin(self, now_s: float) -> None:
        """An estimator takes it once it runs; a datagram may be lost: so again until it is answered."""
        if now_s - self._first_heartbeat_s < ORIGIN_AFTER_S or now_s - self._origin_s < ORIGIN_EVERY_S - 0.1:
            return
        if self._origin_tries >= ORIGIN_TRIES:
            self._warn_once(f"the autopilot has not answered SET_GPS_GLOBAL_ORIGIN in {ORIGIN_TRIES} tries")
            return
        self._origin_s = now_s
        self._origin_tries += 1
        fix = self._reader.origin or SOMEWHERE
        self._sender.set_gps_global_origin_send(
            *(self._system_id, round(fix.latitude_deg * 1e7), round(fix.longitude_deg * 1e7)),
            *(ALTITUDE_MM, int(now_s * 1e6)),
        )

    def _warn_of_silence(self, now_s: float, since_s: float) -> None:
        if since_s < SILENT_S or self._truth_s:
            return
        if math.isinf(self._heartbeat_s):
            self._warn_once(
                f"nothing received from an autopilot with system id {self._system_id} for {SILENT_S:.0f} s: waiting"
            )
        elif now_s - self._first_heartbeat_s > SILENT_S:
            names = " or ".join(MESSAGES[self._reader.kind])
            self._warn_once(
                f"the autopilot is there but sends no {names}: only simulators know the truth; without one, "
                "--truth-from local takes the autopilot's own estimate"
            )

    def _warn_once(self, text: str) -> None:
        if text not in self._warned:
            self._warned.add(text)
            log.warning("%s", text)
