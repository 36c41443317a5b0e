"""Where a simulated vehicle truly is, as its simulator tells: for answers that no estimator can be asked."""

from __future__ import annotations

import math
import socket
import time
from typing import Any

from sitl.autopilot.codec import Decoder
from sitl.autopilot.mavlink import dialect as m
from tests.integration.relay import LOOPBACK
from tests.shared.beside import OwnThread
from validation.fault_matrix.true_way import TrueWay

SENDER = (1, m.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY)
PERIOD_US = 20_000


class TruthListener(OwnThread):
    """Listens to the port of the world while the block lasts.

    Attributes:
        way: what it has heard.
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((LOOPBACK, port))
        self._socket.settimeout(0.1)
        self.port: int = self._socket.getsockname()[1]
        self.way = TrueWay()
        super().__init__("truth", self._socket)

    def way_m(self, since_s: float) -> float:
        """The greatest horizontal distance from where it was then."""
        looks = self.way.looks(since_s)
        return max(math.hypot(one.x_m - looks[0].x_m, one.y_m - looks[0].y_m) for one in looks)

    def _run(self) -> None:
        asked_s = 0.0
        while not self._stop.is_set():
            try:
                data, autopilot = self._socket.recvfrom(65536)
            except TimeoutError:
                continue
            now_s = time.monotonic()
            for message in Decoder().messages(data):
                self.way.hear(message, now_s)
            newest = self.way.newest()
            if (newest is None or now_s - newest.t_s > 1.0) and now_s - asked_s > 1.0:
                asked_s = now_s
                self._ask(autopilot)

    def _ask(self, autopilot: Any) -> None:
        order = m.MAVLink_command_long_message(
            *(1, 1, m.MAV_CMD_SET_MESSAGE_INTERVAL, 0),
            *(m.MAVLINK_MSG_ID_SIM_STATE, PERIOD_US, 0, 0, 0, 0, 0),
        )
        self._socket.sendto(order.pack(m.MAVLink(None, *SENDER)), autopilot)
