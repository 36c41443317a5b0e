"""Whether the vehicle does what the setpoints on the wire ask for, by the autopilot's own velocity. Pure.

An autopilot can go on sending heartbeats in the right mode and fly something else: ArduCopter's guided mode that a
ground station has paused ignores every setpoint, without a text; one whose velocity estimate is wrong runs
away on zero.
"""

from __future__ import annotations

import enum
import math

STAND_MPS = 0.12
"""What keeps a place (`companion.station_keeping`) asks for less."""
SHARE = 0.25
"""Of a velocity that was asked for: with less the vehicle does not follow, it is not merely slow."""
FRESH_S = 0.3
"""Older setpoints are asked for no more, and older velocities say nothing of now."""
STAND_AFTER_S, MOVE_AFTER_S = 3.0, 1.5
"""It has so long to come to stand (the slowest way to brake that was measured takes 2 s), or to begin to move (both
autopilots have two thirds of a velocity after 0.6 to 1 s)."""
FOR_S = 0.5
"""So long it must then go on: an estimate of velocity is noisy."""


class _Asked(enum.Enum):
    STAND = enum.auto()
    MOVE = enum.auto()
    NEITHER = enum.auto()


class Obedience:
    """Compares what is asked for with what is flown.

    Args:
        limit_mps: who is asked to stand must be slower, and only who is asked for more is expected to move.
    """

    def __init__(self, limit_mps: float) -> None:
        self._limit_mps = limit_mps
        self.reset()

    def reset(self) -> None:
        """Nothing is asked for by setpoints: a new flight, or a mode in which the autopilot flies by itself."""
        self._asked, self._asked_mps = _Asked.NEITHER, (0.0, 0.0)
        self._asked_s, self._since_s = -math.inf, math.inf
        self._way = (0.0, 0.0)
        self._wrong_since_s: float | None = None
        self._flown_mps, self._flown_s = 0.0, -math.inf

    def on_setpoint(self, forward_mps: float, right_mps: float, now_s: float) -> None:
        """One setpoint went out to the autopilot."""
        speed_mps = math.hypot(forward_mps, right_mps)
        asked = _Asked.NEITHER
        if speed_mps <= STAND_MPS:
            asked = _Asked.STAND
        elif speed_mps >= self._limit_mps:
            asked = _Asked.MOVE
        turns = asked is _Asked.MOVE and forward_mps * self._way[0] + right_mps * self._way[1] <= 0.0
        if asked is not self._asked or turns or now_s - self._asked_s > FRESH_S:
            # Who is asked to turn back has to stop first, however well it obeys.
            self._since_s, self._wrong_since_s = now_s, None
            self._way = (forward_mps, right_mps)
        self._asked, self._asked_mps, self._asked_s = asked, (forward_mps, right_mps), now_s

    def on_velocity(self, forward_mps: float, right_mps: float, now_s: float) -> None:
        """What the autopilot says to fly."""
        if now_s - self._flown_s > FRESH_S:
            self._wrong_since_s = None
        self._flown_s = now_s
        if self._asked is _Asked.MOVE:
            asked_mps = math.hypot(*self._asked_mps)
            along = (forward_mps * self._asked_mps[0] + right_mps * self._asked_mps[1]) / asked_mps
            wrong, self._flown_mps = along < SHARE * asked_mps, along
        else:
            self._flown_mps = math.hypot(forward_mps, right_mps)
            wrong = self._asked is _Asked.STAND and self._flown_mps > self._limit_mps
        if not wrong:
            self._wrong_since_s = None
        elif self._wrong_since_s is None:
            self._wrong_since_s = now_s

    def wrong(self, now_s: float) -> str | None:
        """What is not obeyed, in a few words; None: nothing that can be told."""
        if self._wrong_since_s is None or now_s - min(self._asked_s, self._flown_s) > FRESH_S:
            return None
        after_s = STAND_AFTER_S if self._asked is _Asked.STAND else MOVE_AFTER_S
        if now_s - self._since_s < after_s or now_s - self._wrong_since_s < FOR_S:
            return None
        if self._asked is _Asked.STAND:
            return f"asked to stand, flies {self._flown_mps:.2f} m/s"
        return f"asked {math.hypot(*self._asked_mps):.2f} m/s, flies {self._flown_mps:.2f}"
