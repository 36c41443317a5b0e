"""The stopping budget: for every fault, how far the vehicle still goes, and whether a wall is nearer than that. Pure.

The distance is v·(detection + reaction + autopilot) + v²/(2·brake) + creep. It is held against the distance to a wall
straight ahead at which the law still allows the speed v; a fault strikes at the last moment before the law would have
slowed.

One fault at a time: while one input fails, the others are as fresh as they should be. The exception are faults of the
application. One process fetches the poses and sends the setpoints, so what delays one delays the other: there the pose
is counted as old as the gate lets it be.

A vehicle that does not obey (`Fault.NOT_OBEYED`) has no line: nothing that is asked of it bounds what it does.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import NamedTuple

from companion.gate.faults import Fault, Stage
from companion.gate.plan import CYCLE_S, Plan

SILENCE_EXTRA_S = 0.12
"""PX4 acted 0.03 to 0.12 s after its COM_OF_LOSS_T; ArduCopter no later than that after its GUID_TIMEOUT."""
MODE_BRAKE_MPS2 = 0.38
"""How they stop in a mode of their own, whether it was ordered or is their failsafe: PX4's hold from 0.4 m/s stood
after 0.27 m and went on to 0.48 m; 0.67 s of silence and it had gone 0.70 m from 0.39. With `Basis.hold_creep_m` both
hold up to 2 m/s (`python -m validation.real.braking`)."""

DRIFT_MPS = 0.17
"""How fast the place drifts that nothing measures any more: ArduCopter was measured to drift at 0.1 to 0.17 m/s."""

LAW_FLIES = frozenset({Fault.HEARTBEAT_LOST, Fault.FENCE, Fault.BATTERY, Fault.GROUND_STOP, Fault.MAP, Fault.FLOOD})
"""Faults that leave the law all that it needs: until they are noticed it keeps its distance by itself, so that only the
stop counts. A flood is one of them because what is too much is dropped."""


class Noticed(NamedTuple):
    """How soon a fault is noticed.

    Attributes:
        after_s: from the last moment at which the law knew where the wall is.
        keys: the settings that decide it.
        drifts_s: how long it drifts until then, while the law goes on by what it sees.
    """

    after_s: float
    keys: tuple[str, ...] = ()
    drifts_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Law:
    """Down to which distance the law allows a speed, straight at a wall.

    Attributes:
        governed: whether the speed governor lowers the speed before a wall.
        critical_margin_m: d_c.
        reaction_s: of the governor; its deceleration is that of the plan.
        creep_mps: the governor allows this much down to d_c.
    """

    governed: bool
    critical_margin_m: float
    reaction_s: float
    creep_mps: float

    def allows_down_to_m(self, speed_mps: float, brake_mps2: float) -> float:
        """D(v): no nearer than this to a wall is the speed allowed.

        The governor gives v while d_c + reaction·v + v²/(2·brake) is free ahead. Law (12) of the paper knows nothing
        between d_s and d_c: it gives v_c until d_f < d_c, and then 0.
        """
        if not self.governed or speed_mps <= self.creep_mps:
            return self.critical_margin_m
        return self.critical_margin_m + self.reaction_s * speed_mps + speed_mps**2 / (2.0 * brake_mps2)


@dataclass(frozen=True, slots=True)
class Basis:
    """What the budget rests on besides the gate's plan.

    Attributes:
        law: which speed it allows where.
        body_radius_m: of the vehicle.
        hold_creep_m: how far the autopilot wanders in a mode of its own, after it has braked.
        pose_period_s: between two positions of the autopilot.
        estimator_period_s: between two of its words about its estimator.
    """

    law: Law
    body_radius_m: float
    hold_creep_m: float
    pose_period_s: float
    estimator_period_s: float

    @property
    def pose_fresh_s(self) -> float:
        """Age of a pose when all is well: one period waiting for the next, and as much on the way."""
        return 2.0 * self.pose_period_s


@dataclass(frozen=True, slots=True)
class Case:
    """A fault, before a speed is chosen.

    Attributes:
        fault: its name; faults that end the gate itself are no `Fault`.
        keys: the settings that decide how soon it is noticed.
        detection_s: until it is noticed, from the last moment at which the law knew where the wall is.
        reaction_s: until the first stop is on the wire.
        autopilot_s: until the vehicle begins to brake.
        brake_mps2: its deceleration.
        creep_m: how far it goes on after it has braked until its place is kept.
        stops: whether it is answered by stopping; else the pilot is told, and nothing else here counts.
    """

    fault: str
    keys: tuple[str, ...]
    detection_s: float
    reaction_s: float
    autopilot_s: float
    brake_mps2: float
    creep_m: float
    stops: bool

    @property
    def delay_s(self) -> float:
        """Until the vehicle begins to brake, all together."""
        return self.detection_s + self.reaction_s + self.autopilot_s

    @property
    def at_hard_limit(self) -> bool:
        """Whether the gate's own limit takes the law's place."""
        return self.fault == Fault.DISTANCE


@dataclass(frozen=True, slots=True)
class BudgetLine(Case):
    """A fault at a speed.

    Attributes:
        speed_mps: the worst speed up to the limit.
        allowed_m: distance to the wall when the fault strikes, from the middle of the body.
        distance_m: how far the vehicle goes until it stands.
        remaining_m: what is left then between body and wall.
    """

    speed_mps: float
    allowed_m: float
    distance_m: float
    remaining_m: float

    @property
    def reaches_wall(self) -> bool:
        """Whether this fault can end in a wall."""
        return self.stops and self.remaining_m <= 0.0


def stopping_budget(plan: Plan, basis: Basis) -> tuple[BudgetLine, ...]:
    """A line for each fault that can be bounded, and for the three ways to lose the gate, each at its worst speed."""
    return tuple(
        min((_line(case, speed_mps, plan, basis) for speed_mps in _speeds(case, plan, basis)), key=_remaining)
        for case in _cases(plan, basis)
    )


def _remaining(line: BudgetLine) -> float:
    return line.remaining_m


def _speeds(case: Case, plan: Plan, basis: Basis) -> Iterator[float]:
    """Every speed that can be the worst.

    With a governor, d_c - r + v·(R - T) - v²/2·(1/a - 1/b) remains: T and a are delay and deceleration of this stop, R
    and b the governor's. No stop counts on braking harder than b, so the parabola opens downward and is least at an
    end: the largest speed, or the slowest that is governed; there the allowed distance jumps, and the creep just
    below it is worse. Without a governor (and at the hard limit, where the gate's own stop is the governor) all gets
    worse with v, or less is lost than at standstill, where d_c and the hard limit leave room by the configuration.
    """
    yield plan.limits.speed_mps
    if basis.law.governed and not case.at_hard_limit:
        yield min(basis.law.creep_mps, plan.limits.speed_mps)


def _line(case: Case, speed_mps: float, plan: Plan, basis: Basis) -> BudgetLine:
    distance_m = speed_mps * case.delay_s + speed_mps**2 / (2.0 * case.brake_mps2) + case.creep_m
    if case.at_hard_limit:
        allowed_m = _hard_limit_m(plan, speed_mps)
    else:
        allowed_m = basis.law.allows_down_to_m(speed_mps, plan.stopping.brake_mps2)
    return BudgetLine(
        **asdict(case),
        speed_mps=speed_mps,
        allowed_m=allowed_m,
        distance_m=distance_m,
        remaining_m=allowed_m - distance_m - basis.body_radius_m,
    )


def _hard_limit_m(plan: Plan, speed_mps: float) -> float:
    """Where the gate stops a vehicle whose law does not: the way of a stop, and of two periods, before the limit.

    How long ago the application measured the distance, the gate adds itself.
    """
    return plan.thresholds.hard_limit_m + plan.stopping.distance_m(speed_mps, 2.0 * plan.period_s)


def _cases(plan: Plan, basis: Basis) -> Iterator[Case]:
    limit, stale = plan.thresholds, "safety.stale."
    # The gate looks every cycle. One more period because a single stop may be lost on the way.
    reaction_s = CYCLE_S + plan.period_s
    # A vehicle that brakes worse than the autopilots were measured to does so in their failsafe too.
    stop = plan.stopping
    mode_mps2, mode_creep_m = min(MODE_BRAKE_MPS2, stop.brake_mps2), max(basis.hold_creep_m, stop.creep_m)
    noticed = {
        Fault.SETPOINT_LATE: Noticed(limit.setpoint_s + limit.pose_s, (stale + "setpoint_s", stale + "pose_s")),
        # Never sent on; what went before it is a period old at most.
        Fault.SETPOINT_BAD: Noticed(plan.period_s + limit.pose_s, (stale + "pose_s",)),
        Fault.BEAT_LATE: Noticed(limit.beat_s + limit.pose_s, (stale + "beat_s", stale + "pose_s")),
        # Counts from the exposure: nothing is granted for walls that were in view before.
        Fault.DEPTH_STALE: Noticed(limit.depth_s, (stale + "depth_s",)),
        Fault.RANGES_STALE: Noticed(limit.ranges_s, (stale + "ranges_s",)),
        Fault.POSE_STALE: Noticed(limit.pose_s, (stale + "pose_s",)),
        Fault.POSE_JUMP: Noticed(basis.pose_fresh_s, ("autopilot.position_hz",)),
        Fault.POSE_FROZEN: Noticed(limit.pose_frozen_s + basis.pose_fresh_s, ("safety.pose.frozen_s",)),
        Fault.ESTIMATOR: Noticed(basis.estimator_period_s + basis.pose_fresh_s, ("autopilot.position_hz",)),
        # What is straight ahead is in view, and measured from the body: only what the place drifts is lost.
        Fault.AIDING_LOST: Noticed(0.0, (stale + "aiding_s",), limit.aiding_s + basis.estimator_period_s),
        Fault.GPS_LOST: Noticed(0.0, (stale + "gps_s",), limit.gps_s),
        Fault.ODOMETRY_SILENT: Noticed(0.0, (stale + "odometry_s",), limit.odometry_s),
        Fault.LINK_LOST: Noticed(limit.link_s, (stale + "link_s",)),
        Fault.DISTANCE: Noticed(basis.pose_fresh_s, ("safety.distance.hard_limit_m",)),
        # The end of a process is noticed in the next cycle; one that hangs is BEAT_LATE.
        Fault.APPLICATION: Noticed(plan.period_s + limit.pose_s, (stale + "pose_s",)),
    } | dict.fromkeys(LAW_FLIES, Noticed(0.0))
    for fault in (fault for fault in Fault if fault is not Fault.NOT_OBEYED):
        reaction, found = plan.reactions[fault], noticed[fault]
        first = reaction.first
        # Where the gate brakes it keeps the place; a mode of the autopilot that comes later takes another.
        ends_in_mode = first >= Stage.HOLD or reaction.hold_after_s is not None or reaction.land_after_s is not None
        yield Case(
            fault=fault.value,
            keys=found.keys,
            detection_s=found.after_s,
            reaction_s=reaction_s,
            autopilot_s=stop.delay_s,
            # To hold and to land the autopilot brakes in its own way.
            brake_mps2=mode_mps2 if first >= Stage.HOLD else stop.brake_mps2,
            creep_m=(mode_creep_m if ends_in_mode else stop.creep_m) + DRIFT_MPS * found.drifts_s,
            stops=first is not Stage.PASS,
        )
    for name in ("gate killed", "computer dead", "link cut"):
        yield Case(
            fault=name,
            keys=("autopilot.silence_s",),
            detection_s=plan.silence_s + SILENCE_EXTRA_S + basis.pose_fresh_s,
            reaction_s=0.0,
            autopilot_s=0.0,
            brake_mps2=mode_mps2,
            creep_m=mode_creep_m,
            stops=True,
        )
