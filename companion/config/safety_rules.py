"""The rules that tie the safety gate to what it guards."""

from __future__ import annotations

from itertools import combinations

from companion.config.autopilot import AutopilotSettings
from companion.config.control import ControlSettings
from companion.config.mission import MissionSettings
from companion.config.safety import SafetySettings
from companion.config.section import refuse
from companion.config.sensors import SensorSettings
from companion.config.vehicle import VehicleSettings
from companion.mavlink.link_url import parse_link

LEAST_PERIODS = 1.5
"""A threshold below this many periods calls a healthy stream late whenever its jitter adds up."""
LEAST_REPEATS = 3.0
"""Fewer equal positions than this say nothing: a value may well be sent twice."""


def hard_limit_m(safety: SafetySettings, vehicle: VehicleSettings, control: ControlSettings) -> float:
    """The hard limit, or what stands for one that is left out."""
    if safety.distance.hard_limit_m is not None:
        return safety.distance.hard_limit_m
    return (vehicle.body_radius_m + control.critical_margin_m) / 2.0


def check_limits(safety: SafetySettings, control: ControlSettings) -> None:
    """Refuse limits that the law itself would break."""
    for name, own, unit in (
        ("speed_mps", "speed_mps", "m/s"),
        ("climb_mps", "max_climb_mps", "m/s"),
        ("yaw_rate_radps", "max_yaw_rate_radps", "rad/s"),
        ("accel_mps2", "max_accel_mps2", "m/s²"),
    ):
        limit: float | None = getattr(safety.limits, name)
        asked: float = getattr(control, own)
        if limit is not None and limit < asked:
            raise refuse(
                f"safety.limits.{name} = {limit:g} {unit} must not be below control.{own} = {asked:g} {unit}: the gate "
                "would stop what the law asks for",
                f"safety.limits.{name}",
                f"control.{own}",
            )


def check_distance(safety: SafetySettings, vehicle: VehicleSettings, control: ControlSettings) -> None:
    """Refuse a hard limit that touches, or that the law reaches by itself."""
    limit_m = hard_limit_m(safety, vehicle, control)
    key = "safety.distance.hard_limit_m"
    if limit_m <= vehicle.body_radius_m:
        raise refuse(
            f"{key} = {limit_m:g} m must be greater than vehicle.body_radius_m = {vehicle.body_radius_m:g} m: it would "
            "act only after touching the wall",
            key,
            "vehicle.body_radius_m",
        )
    if limit_m >= control.critical_margin_m:
        raise refuse(
            f"{key} = {limit_m:g} m must be smaller than control.critical_margin_m = {control.critical_margin_m:g} m "
            "(d_c): the gate would stop the vehicle where the law turns it",
            key,
            "control.critical_margin_m",
        )


def check_ages(
    safety: SafetySettings, control: ControlSettings, sensors: SensorSettings, autopilot: AutopilotSettings
) -> None:
    """Refuse thresholds that healthy streams break."""
    tick = ("control.period_s", control.period_s, control.period_s)
    camera = ("sensors.camera.rate_hz", sensors.camera.rate_hz, 1.0 / sensors.camera.rate_hz)
    beams = ("sensors.beams.rate_hz", sensors.beams.rate_hz, 1.0 / sensors.beams.rate_hz)
    position = ("autopilot.position_hz", autopilot.position_hz, 1.0 / autopilot.position_hz)
    for key, threshold_s, (source, value, period_s), periods in (
        ("safety.stale.setpoint_s", safety.setpoint_late_s(control), tick, LEAST_PERIODS),
        ("safety.stale.beat_s", safety.beat_late_s(control), tick, LEAST_PERIODS),
        ("safety.stale.depth_s", safety.stale.depth_s, camera, LEAST_PERIODS),
        ("safety.stale.ranges_s", safety.stale.ranges_s, beams, LEAST_PERIODS),
        ("safety.stale.pose_s", safety.stale.pose_s, position, LEAST_PERIODS),
        ("safety.stale.link_s", safety.stale.link_s, position, LEAST_PERIODS),
        ("safety.pose.frozen_s", safety.pose.frozen_s, position, LEAST_REPEATS),
    ):
        least_s = periods * period_s
        if threshold_s < least_s - 1e-9:
            raise refuse(
                f"{key} = {threshold_s:g} s must be at least {least_s:.3g} s with {source} = {value:g}: what comes as "
                "it should would be a fault",
                key,
                source,
            )
    beat_s = safety.beat_late_s(control)
    if safety.stale.hang_s <= beat_s:
        raise refuse(
            f"safety.stale.hang_s = {safety.stale.hang_s:g} s must be greater than safety.stale.beat_s = {beat_s:g} s: "
            "the application is not killed before it is late",
            "safety.stale.hang_s",
            "safety.stale.beat_s",
        )


def check_battery(safety: SafetySettings, mission: MissionSettings) -> None:
    """Refuse a gate that lands before the application has ended its flight."""
    if safety.battery_percent > 0.0 and safety.battery_percent >= mission.battery_low_percent:
        raise refuse(
            f"safety.battery_percent = {safety.battery_percent:g} must be smaller than mission.battery_low_percent = "
            f"{mission.battery_low_percent:g}: the application ends the flight first; 0 does not watch the battery",
            "safety.battery_percent",
            "mission.battery_low_percent",
        )
    ours_v, gate_v = mission.battery_low_v, safety.battery_v
    if ours_v is not None and gate_v is not None and gate_v >= ours_v:
        raise refuse(
            f"safety.battery_v = {gate_v:g} V must be smaller than mission.battery_low_v = {ours_v:g} V: the "
            "application ends the flight first; null does not watch the voltage",
            "safety.battery_v",
            "mission.battery_low_v",
        )


def check_fence(safety: SafetySettings, control: ControlSettings) -> None:
    """Refuse a height band without the height of the flight."""
    band_m = safety.fence.height_m
    if band_m is not None and band_m[1] <= control.height_m:
        raise refuse(
            f"safety.fence.height_m = [{band_m[0]:g}, {band_m[1]:g}] must reach above control.height_m = "
            f"{control.height_m:g} m (H): the climb would end outside of the fence",
            "safety.fence.height_m",
            "control.height_m",
        )


def check_attached(safety: SafetySettings, autopilot: AutopilotSettings) -> None:
    """Refuse two partners at one place."""
    places = [("autopilot.url", autopilot.url)]
    places += [(f"safety.attached.{index}.url", one.url) for index, one in enumerate(safety.attached)]
    for (key, url), (other_key, other) in combinations(places, 2):
        if parse_link(url).place == parse_link(other).place:
            raise refuse(
                f"{other_key} = {other} is the same place as {key} = {url}: each needs its own, the gate gives every "
                "partner the messages that it may have",
                other_key,
                key,
            )
