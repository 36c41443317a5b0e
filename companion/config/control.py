"""Settings of the navigation law: the paper's Tables I and II, and what the tables leave open."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from companion.config.section import Section, refuse
from companion.mavlink.firmware import ARDUCOPTER_BRAKE_MPS2


class GovernorSettings(Section):
    """Bounds the speed by what can be braked and turned: it only ever lowers what law (12) gives."""

    reaction_s: float = Field(0.4, ge=0.0, le=3.0, description="time from seeing an obstacle to braking, in s")
    brake_mps2: float = Field(
        0.8,
        gt=0.0,
        le=10.0,
        description="deceleration that the vehicle surely reaches, in m/s²; the safety gate counts on it too, with any "
        f"speed_law. The default is for PX4; ArduPilot reaches {ARDUCOPTER_BRAKE_MPS2:g}, pre-flight refuses more",
    )
    turn_share: float = Field(
        0.6, gt=0.0, le=1.0, description="share of the largest yaw rate that is counted on to turn away from a wall"
    )
    side_margin_m: float = Field(
        0.1, ge=0.0, le=1.0, description="how far inside d_s a turn may swing before the vehicle slows, in m"
    )
    least_speed_mps: float = Field(
        0.05, gt=0.0, le=0.5, description="slowest forward speed while there is still room, in m/s"
    )


class ControlSettings(Section):
    """The navigation law. The symbol of the paper stands at the end of each description."""

    period_s: float = Field(0.05, ge=0.01, le=0.5, description="sampling period, in s")
    speed_mps: float = Field(0.5, gt=0.0, le=5.0, description="forward speed, in m/s (v_c, and v_M of the assumptions)")
    max_yaw_rate_radps: float = Field(0.6, gt=0.0, le=3.0, description="largest yaw rate, in rad/s (u_M)")
    max_climb_mps: float = Field(0.4, gt=0.0, le=3.0, description="largest climb and descent rate, in m/s")
    max_accel_mps2: float = Field(
        1.0,
        ge=0.2,
        le=5.0,
        description="largest growth of the commanded speed and climb, in m/s²; slowing down is never limited",
    )
    height_m: float = Field(1.5, ge=0.3, le=20.0, description="height above ground, in m (H)")
    margin_m: float = Field(1.0, ge=0.3, le=10.0, description="safety margin to walls, in m (d_s)")
    critical_margin_m: float = Field(
        0.7, ge=0.1, le=10.0, description="below this distance in front or beside, stop and turn, in m (d_c)"
    )
    vertical_margin_m: float = Field(
        0.6, ge=0.2, le=10.0, description="least distance to the roof, and between the layers of several vehicles, in m"
    )
    edge_bearing_rad: float = Field(
        0.6, gt=0.0, le=0.7, description="an edge within this bearing of the heading can be an exit, in rad (ᾱ)"
    )
    edge_jump_m: float = Field(
        2.0, gt=0.0, le=20.0, description="jump of the range between neighbouring bearings that makes an edge, in m (r̄)"
    )
    target_radius_m: float = Field(
        0.2, gt=0.0, le=2.0, description="the intermediate target counts as reached within this distance, in m (ē)"
    )
    tangent_probability: float = Field(
        0.3, gt=0.0, lt=1.0, description="probability of leaving the wall along a tangent (p, strictly between 0 and 1)"
    )
    choice: Literal["coin", "frontier"] = Field(
        "frontier",
        description="at a tangent: coin is the paper's fixed p; frontier prefers the way to unseen ground",
    )
    least_probability: float = Field(
        0.1, gt=0.0, lt=0.5, description="frontier keeps every outcome's probability at or above this (p_min)"
    )
    height_gain_per_s: float = Field(1.0, gt=0.0, le=5.0, description="gain of the height law (6), in 1/s (g)")
    closing_gain_per_s: float = Field(0.35, gt=0.0, le=5.0, description="slope of the saturation (9), in 1/s (l)")
    closing_saturation_m: float = Field(1.0, gt=0.0, le=10.0, description="range of the saturation (9), in m (k)")
    law: Literal["paper", "smooth"] = Field(
        "smooth", description="paper: sgn as printed in (7); smooth: a saturation in its place (boundary layer)"
    )
    boundary_layer_mps: float = Field(
        0.12, gt=0.0, le=5.0, description="smooth law in R3: full yaw rate from this sliding variable on, in m/s (ε)"
    )
    boundary_layer_rad: float = Field(
        0.4, gt=0.0, le=3.0, description="smooth law in R2: full yaw rate from this bearing of the target on, in rad"
    )
    speed_law: Literal["paper", "governor"] = Field(
        "governor", description="paper: (12) alone; governor: (12), lowered to what can be braked and turned"
    )
    governor: GovernorSettings = Field(GovernorSettings(), description="the speed governor")
    climb_feed_forward: bool = Field(True, description="add the climb rate of the ground ahead to (6)")
    pause_s: float = Field(
        4.0, ge=0.0, le=120.0, description="after a declined tangent, look for none during this time, in s"
    )
    target_timeout_factor: float = Field(
        2.5, ge=1.0, le=20.0, description="give a target up after this many times the straight flight's duration"
    )
    allow_turning_radius_above_margin: bool = Field(
        False, description="accept d_s <= v/u_M, which breaks Assumption 2.2 of the paper (Table I does)"
    )

    @property
    def turning_radius_m(self) -> float:
        """Radius of the initial circles, v/u_M (paper Definition 3.2)."""
        return self.speed_mps / self.max_yaw_rate_radps

    @model_validator(mode="after")
    def _margins_in_order(self) -> Self:
        if self.critical_margin_m >= self.margin_m:
            raise refuse(
                f"control.critical_margin_m = {self.critical_margin_m:g} m (d_c) must be smaller than "
                f"control.margin_m = {self.margin_m:g} m (d_s)",
                "control.critical_margin_m",
                "control.margin_m",
            )
        return self

    @model_validator(mode="after")
    def _closing_speed_below_speed(self) -> Self:
        closing_mps = self.closing_gain_per_s * self.closing_saturation_m
        if closing_mps >= self.speed_mps:
            raise refuse(
                f"control.closing_gain_per_s · control.closing_saturation_m = {closing_mps:g} m/s (l·k) must be "
                f"smaller than control.speed_mps = {self.speed_mps:g} m/s (v): X is a commanded closing speed",
                "control.closing_gain_per_s",
                "control.closing_saturation_m",
                "control.speed_mps",
            )
        return self

    @model_validator(mode="after")
    def _assumption_2_2(self) -> Self:
        if self.turning_radius_m >= self.margin_m and not self.allow_turning_radius_above_margin:
            raise refuse(
                f"control.margin_m = {self.margin_m:g} m (d_s) must be greater than control.speed_mps / "
                f"control.max_yaw_rate_radps = {self.speed_mps:g} / {self.max_yaw_rate_radps:g} = "
                f"{self.turning_radius_m:.3g} m (v_M/u_M), Assumption 2.2 of the paper: fly slower, turn faster, "
                "or set control.allow_turning_radius_above_margin: true",
                "control.margin_m",
                "control.speed_mps",
                "control.max_yaw_rate_radps",
            )
        return self
