"""The simulated vehicle and its imperfect sensors. Has no effect on a real flight."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from companion.config.section import Section


class DynamicsSettings(Section):
    """How the simulated vehicle follows its setpoints; the defaults are what PX4 was measured to do."""

    speed_gain: float = Field(0.85, gt=0.3, le=1.2, description="speed reached per speed commanded")
    speed_lag_s: float = Field(0.3, ge=0.0, le=3.0, description="first-order lag of the speed, in s")
    max_acceleration_mps2: float = Field(1.5, gt=0.1, le=20.0, description="acceleration limit, in m/s²")
    yaw_rate_gain: float = Field(0.97, gt=0.3, le=1.2, description="yaw rate reached per yaw rate commanded")
    yaw_rate_lag_s: float = Field(0.15, ge=0.0, le=3.0, description="first-order lag of the yaw rate, in s")
    max_yaw_acceleration_radps2: float = Field(3.0, gt=0.1, le=50.0, description="yaw acceleration limit, in rad/s²")
    command_latency_s: float = Field(0.05, ge=0.0, le=1.0, description="delay from setpoint to effect, in s")
    drift_mps: float = Field(
        0.03, ge=0.0, le=1.0, description="standard deviation of the slow disturbance of each velocity axis, in m/s"
    )


class NoiseSettings(Section):
    """What is wrong with the simulated readings."""

    enabled: bool = Field(True, description="false: ideal sensors and an ideal pose")
    depth_noise_per_m2: float = Field(
        0.002, ge=0.0, le=0.1, description="depth noise: standard deviation is this times depth squared, in 1/m"
    )
    depth_dropout_share: float = Field(0.02, ge=0.0, le=0.9, description="share of pixels without a measurement")
    depth_latency_s: float = Field(0.05, ge=0.0, le=1.0, description="delay from exposure to delivery of a frame, in s")
    frame_loss_share: float = Field(0.01, ge=0.0, le=0.9, description="share of frames that never arrive")
    range_noise_m: float = Field(0.02, ge=0.0, le=1.0, description="standard deviation of a beam's range, in m")
    range_dropout_share: float = Field(0.02, ge=0.0, le=0.9, description="share of beam readings without a measurement")
    pose_noise_m: float = Field(0.01, ge=0.0, le=1.0, description="standard deviation of each position axis, in m")
    pose_noise_rad: float = Field(0.003, ge=0.0, le=0.5, description="standard deviation of each attitude angle")
    velocity_noise_mps: float = Field(0.03, ge=0.0, le=1.0, description="standard deviation of each velocity axis")
    pose_drift_share: float = Field(
        0.0, ge=0.0, le=0.2, description="drift of the estimated position as a share of the way flown"
    )


class BatterySettings(Section):
    """The battery of the simulated vehicle; it drains evenly."""

    minutes: float | None = Field(
        None, gt=0.0, le=600.0, description="of flight from full to empty; null: it never empties, and nobody asks"
    )
    percent: float = Field(100.0, gt=0.0, le=100.0, description="charge at the start, in percent")
    worn_after_s: float | None = Field(
        None, ge=0.0, le=86400.0, description="from then on it drains faster, in s of flight; null: never"
    )
    worn_factor: float = Field(2.0, ge=1.0, le=100.0, description="so many times as fast")


class SimSettings(Section):
    """The simulation."""

    battery: BatterySettings = Field(BatterySettings(), description="the battery of the simulated vehicle")

    dynamics: DynamicsSettings = Field(DynamicsSettings(), description="the simulated vehicle")
    noise: NoiseSettings = Field(NoiseSettings(), description="the imperfection of sensors and pose")
    ends: Literal["truth", "done"] = Field(
        "truth",
        description="when a mission ends: truth, when 99 % of what can be seen is in the map; done, when the vehicle "
        "would say so itself, as in flight",
    )
    time_limit_s: float = Field(
        3600.0, gt=0.0, le=86400.0, description="simulated time after which a mission ends, in s"
    )
