"""How the vehicle moves by the autopilot's own words, and whether these can be true. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping

from companion.mavlink.position_jump import Motion as Six
from companion.mavlink.position_jump import position_jump_m

LARGEST_M = 1e6
"""No flight leads a thousand kilometres away; a NaN is not smaller either. The same as `companion.model.ABSURD`, whose
module needs numpy, which the gate does without."""
RESTART_S = 1.0
"""Stamps that go back by more than this, on the ground, are those of an autopilot that started anew."""

_PLACE = ("x", "y", "z")
_SPEED = ("vx", "vy", "vz")


class Motion:
    """Takes LOCAL_POSITION_NED and ATTITUDE.

    Args:
        jump_m: a position this far from where the last one and its velocity lead is a jump.

    Attributes:
        fresh_s: when the newest position came that can be believed; -inf before the first.
        jumped_s: when the position last jumped; -inf: never.
    """

    def __init__(self, jump_m: float) -> None:
        self.fresh_s = -math.inf
        self.jumped_s = -math.inf
        self._jump_m = jump_m
        self._stamp_s = -math.inf
        self._state: Six | None = None
        self._changed_s = -math.inf
        self._yaw_rad: float | None = None

    @property
    def place_m(self) -> tuple[float, float, float] | None:
        """North, east, down; None before the first."""
        return None if self._state is None else self._state[:3]

    def position(self, fields: Mapping[str, float], now_s: float, armed: bool) -> None:
        """One LOCAL_POSITION_NED that came at ``now_s``."""
        stamp_s = 1e-3 * fields["time_boot_ms"]
        x_m, y_m, z_m = (fields[name] for name in _PLACE)
        vx_mps, vy_mps, vz_mps = (fields[name] for name in _SPEED)
        state: Six = (x_m, y_m, z_m, vx_mps, vy_mps, vz_mps)
        if not all(abs(value) < LARGEST_M for value in state):
            return
        if stamp_s <= self._stamp_s and (armed or stamp_s > self._stamp_s - RESTART_S):
            # What was measured before is no news, however late it comes.
            return
        if self._state is None or state != self._state:
            self._changed_s = now_s
        if self._state is not None and position_jump_m(self._state, state, stamp_s - self._stamp_s) > self._jump_m:
            self.jumped_s = now_s
        self._state, self._stamp_s, self.fresh_s = state, stamp_s, now_s

    def attitude(self, fields: Mapping[str, float]) -> None:
        """One ATTITUDE."""
        if abs(fields["yaw"]) < LARGEST_M:
            self._yaw_rad = fields["yaw"]

    def frozen_for_s(self) -> float:
        """For how long positions have come that all say the same."""
        return 0.0 if self._state is None else self.fresh_s - self._changed_s

    @property
    def velocity_mps(self) -> tuple[float, float, float] | None:
        """North, east, down; None before the first."""
        return None if self._state is None else self._state[3:]

    @property
    def yaw_rad(self) -> float | None:
        """From north towards east; None before the first."""
        return self._yaw_rad

    def forward_right_mps(self) -> tuple[float, float] | None:
        """Speed along the heading, and to the right of it; None when it is not known."""
        if self._state is None or self._yaw_rad is None:
            return None
        north_mps, east_mps = self._state[3:5]
        cos, sin = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        return north_mps * cos + east_mps * sin, east_mps * cos - north_mps * sin

    def after(self, forward_m: float, right_m: float, down_m: float) -> tuple[float, float, float] | None:
        """North, east, down of a place given in the body's level frame; None when it is not known."""
        if self._state is None or self._yaw_rad is None:
            return None
        cos, sin = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        north_m, east_m, now_down_m = self._state[:3]
        return north_m + forward_m * cos - right_m * sin, east_m + forward_m * sin + right_m * cos, now_down_m + down_m
