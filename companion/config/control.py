"""Settings of the navigation law: the law's own parameters, and the rules that tie them together."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from companion.config.section import Section, refuse
from companion.control.parameters import Governor, Parameters


class GovernorSettings(Section, Governor):
    """Bounds the speed by what can be braked and turned: it only ever lowers what law (12) gives."""


class ControlSettings(Section, Parameters):
    """The navigation law. The symbol of the paper stands at the end of each description."""

    governor: GovernorSettings = Field(GovernorSettings(), description="the speed governor")
    allow_turning_radius_above_margin: bool = Field(
        False,
        description="with speed_law: paper, accept d_s <= v/u_M, which breaks Assumption 2.2 of the paper (Table I "
        "does); the governor keeps it by v(t), whatever v_c is",
    )

    @property
    def turning_radius_m(self) -> float:
        """Radius of the initial circles, v/u_M (paper Definition 3.2)."""
        return self.speed_mps / self.max_yaw_rate_radps

    @model_validator(mode="after")
    def _law_can_be_flown(self) -> Self:
        if self.critical_margin_m >= self.margin_m:
            raise refuse(
                f"control.critical_margin_m = {self.critical_margin_m:g} m (d_c) must be smaller than "
                f"control.margin_m = {self.margin_m:g} m (d_s)",
                "control.critical_margin_m",
                "control.margin_m",
            )
        closing_mps = self.closing_gain_per_s * self.closing_saturation_m
        if closing_mps >= self.speed_mps:
            raise refuse(
                f"control.closing_gain_per_s · control.closing_saturation_m = {closing_mps:g} m/s (l·k) must be "
                f"smaller than control.speed_mps = {self.speed_mps:g} m/s (v): X is a commanded closing speed",
                "control.closing_gain_per_s",
                "control.closing_saturation_m",
                "control.speed_mps",
            )
        # The governor lowers v(t) to what can be turned in the room that is there: so it keeps the assumption itself.
        turns_anyhow = self.speed_law == "governor" or self.allow_turning_radius_above_margin
        if self.turning_radius_m >= self.margin_m and not turns_anyhow:
            raise refuse(
                f"control.margin_m = {self.margin_m:g} m (d_s) must be greater than control.speed_mps / "
                f"control.max_yaw_rate_radps = {self.speed_mps:g} / {self.max_yaw_rate_radps:g} = "
                f"{self.turning_radius_m:.3g} m (v_M/u_M), Assumption 2.2 of the paper: fly slower, turn faster, "
                "let the speed be governed (control.speed_law: governor), or set "
                "control.allow_turning_radius_above_margin: true",
                "control.margin_m",
                "control.speed_mps",
                "control.max_yaw_rate_radps",
            )
        return self
