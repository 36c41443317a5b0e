"""The odometry that a tracking camera on the vehicle would give: late, noisy, drifting, and gone at times."""

from __future__ import annotations

import enum
import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from companion.config.sim import NoiseSettings
from companion.errors import InputError
from companion.model import Pose
from sitl.scene.sensors import PoseEstimate
from sitl.world.placement import moved
from sitl.world.trouble import Trouble, Troubled

LARGEST_DELAY_S = 2.0
MOST_LATE = 512
"""Estimates that may be under way: two seconds of them at more than 200 Hz."""

NORTH_RAD = math.pi / 2.0
"""Yaw towards north in our frames."""

GIVEN_UP_S = 1.0
"""A tracker that has not seen for longer has lost itself: it begins a new frame."""


class Align(enum.StrEnum):
    """What the x axis of the odometry's frame is at the start."""

    START = "start"
    NORTH = "north"


@dataclass(frozen=True, slots=True)
class OdometrySettings:
    """What is wrong with the odometry.

    Attributes:
        rate_hz: estimates a second: 30 for PX4, 50 for ArduPilot.
        position_noise_m: white noise of each position axis.
        attitude_noise_rad: of each attitude angle.
        velocity_noise_mps: of each velocity axis.
        drift_share: drift as a share of the way flown.
        delay_s: from exposure to sending.
        loss_share: share of the estimates that are never sent.
        outage_s: when the tracker is blind, as (begin, length) counted from its first estimate; None: never.
        align: START as real trackers do, which know no compass; NORTH as if a survey had been done.
    """

    rate_hz: float = 30.0
    position_noise_m: float = 0.01
    attitude_noise_rad: float = 0.003
    velocity_noise_mps: float = 0.03
    drift_share: float = 0.005
    delay_s: float = 0.0
    loss_share: float = 0.0
    outage_s: tuple[float, float] | None = None
    align: Align = Align.START

    def __post_init__(self) -> None:
        """Refuse what makes no sense.

        Raises:
            InputError: a value is out of its bounds.
        """
        bounds = {
            "--odometry-hz": (self.rate_hz, 1.0, 200.0),
            "--odometry-noise": (self.position_noise_m, 0.0, 1.0),
            "--odometry-attitude-noise": (self.attitude_noise_rad, 0.0, 0.5),
            "--odometry-velocity-noise": (self.velocity_noise_mps, 0.0, 1.0),
            "--odometry-drift": (self.drift_share, 0.0, 0.2),
            "--odometry-delay": (self.delay_s, 0.0, LARGEST_DELAY_S),
            "--odometry-loss": (self.loss_share, 0.0, 1.0),
        }
        for name, (value, low, high) in bounds.items():
            if not low <= value <= high:  # also refuses NaN
                raise InputError(f"{name} {value:g}: must be from {low:g} to {high:g}")
        if self.outage_s is not None and not all(0.0 <= value <= 1e6 for value in self.outage_s):
            raise InputError(f"--odometry-outage {self.outage_s[0]:g} {self.outage_s[1]:g}: two times in s, from 0")


@dataclass(frozen=True, slots=True)
class Estimate:
    """One estimate of the tracker.

    Attributes:
        pose: in the tracker's own frame, which starts at zero; up is up. Where it starts along its x axis, that is
            called north, so that `companion.frames.pose_to_ned` makes forward-right-down of it.
        resets: how often the frame has begun anew.
    """

    pose: Pose
    resets: int


class Odometry:
    """A tracker that watches the true pose.

    Args:
        settings: what is wrong with it.
        rng: for noise and losses.
    """

    def __init__(self, settings: OdometrySettings, rng: np.random.Generator) -> None:
        self.lost = 0
        """Estimates that were not sent, by chance or by an outage."""
        self.resets = 0
        self._settings = settings
        self._rng = rng
        self._noise = NoiseSettings(
            pose_noise_m=settings.position_noise_m,
            pose_noise_rad=settings.attitude_noise_rad,
            velocity_noise_mps=settings.velocity_noise_mps,
            pose_drift_share=settings.drift_share,
        )
        self._estimate = PoseEstimate(self._noise, rng)
        self._troubled = Troubled()
        self._start: Pose | None = None
        self._began_s: float | None = None
        self._next_s = 0.0
        self._seen_s = -math.inf
        self._under_way: deque[tuple[float, Estimate]] = deque(maxlen=MOST_LATE)

    def observe(self, true: Pose, heading_offset_rad: float) -> bool:
        """The true pose at a new moment, in order of time; whether an estimate was made of it.

        Args:
            true: in the mine.
            heading_offset_rad: yaw in the mine minus yaw by the compass, for the alignment with north.
        """
        settings, t_s = self._settings, true.t_s
        period_s = 1.0 / settings.rate_hz
        # A quarter period early still counts: truth at the very rate of the tracker comes with jitter.
        if t_s < self._next_s - 0.25 * period_s:
            return False
        self._next_s = max(self._next_s + period_s, t_s + 0.5 * period_s)
        if self._began_s is None:
            self._began_s = t_s
        if self._blind(t_s - self._began_s):
            self.lost += 1
            return False
        if self._start is None or t_s - self._seen_s > GIVEN_UP_S:
            if self._start is not None:
                self.restart()
            self._start = true
        self._seen_s = t_s
        estimated = self._troubled.of(self._estimate.of(true))
        if settings.loss_share > 0.0 and self._rng.random() < settings.loss_share:
            self.lost += 1
            return False
        turn_rad = NORTH_RAD - self._start.yaw_rad if settings.align is Align.START else -heading_offset_rad
        self._under_way.append(
            (t_s + settings.delay_s, Estimate(moved(estimated, self._start, (0.0, 0.0, 0.0), turn_rad), self.resets))
        )
        return True

    def due(self, now_s: float) -> list[Estimate]:
        """The estimates that are to be sent by now, oldest first."""
        out = []
        while self._under_way and self._under_way[0][0] <= now_s:
            out.append(self._under_way.popleft()[1])
        return out

    def begin(self, trouble: Trouble) -> None:
        """Something goes wrong from now on, or no longer."""
        self._troubled.begin(trouble)

    def restart(self) -> None:
        """The tracker has lost itself: its next estimate is the zero of a new frame."""
        self.resets += 1
        self._start = None
        self._estimate = PoseEstimate(self._noise, self._rng)

    def _blind(self, since_begin_s: float) -> bool:
        if self._troubled.now.lost:
            return True
        if self._settings.outage_s is None:
            return False
        begin_s, length_s = self._settings.outage_s
        return begin_s <= since_begin_s < begin_s + length_s
