"""What the law does against drift: speed zero stands, and what comes too near is moved away from. Pure.

The paper's vehicle stands when its speed is zero, also while it turns, and flies where it points. A real one creeps on,
by centimetres a second where its velocity estimate is a little wrong, by decimetres where its odometry drifts or its
GPS errs. Two things hold it: its own position, and the walls that it sees just now, which are true also when the
position is not.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from companion.control.governor import room_m
from companion.control.parameters import Parameters
from companion.model import HIT, Pose, Scan, Setpoint
from companion.sides import AWAY_PER_S, Sides, away_mps
from companion.station_keeping import StationKeeper

AWAY_MPS = 0.4
"""How fast it moves away from a wall that has come nearer, at most: SIH with GPS was carried sideways so fast. Against
a drift of 0.2 m/s it stands 0.1 m inside d_c."""
BEHIND_RAD = math.radians(40.0)
"""Half of the sector into which it would move, in which no wall may be nearer than d_c."""


class Standing:
    """Makes of a setpoint without speed one that stands.

    Args:
        parameters: the law's settings.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._keep_m = parameters.critical_margin_m + room_m(parameters)
        self._speed_mps = parameters.speed_mps
        self._most_mps = min(AWAY_MPS, parameters.speed_mps)
        self._makes_room = parameters.law != "paper"
        """The paper's vehicle flies where it points."""
        self._station = StationKeeper()

    def release(self) -> None:
        """It flies, or something is missing by which to stand."""
        self._station.release()

    def keep_at(self, x_m: float, y_m: float, z_m: float) -> None:
        """Where it is to stand from now on, instead of where it came to stand."""
        self._station.place_m = x_m, y_m, z_m

    def of(self, setpoint: Setpoint, scan: Scan, sides: Sides, pose: Pose) -> Setpoint:
        """The same, led back to where it came to stand, or away from a wall that has come as near as d_c.

        In flight only to the side: ahead is the governor's, and the speed that it gives is shared with the way aside.
        """
        if setpoint.speed_mps != 0.0:
            self.release()
            left_mps = away_mps(sides, self._keep_m, self._most_mps)[1] if self._makes_room else 0.0
            # All the way aside, rounding can make of what is left less than nothing.
            left_over_mps = math.sqrt(max(0.0, self._speed_mps**2 - left_mps**2))
            return replace(
                setpoint,
                speed_mps=min(setpoint.speed_mps, left_over_mps),
                lateral_mps=left_mps,
            )
        away = self._away_mps(scan)
        if away is None:
            away = away_mps(sides, self._keep_m, self._most_mps)
            away = away if any(away) else None
        if away is not None:
            # Where it stands then is where it is to stay.
            self.release()
            forward_mps, left_mps = away
        else:
            at_m, velocity_mps = (pose.x_m, pose.y_m, pose.z_m), (pose.vx_mps, pose.vy_mps, pose.vz_mps)
            forward_mps, left_mps, _ = self._station.velocity(at_m, velocity_mps, pose.yaw_rad, setpoint.t_s)
        return replace(setpoint, speed_mps=forward_mps, lateral_mps=left_mps)

    def _away_mps(self, scan: Scan) -> tuple[float, float] | None:
        """Forward and left, away from the nearest wall that is in view; None where none is near, or one is behind.

        Remembered walls are where the position says, so they only stop it.
        """
        hit = scan.state == HIT
        seen = hit & scan.fresh
        if not seen.any():
            return None
        nearest = int(np.argmin(np.where(seen, scan.ranges_m, np.inf)))
        missing_m = self._keep_m - float(scan.ranges_m[nearest])
        if missing_m <= 0.0:
            return None
        bearing_rad = float(scan.bearings_rad[nearest])
        behind = np.cos(scan.bearings_rad - bearing_rad) < -math.cos(BEHIND_RAD)
        if np.any(behind & hit & (scan.ranges_m < self._keep_m)):
            return None
        speed_mps = min(self._most_mps, AWAY_PER_S * missing_m)
        return -speed_mps * math.cos(bearing_rad), -speed_mps * math.sin(bearing_rad)
