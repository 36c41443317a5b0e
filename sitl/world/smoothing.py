"""Positions on a coarse grid and velocities in between: the smooth place that both agree with."""

from __future__ import annotations

Triple = tuple[float, float, float]

TAU_S = 0.5
"""How long the velocity is believed before the position has its way."""

GAP_S = 0.5
"""After a silence this long it starts anew at the position."""


class PositionFilter:
    """A complementary filter that never leaves the grid cell beside the one it was told.

    x ← x + v·dt, then a share dt/TAU of the way to the measured position, then back to within one step of it. The true
    position is within one step of the measured one (a cell is rounded or cut off), so the error is at most **two
    steps** whatever the velocity says: 2.2 cm on the 1.1 cm grid of latitude and longitude. With a velocity that is
    right to 1 cm/s (HIL_STATE_QUATERNION cuts off there) it stays within 1.5 steps, and it does not jump: between two
    messages it moves by v·dt and at most a share dt/TAU of a step.

    Args:
        steps_m: the grid along each axis, in m.
    """

    def __init__(self, steps_m: Triple) -> None:
        self._steps_m = steps_m
        self._place: Triple | None = None
        self._t_s = 0.0

    def update(self, t_s: float, measured_m: Triple, velocity_mps: Triple) -> Triple:
        """The smooth position at ``t_s``, in m."""
        dt_s = t_s - self._t_s
        self._t_s = t_s
        if self._place is None or not 0.0 <= dt_s <= GAP_S:
            self._place = measured_m
            return measured_m
        share = min(dt_s / TAU_S, 1.0)
        x, y, z = (
            _toward(place + speed * dt_s, measured, share, step)
            for place, measured, speed, step in zip(self._place, measured_m, velocity_mps, self._steps_m, strict=True)
        )
        self._place = (x, y, z)
        return self._place


def _toward(predicted: float, measured: float, share: float, step: float) -> float:
    smooth = predicted + share * (measured - predicted)
    return min(max(smooth, measured - step), measured + step)
