"""The safety case as plain text: the stopping budget, and every fault with its threshold and answer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from companion.config.settings import Settings
from companion.gate.faults import CLEARS, Clear, Fault
from companion.safety_case.stopping_budget import BudgetLine
from companion.text_table import columns, wrapped

_WATCHED: dict[Fault, tuple[str, str]] = {
    Fault.SETPOINT_LATE: ("safety.stale.setpoint_s", "s"),
    Fault.SETPOINT_BAD: ("safety.limits", ""),
    Fault.BEAT_LATE: ("safety.stale.beat_s", "s"),
    Fault.DEPTH_STALE: ("safety.stale.depth_s", "s"),
    Fault.RANGES_STALE: ("safety.stale.ranges_s", "s"),
    Fault.POSE_STALE: ("safety.stale.pose_s", "s"),
    Fault.POSE_JUMP: ("safety.pose.jump_m", "m"),
    Fault.POSE_FROZEN: ("safety.pose.frozen_s", "s"),
    Fault.ESTIMATOR: ("the autopilot's own flags", ""),
    Fault.AIDING_LOST: ("safety.stale.aiding_s", "s"),
    Fault.GPS_LOST: ("safety.stale.gps_s", "s"),
    Fault.ODOMETRY_SILENT: ("safety.stale.odometry_s", "s"),
    Fault.NOT_OBEYED: ("safety.not_obeyed_mps", "m/s"),
    Fault.HEARTBEAT_LOST: ("safety.stale.heartbeat_s", "s"),
    Fault.LINK_LOST: ("safety.stale.link_s", "s"),
    Fault.DISTANCE: ("safety.distance.hard_limit_m", "m"),
    Fault.FENCE: ("safety.fence", ""),
    Fault.BATTERY: ("safety.battery_percent", "%"),
    Fault.GROUND_STOP: ("a command", ""),
    Fault.APPLICATION: ("the end of its process", ""),
    Fault.MAP: ("safety.stale.map_s", "s"),
    Fault.FLOOD: ("safety.messages_hz", "/s"),
}
"""What is compared with what for each fault."""


def render_budget(lines: Sequence[BudgetLine], settings: Settings) -> str:
    """The stopping budget as plain text of at most `text_table.WIDTH` columns."""
    control, body_m = settings.control, settings.vehicle.body_radius_m
    speed_mps = settings.safety.effective_limits(control).speed_mps
    rows = [_budget_row(line, settings) for line in lines]
    header = (
        "fault", "speed", "detection", "reaction", "autopilot",
        "brake", "creep", "from", "distance", "stands at", "left",
    )  # fmt: skip
    units = ("", "m/s", "s", "s", "s", "m/s²", "m", "m", "m", "m", "m")
    stopping = [line for line in lines if line.stops]
    least = min(stopping, key=lambda line: line.remaining_m)
    reaching = [line.fault for line in stopping if line.reaches_wall]
    meaning = (
        "Straight at a wall, at the worst speed up to what the gate lets pass, "
        f"{speed_mps:g} m/s. From: distance to the wall when the fault strikes; stands at: when the vehicle stands; "
        "both from the middle of the body. Left: between body and wall. A vehicle that does not obey is bounded by "
        "nothing."
    )
    result = [
        f"d_s = {control.margin_m:g} m, d_c = {control.critical_margin_m:g} m, hard limit = "
        f"{settings.hard_limit_m:.3g} m, body radius = {body_m:g} m, law: {control.speed_law}",
        f"least left: {least.remaining_m:.2f} m ({least.fault})",
        f"A WALL CAN BE REACHED: {', '.join(reaching)}" if reaching else "no wall can be reached",
    ]
    table = columns([header, units, *rows])
    return "\n".join([*wrapped(meaning), "", *table, "", *(line for text in result for line in wrapped(text))])


def _budget_row(line: BudgetLine, settings: Settings) -> tuple[str, ...]:
    if not line.stops:
        return (line.fault, *["-"] * 9, "only told")
    control, stands_at_m = settings.control, line.allowed_m - line.distance_m
    within = "WALL" if line.reaches_wall else ""
    if not within and stands_at_m < control.margin_m:
        within = "< d_c" if stands_at_m < control.critical_margin_m else "< d_s"
    delays_s = line.detection_s, line.reaction_s, line.autopilot_s
    numbers = *delays_s, line.brake_mps2, line.creep_m, line.allowed_m, line.distance_m
    return (
        line.fault,
        f"{line.speed_mps:.2f}",
        *(f"{number:.2f}" for number in numbers),
        f"{stands_at_m:.2f} {within:<5}",
        f"{line.remaining_m:.2f}",
    )


def render_faults(settings: Settings) -> str:
    """Every fault with its threshold and answer as plain text."""
    reactions = settings.safety.reactions
    rows = [("fault", "from", "at once", "hold after", "land after", "over", "what")]
    for fault, reaction in reactions.by_fault().items():
        meaning = type(reactions).model_fields[fault.value].description or ""
        over = "by itself" if CLEARS[fault] is Clear.BY_ITSELF else "never"
        answer = (reaction.first, _after(reaction.hold_after_s), _after(reaction.land_after_s))
        rows.append((fault.value, _threshold(fault, settings), *answer, over, meaning.partition(";")[0]))
    note = (
        f"Over: gone for {settings.safety.recover_s:g} s; never: not in this flight. After hold or land only a person "
        "begins anew."
    )
    return "\n".join([*columns(rows, left=(0, 1, 2, 5, 6)), "", *wrapped(note)])


def _threshold(fault: Fault, settings: Settings) -> str:
    """With the value that holds, also where the file leaves it out."""
    key, unit = _WATCHED[fault]
    effective = {
        Fault.SETPOINT_LATE: settings.safety.setpoint_late_s(settings.control),
        Fault.BEAT_LATE: settings.safety.beat_late_s(settings.control),
        Fault.DISTANCE: settings.hard_limit_m,
    }
    if not unit:
        return key.removeprefix("safety.")
    found: Any = settings
    for part in key.split("."):
        found = getattr(found, part)
    return f"{effective.get(fault, found):.3g} {unit}"


def _after(delay_s: float | None) -> str:
    return "-" if delay_s is None else f"{delay_s:g} s"
