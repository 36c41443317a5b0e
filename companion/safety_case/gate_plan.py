"""What the configuration means for the safety gate: its plan, and whether a wall can be reached."""

from __future__ import annotations

from typing import Any

from companion.autopilot.message_rates import ESTIMATOR_HZ
from companion.config.settings import Settings
from companion.errors import InputError
from companion.gate.faults import Stage
from companion.gate.plan import Attached, Geofence, Plan, Reaction, Signing, Stopping, Thresholds
from companion.safety_case.stopping_budget import Basis, BudgetLine, Law, stopping_budget

_STAGES = {"tell": Stage.PASS, "brake": Stage.BRAKE, "hold": Stage.HOLD, "land": Stage.LAND}


def to_plan(
    settings: Settings, *, command: tuple[str, ...], restart_command: tuple[str, ...], inherit: tuple[int, ...] = ()
) -> Plan:
    """The plan of the gate.

    Args:
        settings: effective settings.
        command: how the application is started.
        restart_command: how it is started again after it died, so that nothing flies by itself.
        inherit: file descriptors that it inherits.
    """
    safety, control = settings.safety, settings.control
    fence, key_file = safety.fence, safety.signing.key_file
    return Plan(
        autopilot_url=settings.autopilot.url,
        system_id=settings.autopilot.system_id,
        gps=settings.autopilot.gps,
        period_s=control.period_s,
        silence_s=settings.autopilot.silence_s,
        limits=safety.effective_limits(control),
        fence=Geofence(
            north_m=fence.north_m,
            east_m=fence.east_m,
            # Heights count upward, the autopilot's frame downward.
            down_m=None if fence.height_m is None else (-fence.height_m[1], -fence.height_m[0]),
            radius_m=fence.radius_m,
        ),
        thresholds=Thresholds(
            setpoint_s=safety.setpoint_late_s(control),
            beat_s=safety.beat_late_s(control),
            depth_s=safety.stale.depth_s,
            ranges_s=safety.stale.ranges_s,
            pose_s=safety.stale.pose_s,
            pose_jump_m=safety.pose.jump_m,
            pose_frozen_s=safety.pose.frozen_s,
            heartbeat_s=safety.stale.heartbeat_s,
            link_s=safety.stale.link_s,
            map_s=safety.stale.map_s,
            hang_s=safety.stale.hang_s,
            aiding_s=safety.stale.aiding_s,
            gps_s=safety.stale.gps_s,
            odometry_s=safety.stale.odometry_s,
            not_obeyed_mps=safety.not_obeyed_mps,
            hard_limit_m=settings.hard_limit_m,
            battery_percent=safety.battery_percent,
            battery_v=safety.battery_v,
            messages_hz=safety.messages_hz,
        ),
        reactions={
            fault: Reaction(_STAGES[reaction.first], reaction.hold_after_s, reaction.land_after_s)
            for fault, reaction in safety.reactions.by_fault().items()
        },
        recover_s=safety.recover_s,
        stopping=Stopping(safety.autopilot_delay_s, control.governor.brake_mps2, safety.creep_m),
        attached=tuple(Attached(one.url, one.may) for one in safety.attached),
        signing=None if key_file is None else Signing(key_file, safety.signing.link_id),
        command=command,
        restart_command=restart_command,
        restarts=safety.restarts,
        inherit=inherit,
        realtime=safety.realtime,
    )


def stopping_lines(settings: Settings) -> tuple[BudgetLine, ...]:
    """The stopping budget of a configuration, one line for each fault."""
    return stopping_budget(to_plan(settings, command=(), restart_command=()), to_basis(settings))


def to_basis(settings: Settings) -> Basis:
    """What the stopping budget rests on besides the plan."""
    control = settings.control
    return Basis(
        law=Law(
            governed=control.speed_law == "governor",
            critical_margin_m=control.critical_margin_m,
            reaction_s=control.governor.reaction_s,
            creep_mps=control.governor.least_speed_mps,
        ),
        body_radius_m=settings.vehicle.body_radius_m,
        hold_creep_m=settings.safety.hold_creep_m,
        pose_period_s=1.0 / settings.autopilot.position_hz,
        estimator_period_s=1.0 / ESTIMATOR_HZ,
    )


def refuse_if_reachable(settings: Settings) -> None:
    """Refuse a configuration in which a fault can end in a wall.

    Raises:
        InputError: each such fault with its distances and settings, and what to change.
    """
    reaching = [line for line in stopping_lines(settings) if line.reaches_wall]
    if not reaching:
        return
    control, speed_mps = settings.control, settings.safety.effective_limits(settings.control).speed_mps
    values = settings.model_dump()
    said = ["a wall can be reached:", *(_said(line, settings.vehicle.body_radius_m, values) for line in reaching)]
    said.append(
        f"Fly slower (control.speed_mps = {control.speed_mps:g} m/s; the gate lets {speed_mps:g} m/s pass, "
        f"safety.limits.speed_mps), keep further away (control.critical_margin_m = {control.critical_margin_m:g} m), "
        "or notice it sooner (the settings named with each). `companion safety budget` shows the whole table."
    )
    if control.speed_law == "paper":
        said.append("With control.speed_law: paper it flies at full speed until d_c; governor slows it before.")
    raise InputError("\n".join(said))


def _said(line: BudgetLine, body_radius_m: float, values: dict[str, Any]) -> str:
    because = ", ".join(f"{key} = {_value(values, key)}" for key in line.keys)
    return (
        f"- {line.fault}: at {line.speed_mps:.3g} m/s it goes on for {line.distance_m:.2f} m, begun "
        f"{line.allowed_m:.2f} m from a wall with vehicle.body_radius_m = {body_radius_m:g} m: "
        f"{-line.remaining_m:.2f} m short" + (f" ({because})" if because else "")
    )


def _value(values: dict[str, Any], key: str) -> str:
    found: Any = values
    for part in key.split("."):
        found = found[part]
    return "null" if found is None else f"{found:g}"
