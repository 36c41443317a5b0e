"""The origin on the globe of an autopilot without GPS: whether it is to have one, and telling it.

Hold (PX4) and home (ArduPilot) need one. But PX4 that gets its odometry as LOCAL_FRD never knows a heading to north:
with an origin it believes that it has a global position, never computes one, and lands at the place that was never
written, latitude 0 and longitude 0. It is told an origin only where the odometry comes as LOCAL_NED.
"""

from __future__ import annotations

import math

from companion.autopilot.interface import Link
from companion.config.autopilot import AutopilotSettings
from companion.mavlink.firmware import AutopilotKind

LATITUDE_E7, LONGITUDE_E7, ALTITUDE_MM = 473977418, 85455939, 0
"""Any place on Earth does: without GPS the autopilot only needs to have one. Any height but 0 would be added to PX4's
own, and a geofence about the start would be as far away."""

ORIGIN_MESSAGE, POSITION_MESSAGE = "GPS_GLOBAL_ORIGIN", "GLOBAL_POSITION_INT"
HEARD_S = 3.5
"""Both are asked for at 1 Hz or more: this old, one of them may have been lost twice."""
FIRST_LISTEN_S = 4.0
"""Somebody else may just have set one: it is heard within this time, and a second one would shift the height."""
TELL_AGAIN_S = 2.0
JUDGE_S = 5.0
"""A global position comes at once when it comes; PX4 was ready to hold 5 s after an origin."""


def is_wanted(kind: AutopilotKind, settings: AutopilotSettings) -> bool:
    """Whether the autopilot is to be told an origin."""
    return not settings.gps and (kind is AutopilotKind.ARDUPILOT or settings.odometry_frame == "local_ned")


class GlobalOrigin:
    """Tells an origin until one is heard, and listens for one first.

    One that somebody else has set stays: another with another altitude shifts the height at once.
    """

    def __init__(self, link: Link, settings: AutopilotSettings) -> None:
        self._link = link
        self._wanted = is_wanted(link.kind, settings)
        self._origin = link.watch(ORIGIN_MESSAGE)
        self._position = link.watch(POSITION_MESSAGE)
        self._listens_since_s: float | None = None
        self._told_s = -math.inf
        self._heard_s: float | None = None

    def tell_where_missing(self, now_s: float) -> None:
        """Tell it, if it is wanted and has not been heard; not before `FIRST_LISTEN_S` after the first call.

        Raises:
            LinkError: the link is gone.
        """
        if self._listens_since_s is None:
            self._listens_since_s = now_s
        if self._origin.age_s(now_s) <= HEARD_S:
            self._heard_s = now_s if self._heard_s is None else self._heard_s
        elif self._wanted and now_s - self._listens_since_s >= FIRST_LISTEN_S and now_s - self._told_s >= TELL_AGAIN_S:
            self._told_s = now_s
            self._link.send(
                "SET_GPS_GLOBAL_ORIGIN",
                {
                    "target_system": self._link.system_id,
                    "latitude": LATITUDE_E7,
                    "longitude": LONGITUDE_E7,
                    "altitude": ALTITUDE_MM,
                    "time_usec": int(now_s * 1e6),
                },
            )

    def can_be_judged(self, now_s: float) -> bool:
        """Whether what is heard now of origin and global position is what there will be."""
        if not self._wanted:
            return True
        if self._heard_s is None:
            return False
        return self._position.age_s(now_s) <= HEARD_S or now_s - self._heard_s >= JUDGE_S
