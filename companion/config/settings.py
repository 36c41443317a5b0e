"""The root of the configuration, and the rules that tie its sections together."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from companion.config import safety_rules
from companion.config.autopilot import AutopilotSettings
from companion.config.control import ControlSettings
from companion.config.link import LinkSettings
from companion.config.mapping import MapSettings
from companion.config.mission import MissionSettings, RecordSettings
from companion.config.safety import SafetySettings
from companion.config.section import Section, refuse
from companion.config.sensors import SensorSettings
from companion.config.sim import SimSettings
from companion.config.vehicle import FleetSettings, VehicleSettings

SPENT_PERCENT = 5.0
"""With less left a vehicle on its way home lands where it is, also where the gate watches no battery."""

BEFORE_THE_GATE_PERCENT = 1.0
"""It lands by so much earlier than the gate would have it land."""


class Settings(Section):
    """One vehicle: body, law, sensors, map, group, autopilot, flight, link, safety, recording, simulation."""

    vehicle: VehicleSettings = Field(VehicleSettings(), description="the airframe")
    control: ControlSettings = Field(ControlSettings(), description="the navigation law")
    sensors: SensorSettings = Field(SensorSettings(), description="sensors and what is made of them")
    mapping: MapSettings = Field(MapSettings(), description="the map V")
    fleet: FleetSettings = Field(FleetSettings(), description="several vehicles")
    autopilot: AutopilotSettings = Field(AutopilotSettings(), description="the flight controller and the link to it")
    mission: MissionSettings = Field(MissionSettings(), description="when a flight begins, and how it ends")
    link: LinkSettings = Field(LinkSettings(), description="the link to the ground")
    safety: SafetySettings = Field(SafetySettings(), description="the gate between this and the flight controller")
    record: RecordSettings = Field(RecordSettings(), description="the flight recording")
    sim: SimSettings = Field(SimSettings(), description="the simulated vehicle and its imperfect sensors")

    @property
    def half_slab_m(self) -> float:
        """What is this much above or below the middle of the body is in its way, in m."""
        return self.vehicle.body_height_m / 2.0 + self.sensors.scan.slab_margin_m

    @property
    def hard_limit_m(self) -> float:
        """Least distance ahead at which the vehicle must have stopped, from the middle of the body, in m."""
        return safety_rules.hard_limit_m(self.safety, self.vehicle, self.control)

    @property
    def turning_percent(self) -> float:
        """The least charge to be left at home: with less in prospect it turns back. The gate lands below its own."""
        return max(self.mission.reserve_percent, self.safety.battery_percent)

    @property
    def spent_percent(self) -> float:
        """Charge at which a vehicle on its way home lands where it is: a little before the gate has it land."""
        gate_percent = self.safety.battery_percent
        return max(SPENT_PERCENT, gate_percent + BEFORE_THE_GATE_PERCENT if gate_percent > 0.0 else 0.0)

    @model_validator(mode="after")
    def _sections_fit(self) -> Self:
        if self.vehicle.body_radius_m >= self.control.critical_margin_m:
            raise refuse(
                f"vehicle.body_radius_m = {self.vehicle.body_radius_m:g} m must be smaller than "
                f"control.critical_margin_m = {self.control.critical_margin_m:g} m (d_c): the vehicle would stop only "
                "after touching the wall",
                "vehicle.body_radius_m",
                "control.critical_margin_m",
            )
        half_m = self.half_slab_m
        if half_m >= self.control.height_m:
            raise refuse(
                f"control.height_m = {self.control.height_m:g} m (H) must be greater than half of "
                f"vehicle.body_height_m plus sensors.scan.slab_margin_m = {half_m:g} m: the ground would be in the way",
                "control.height_m",
                "vehicle.body_height_m",
                "sensors.scan.slab_margin_m",
            )
        needed_m = (self.fleet.largest_group + 1) * self.control.vertical_margin_m
        if self.fleet.tunnel_height_m < needed_m:
            raise refuse(
                f"fleet.tunnel_height_m = {self.fleet.tunnel_height_m:g} m (d_M) must be at least (fleet.largest_group "
                f"+ 1) · control.vertical_margin_m = {needed_m:g} m, or the layers of (11) are too close",
                "fleet.tunnel_height_m",
                "fleet.largest_group",
                "control.vertical_margin_m",
            )
        if self.mission.link_lost != "go_on" and not self.link.enabled:
            raise refuse(
                f"mission.link_lost = {self.mission.link_lost}, but link.enabled = false: there is no link that could "
                "be lost; set link.enabled: true, or link_lost: go_on",
                "mission.link_lost",
                "link.enabled",
            )
        if self.fleet.number is not None and not self.link.enabled:
            raise refuse(
                f"fleet.number = {self.fleet.number}, but link.enabled = false: it would neither hear other vehicles "
                "nor be heard; set link.enabled: true, with link.listen and link.connect, or fleet.number: null",
                "fleet.number",
                "link.enabled",
            )
        safety_rules.check_limits(self.safety, self.control)
        safety_rules.check_distance(self.safety, self.vehicle, self.control)
        safety_rules.check_ages(self.safety, self.control, self.sensors, self.autopilot)
        safety_rules.check_battery(self.safety, self.mission)
        safety_rules.check_fence(self.safety, self.control)
        safety_rules.check_attached(self.safety, self.autopilot)
        return self
