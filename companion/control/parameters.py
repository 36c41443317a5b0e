"""The numbers of the navigation law, as plain values: the law does not know where they come from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Governor:
    """Settings of the speed governor; meanings as in `companion.config.control.GovernorSettings`."""

    reaction_s: float
    brake_mps2: float
    side_margin_m: float
    turn_share: float
    least_speed_mps: float


@dataclass(frozen=True, slots=True)
class Parameters:
    """Settings of the law (paper Tables I and II); meanings as in `companion.config.control.ControlSettings`."""

    period_s: float
    speed_mps: float
    max_yaw_rate_radps: float
    max_climb_mps: float
    max_accel_mps2: float
    height_m: float
    margin_m: float
    critical_margin_m: float
    vertical_margin_m: float
    edge_bearing_rad: float
    edge_jump_m: float
    target_radius_m: float
    tangent_probability: float
    choice: Literal["coin", "frontier"]
    least_probability: float
    height_gain_per_s: float
    closing_gain_per_s: float
    closing_saturation_m: float
    law: Literal["paper", "smooth"]
    boundary_layer_mps: float
    boundary_layer_rad: float
    speed_law: Literal["paper", "governor"]
    governor: Governor
    climb_feed_forward: bool
    pause_s: float
    target_timeout_factor: float
