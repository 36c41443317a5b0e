"""The check of the battery: what is left, and that its end will be noticed."""

from __future__ import annotations

from companion.autopilot.interface import Link, LinkError
from companion.autopilot.vehicle_state import VehicleState
from companion.config.mission import MissionSettings
from companion.flight.preflight.result import CheckResult
from companion.mavlink.firmware import AutopilotKind

LOW_VOLTAGE = "BATT_LOW_VOLT"
LEAST_SHARE = 0.7
"""A cell is full at 4.2 V and has to be on the ground at about 3.5 V: a threshold below this share of the present
voltage is meant for a battery with fewer cells."""


async def battery(link: Link, state: VehicleState, mission: MissionSettings) -> CheckResult:
    """Whether there is enough for a flight, and a measure that will tell when there no longer is. Never raises."""
    problems = [*_now(state, mission)]
    wanted = f"more than {mission.battery_low_percent:g} %, and not low by the autopilot's own judgement"
    reason = "At mission.battery_low_percent the flight ends."
    if mission.battery_low_v is not None:
        wanted += f", above {mission.battery_low_v:g} V"
    if link.kind is AutopilotKind.ARDUPILOT:
        problems += await _threshold(link, state, mission)
        wanted += f"; {LOW_VOLTAGE} or mission.battery_low_v that fits it"
        reason = (
            "ArduPilot's percent is a coulomb count that begins at 100 % at each boot, whatever the battery has left: "
            "100 % means nothing, only a voltage tells."
        )
    return CheckResult("battery", not problems, _found(state), wanted, reason, "; ".join(problems))


def _found(state: VehicleState) -> str:
    percent = "percent not known" if state.battery_percent is None else f"{state.battery_percent:.0f} %"
    voltage = "voltage not known" if state.voltage_v is None else f"{state.voltage_v:.1f} V"
    charge = "charge not judged" if state.charge_state is None else f"charge {state.charge_state.name.lower()}"
    return f"{percent}, {voltage}, {charge}"


def _now(state: VehicleState, mission: MissionSettings) -> list[str]:
    """What is to be done about what it has left."""
    low_v = mission.battery_low_v
    empty = (
        (state.battery_percent is not None and state.battery_percent <= mission.battery_low_percent)
        or (state.charge_state is not None and state.charge_state.is_low)
        or (low_v is not None and state.voltage_v is not None and state.voltage_v <= low_v)
    )
    unknown = state.battery_percent is None or (low_v is not None and state.voltage_v is None)
    return [*(["charge it"] if empty else ()), *(["let the autopilot measure it"] if unknown else ())]


async def _threshold(link: Link, state: VehicleState, mission: MissionSettings) -> list[str]:
    """What is to be done about the voltage at which the flight ends."""
    try:
        found = await link.get_param(LOW_VOLTAGE)
    except LinkError as error:
        return [f"{LOW_VOLTAGE} is not known: {error}"]
    least_v = LEAST_SHARE * (state.voltage_v or 0.0)
    if max(mission.battery_low_v or 0.0, found or 0.0) > least_v:
        return []
    given = ", ".join(f"{name} {value:g} V" for name, value in _given(mission.battery_low_v, found))
    too_low = f"{given} is for a battery with fewer cells than this one; " if given else ""
    return [f"{too_low}set {LOW_VOLTAGE} or mission.battery_low_v to about 3.5 V a cell"]


def _given(ours_v: float | None, autopilots_v: float | None) -> list[tuple[str, float]]:
    named = (("mission.battery_low_v", ours_v), (LOW_VOLTAGE, autopilots_v))
    return [(name, value) for name, value in named if value]
