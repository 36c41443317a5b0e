"""Finds the faults there are at a moment. Pure."""

from __future__ import annotations

import math

from companion.gate.faults import Fault
from companion.gate.geofence import excess_m
from companion.gate.obedience import Obedience
from companion.gate.plan import Plan
from companion.gate.protocol import Beat, Phase
from companion.gate.setpoint_limits import VelocitySetpoint
from companion.gate.vehicle import Vehicle

EVENT_S = 0.1
"""What happens in a moment counts as there for this long."""
CLOSING_MPS = 0.1
"""Slower than this nothing closes: an estimate of the speed is no better."""
FUTURE_S = 0.05
"""A beat from further ahead is none: all processes of a computer have one clock."""
AHEAD = "ahead"
WHERE = (AHEAD, "on the left", "behind", "on the right")
"""The sides of `companion.sides.Sides`."""
STEERED = (Phase.CLIMBING, Phase.EXPLORING)


class FaultMonitor:
    """Everything that may be late or wrong.

    Args:
        plan: thresholds.
        vehicle: what the autopilot says.

    Attributes:
        beat: the newest; None before the first.
        asked: the newest setpoint that could be read; None before the first of this application.
        died: whether the application's process did.
        stop_ordered: whether a person on the ground ordered a stop.
        obedience: of the vehicle to what goes out on the wire.
        bad_s: when a setpoint was last refused.
        flooded_s: when the application last sent more than it may.
    """

    def __init__(self, plan: Plan, vehicle: Vehicle) -> None:
        self.beat: Beat | None = None
        self.asked: VelocitySetpoint | None = None
        self.died = False
        self.stop_ordered = False
        self.bad_s = -math.inf
        self.flooded_s = -math.inf
        self.obedience = Obedience(plan.thresholds.not_obeyed_mps)
        self._plan = plan
        self._vehicle = vehicle
        self._explores_since_s = math.inf

    @property
    def phase(self) -> Phase:
        """What the application is doing, by its newest beat."""
        return Phase.GROUND if self.beat is None else self.beat.phase

    def reset(self) -> None:
        """A new application."""
        self.beat = self.asked = None
        self.died = self.stop_ordered = False
        self.bad_s = self.flooded_s = -math.inf
        self.obedience.reset()
        self._explores_since_s = math.inf

    def on_position(self, now_s: float) -> None:
        """The vehicle knows a newer position and velocity."""
        flown = self._vehicle.motion.forward_right_mps()
        if flown is not None and self._vehicle.steered:
            self.obedience.on_velocity(*flown, now_s)

    def on_beat(self, beat: Beat, now_s: float) -> bool:
        """A beat came; whether it can be one."""
        if beat.t_s > now_s + FUTURE_S or (self.beat is not None and beat.t_s < self.beat.t_s):
            return False
        self.beat = beat
        if beat.phase is not Phase.EXPLORING:
            self._explores_since_s = math.inf
        elif math.isinf(self._explores_since_s):
            self._explores_since_s = now_s
        return True

    def beat_age_s(self, now_s: float) -> float:
        """Since the newest completed tick began; infinite before the first."""
        return math.inf if self.beat is None else max(0.0, now_s - self.beat.t_s)

    def faults(self, now_s: float) -> dict[Fault, str]:
        """Every fault with a few words, empty when all is well. Only for a vehicle that the application has armed."""
        found = self._of_the_application(now_s) | self._of_the_autopilot(now_s)
        if self.phase is Phase.EXPLORING:
            found |= self._of_the_inputs(now_s)
        return found

    def _of_the_application(self, now_s: float) -> dict[Fault, str]:
        found: dict[Fault, str] = {}
        if self.died:
            found[Fault.APPLICATION] = "died"
        if self.stop_ordered:
            found[Fault.GROUND_STOP] = ""
        if now_s - self.bad_s < EVENT_S:
            found[Fault.SETPOINT_BAD] = ""
        if now_s - self.flooded_s < EVENT_S:
            found[Fault.FLOOD] = ""
        beat_s = self.beat_age_s(now_s)
        if self.phase is not Phase.ENDED and beat_s > self._plan.thresholds.beat_s:
            found[Fault.BEAT_LATE] = _seconds(beat_s)
        return found

    def _of_the_autopilot(self, now_s: float) -> dict[Fault, str]:
        vehicle, limit = self._vehicle, self._plan.thresholds
        found: dict[Fault, str] = {}
        silent_s, heartbeat_s = now_s - vehicle.heard_s, now_s - vehicle.heartbeat_s
        if silent_s > limit.link_s:
            found[Fault.LINK_LOST] = _seconds(silent_s)
        if heartbeat_s > limit.heartbeat_s:
            found[Fault.HEARTBEAT_LOST] = _seconds(heartbeat_s)
        if vehicle.estimator_good is False:
            found[Fault.ESTIMATOR] = ""
        if (too_little := vehicle.battery.too_little(now_s)) is not None:
            found[Fault.BATTERY] = too_little
        if (wrong := self.obedience.wrong(now_s)) is not None and vehicle.steered:
            found[Fault.NOT_OBEYED] = wrong
        pose_s = now_s - vehicle.motion.fresh_s
        if self.phase in STEERED and pose_s > limit.pose_s:
            found[Fault.POSE_STALE] = _seconds(pose_s)
        if now_s - vehicle.motion.jumped_s < EVENT_S:
            found[Fault.POSE_JUMP] = ""
        if vehicle.motion.frozen_for_s() > limit.pose_frozen_s:
            found[Fault.POSE_FROZEN] = ""
        place = vehicle.motion.place_m
        outside_m = -math.inf if place is None else excess_m(self._plan.fence, *place)
        if outside_m > 0.0:
            found[Fault.FENCE] = f"{outside_m:.1f} m outside"
        return found | self._of_the_aiding(now_s)

    def _of_the_aiding(self, now_s: float) -> dict[Fault, str]:
        """What still tells the autopilot where it is; what never came in this flight is not missed."""
        aiding, limit = self._vehicle.aiding, self._plan.thresholds
        found: dict[Fault, str] = {}
        odometry_s = self._vehicle.odometry.fresh_s
        stands_s = aiding.figures_stand_for_s()
        if stands_s > limit.aiding_s:
            found[Fault.AIDING_LOST] = f"for {stands_s:.1f} s"
        if self._plan.gps and math.isfinite(aiding.gps_s) and now_s - aiding.gps_s > limit.gps_s:
            found[Fault.GPS_LOST] = f"{_seconds(now_s - aiding.gps_s)}, fix {aiding.gps_fix}"
        if math.isfinite(odometry_s) and now_s - odometry_s > limit.odometry_s:
            found[Fault.ODOMETRY_SILENT] = _seconds(now_s - odometry_s)
        return found

    def _of_the_inputs(self, now_s: float) -> dict[Fault, str]:
        """What an exploring vehicle needs besides."""
        beat, limit = self.beat, self._plan.thresholds
        assert beat is not None  # noqa: S101 - there is no phase without a beat
        since_s = self.beat_age_s(now_s)
        found: dict[Fault, str] = {}
        for fault, age_s, limit_s in (
            (Fault.DEPTH_STALE, beat.depth_age_s + since_s, limit.depth_s),
            (Fault.RANGES_STALE, beat.ranges_age_s + since_s, limit.ranges_s),
            (Fault.POSE_STALE, beat.pose_age_s + since_s, limit.pose_s),
            (Fault.MAP, beat.map_age_s + since_s, limit.map_s),
        ):
            if age_s > limit_s:
                found[fault] = _seconds(age_s)
        asked_s = self._explores_since_s if self.asked is None else max(self.asked.t_s, self._explores_since_s)
        offboard = self._vehicle.personality.offboard in self._vehicle.asked_modes
        if offboard and now_s - asked_s > limit.setpoint_s:
            found[Fault.SETPOINT_LATE] = _seconds(now_s - asked_s)
        if (too_near := self._too_near(beat, now_s, since_s)) is not None:
            found[Fault.DISTANCE] = too_near
        return found

    def _too_near(self, beat: Beat, now_s: float, since_s: float) -> str | None:
        """What comes nearer on any side and would be nearer than the hard limit after a stop; None: nothing."""
        ahead_m = min(beat.sides.front.distance_m, math.inf if math.isnan(beat.ahead_m) else beat.ahead_m)
        distances_m = (ahead_m, *(side.distance_m for side in beat.sides[1:]))
        for where, distance_m, side, speed_mps in zip(
            WHERE, distances_m, beat.sides, self._towards_mps(now_s), strict=True
        ):
            # What the sensors see come nearer does so, whatever the autopilot says of its speed.
            closing_mps = max(speed_mps, side.closing_mps)
            stop_m = self._plan.stopping.distance_m(max(0.0, closing_mps), since_s + 2.0 * self._plan.period_s)
            if where != AHEAD:
                # There the law makes room from d_c on, and does it sooner when it is not stopped.
                stop_m -= self._plan.stopping.creep_m
            if closing_mps > CLOSING_MPS and distance_m - stop_m < self._plan.thresholds.hard_limit_m:
                return f"{distance_m:.2f} m {where}"
        return None

    def _towards_mps(self, now_s: float) -> tuple[float, float, float, float]:
        """To each side, flown or asked for, whichever is more; what is asked for beyond the limit does not pass.

        What was asked for by an application that has fallen silent is asked for no more: the vehicle was stopped.
        """
        flown = self._vehicle.motion.forward_right_mps()
        asked, most_mps = self.asked, self._plan.limits.speed_mps
        lasts = asked is not None and (flown is None or now_s - asked.t_s <= self._plan.thresholds.setpoint_s)
        forward_mps, right_mps = (0.0, 0.0) if flown is None else flown
        if asked is None or not lasts:
            return forward_mps, -right_mps, -forward_mps, right_mps
        vx_mps, vy_mps = (max(-most_mps, min(most_mps, one)) for one in (asked.vx_mps, asked.vy_mps))
        return (
            max(forward_mps, vx_mps),
            max(-right_mps, -vy_mps),
            max(-forward_mps, -vx_mps),
            max(right_mps, vy_mps),
        )


def _seconds(age_s: float) -> str:
    return "never" if math.isinf(age_s) else f"{age_s:.2f} s"
