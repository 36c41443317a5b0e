"""Single-beam rangefinders: the newest reading of each, height and roof from it, and how long it has been silent."""

from __future__ import annotations

import math
from collections.abc import Iterable

from companion.config.sensors import BeamSettings
from companion.model import Beam, Pose, RangeReading

AGREE_M = 0.3
"""Two readings one after the other that differ by more are of two things: so far a wall beside comes nearer in a tenth
of a second by no speed of ours, and at a corner it is the next one that agrees."""


class Beams:
    """Keeps the newest reading of each beam, and the pose at which it came.

    Args:
        settings: which beams there are, and how long a reading counts.
    """

    def __init__(self, settings: BeamSettings) -> None:
        self._stale_after_s = settings.stale_after_s
        # The law flies on without the roof: it only makes the vehicle fly lower.
        self._counted_on = tuple(beam for beam in settings.directions if beam is not Beam.UP)
        self._readings: dict[Beam, tuple[RangeReading, Pose]] = {}
        self._sure: dict[Beam, bool] = {}
        self._reported_s: dict[Beam, float] = {}

    def on_readings(self, readings: Iterable[RangeReading], pose: Pose) -> None:
        """Keep the readings of a tick, with the pose of that tick."""
        for reading in readings:
            # One that measured nothing does not hide the last one that did: that one ages by itself.
            if reading.range_m is not None:
                self._sure[reading.beam] = self._agrees(reading)
                self._readings[reading.beam] = (reading, pose)
            # A beam to the side that sees nothing works: it may look down a drift. Below, only one that sees as far as
            # it can: it may look down a shaft.
            if reading.beam is not Beam.DOWN or _measured_m(reading) is not None or sees_nothing(reading):
                self._reported_s[reading.beam] = reading.t_s

    def fresh(self, beam: Beam, t_s: float) -> tuple[RangeReading, Pose] | None:
        """The newest reading that is one, and the pose when it came; None when it is too old or from the future."""
        known = self._readings.get(beam)
        return known if known is not None and 0.0 <= t_s - known[0].t_s <= self._stale_after_s else None

    def is_sure(self, beam: Beam) -> bool:
        """Whether its newest reading agrees with the one before: one alone may have met dust or spray."""
        return self._sure.get(beam, False)

    def _agrees(self, reading: RangeReading) -> bool:
        before = self._readings.get(reading.beam)
        if before is None or reading.range_m is None or before[0].range_m is None:
            return False
        age_s = reading.t_s - before[0].t_s
        return 0.0 < age_s <= self._stale_after_s and abs(reading.range_m - before[0].range_m) <= AGREE_M

    def level_m(self, beam: Beam, pose: Pose, t_s: float) -> float | None:
        """A beam's range along gravity or the horizon, or None: not there, stale, nothing measured, out of range."""
        known = self.fresh(beam, t_s)
        range_m = None if known is None else _measured_m(known[0])
        if range_m is None or not pose.is_finite:
            return None
        level_m = range_m * math.cos(pose.pitch_rad) * math.cos(pose.roll_rad)
        # Upside down a beam says nothing of the ground.
        return level_m if level_m > 0.0 else None

    def height_m(self, pose: Pose, t_s: float) -> float | None:
        """The height h (paper Definition 3.7), tilt compensated, carried on by the climb since the reading."""
        known = self._readings.get(Beam.DOWN)
        if known is None:
            return None
        height_m = self.level_m(Beam.DOWN, known[1], t_s)
        if height_m is None:
            return None
        height_m += pose.z_m - known[1].z_m
        return height_m if math.isfinite(height_m) else None

    def no_ground(self, t_s: float) -> bool:
        """Whether the newest reading downward says that nothing is there as far as the beam reaches."""
        known = self.fresh(Beam.DOWN, t_s)
        return known is not None and sees_nothing(known[0])

    def oldest_age_s(self, t_s: float) -> float:
        """Time since the newest reading of the configured beam that has been silent longest; the one upward may be.

        Infinite when a beam has never reported, or its newest stamp lies in the future: that says nothing of its age.
        """
        ages_s = (t_s - self._reported_s.get(beam, -math.inf) for beam in self._counted_on)
        return max(age_s if age_s >= 0.0 else math.inf for age_s in ages_s)


def sees_nothing(reading: RangeReading) -> bool:
    """Whether it is free out to the beam's limit."""
    return reading.range_m is not None and reading.range_m >= reading.max_range_m


def _measured_m(reading: RangeReading) -> float | None:
    """The range at which something is; None at zero, as many say "nothing", and at the limit, where it is free."""
    range_m = reading.range_m
    return range_m if range_m is not None and 0.0 < range_m < reading.max_range_m else None
