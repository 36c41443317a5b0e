"""Where the vehicle was, for the last seconds: each depth frame is placed with the pose at its own exposure."""

from __future__ import annotations

import bisect
import math
from collections import deque
from typing import Generic, NamedTuple, TypeVar

from companion.model import ABSURD, Pose, wrap_rad

EXTRAPOLATION_S = 0.03
"""How far beyond the newest sample a pose may be guessed, from the rates of that sample: 3 cm at 1 m/s."""
GAP_S = 0.25
"""Between samples further apart than this nobody knows what the vehicle did."""
NEAREST_ATTITUDE_S = 0.05
"""`PoseBuffer.newest` takes an attitude this old: at 1 rad/s of turn that is 3°."""
SAMPLES = 1024
"""Of each kind: two seconds at 500 Hz."""


class _Attitude(NamedTuple):
    t_s: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    yaw_rate_radps: float

    def towards(self, later: _Attitude, share: float) -> _Attitude:
        return _Attitude(
            t_s=_between(self.t_s, later.t_s, share),
            roll_rad=_turned(self.roll_rad, later.roll_rad, share),
            pitch_rad=_turned(self.pitch_rad, later.pitch_rad, share),
            yaw_rad=_turned(self.yaw_rad, later.yaw_rad, share),
            yaw_rate_radps=_between(self.yaw_rate_radps, later.yaw_rate_radps, share),
        )

    def ahead(self, by_s: float) -> _Attitude:
        return self._replace(t_s=self.t_s + by_s, yaw_rad=wrap_rad(self.yaw_rad + self.yaw_rate_radps * by_s))


class _Position(NamedTuple):
    t_s: float
    x_m: float
    y_m: float
    z_m: float
    vx_mps: float
    vy_mps: float
    vz_mps: float

    def towards(self, later: _Position, share: float) -> _Position:
        return _Position(*(_between(before, after, share) for before, after in zip(self, later, strict=True)))

    def ahead(self, by_s: float) -> _Position:
        return self._replace(
            t_s=self.t_s + by_s,
            x_m=self.x_m + self.vx_mps * by_s,
            y_m=self.y_m + self.vy_mps * by_s,
            z_m=self.z_m + self.vz_mps * by_s,
        )


Sample = TypeVar("Sample", _Attitude, _Position)


class _Track(Generic[Sample]):
    """Samples of one kind in the order of their times, the last seconds only."""

    def __init__(self, length_s: float) -> None:
        self._length_s = length_s
        self.samples: deque[Sample] = deque(maxlen=SAMPLES)

    def add(self, sample: Sample) -> bool:
        """False when it is refused: not finite, absurd, or not later than the newest."""
        t_s, *values = sample
        if not math.isfinite(t_s) or not all(abs(value) < ABSURD for value in values):
            return False
        if self.samples and t_s <= self.samples[-1].t_s:
            return False
        self.samples.append(sample)
        while self.samples[0].t_s < t_s - self._length_s:
            self.samples.popleft()
        return True

    def at(self, t_s: float) -> Sample | None:
        """Interpolated; a little beyond the newest by its rates; None where nothing is known."""
        after = bisect.bisect_left(self.samples, t_s, key=lambda sample: sample.t_s)
        if after == len(self.samples):
            if not self.samples or t_s - self.samples[-1].t_s > EXTRAPOLATION_S:
                return None
            return self.samples[-1].ahead(t_s - self.samples[-1].t_s)
        later = self.samples[after]
        if later.t_s == t_s:
            return later
        if after == 0:
            return None
        earlier = self.samples[after - 1]
        gap_s = later.t_s - earlier.t_s
        if gap_s > GAP_S:
            return None
        return earlier.towards(later, (t_s - earlier.t_s) / gap_s)


class PoseBuffer:
    """Attitudes and positions of the last seconds, and the pose at any time between them.

    The two come in messages of their own, at their own times; each is interpolated by itself, angles by the short way.

    Args:
        length_s: how much is remembered, counted back from the newest of each kind.

    Attributes:
        refused: samples that were not finite, absurd, or not later than the one before.
    """

    def __init__(self, length_s: float = 2.0) -> None:
        self._attitudes: _Track[_Attitude] = _Track(length_s)
        self._positions: _Track[_Position] = _Track(length_s)
        self.refused = 0

    def add_attitude(
        self, t_s: float, roll_rad: float, pitch_rad: float, yaw_rad: float, yaw_rate_radps: float
    ) -> None:
        """An attitude in ENU/FLU, as in `Pose`, at ``t_s``."""
        self.refused += not self._attitudes.add(_Attitude(t_s, roll_rad, pitch_rad, yaw_rad, yaw_rate_radps))

    def add_position(
        self, t_s: float, x_m: float, y_m: float, z_m: float, vx_mps: float, vy_mps: float, vz_mps: float
    ) -> None:
        """A position and velocity in ENU at ``t_s``."""
        self.refused += not self._positions.add(_Position(t_s, x_m, y_m, z_m, vx_mps, vy_mps, vz_mps))

    def at(self, t_s: float) -> Pose | None:
        """The pose at ``t_s``; None outside what is known and inside a gap of more than `GAP_S`."""
        if not math.isfinite(t_s):
            return None
        attitude, position = self._attitudes.at(t_s), self._positions.at(t_s)
        return None if attitude is None or position is None else _pose(t_s, attitude, position)

    def newest(self) -> Pose | None:
        """The pose at the newest position, with the attitude of that time or one within `NEAREST_ATTITUDE_S` of it."""
        if not self._positions.samples:
            return None
        position = self._positions.samples[-1]
        attitude = self._attitudes.at(position.t_s)
        if attitude is None:
            attitude = min(self._attitudes.samples, key=lambda one: abs(one.t_s - position.t_s), default=None)
            if attitude is None or abs(attitude.t_s - position.t_s) > NEAREST_ATTITUDE_S:
                return None
        return _pose(position.t_s, attitude, position)

    def clear(self) -> None:
        """Forget everything: the autopilot was started again, or its estimate has leapt."""
        self._attitudes.samples.clear()
        self._positions.samples.clear()


def _pose(t_s: float, attitude: _Attitude, position: _Position) -> Pose:
    return Pose(**(attitude._asdict() | position._asdict() | {"t_s": t_s}))


def _between(earlier: float, later: float, share: float) -> float:
    value = earlier + (later - earlier) * share
    # Rounding must not leave the interval.
    return min(max(value, min(earlier, later)), max(earlier, later))


def _turned(earlier_rad: float, later_rad: float, share: float) -> float:
    return wrap_rad(earlier_rad + wrap_rad(later_rad - earlier_rad) * share)
