"""What the gate does at each stage: streams zero velocity, asks for hold, asks for land. Pure."""

from __future__ import annotations

import math

from companion.gate.escalation import Escalation
from companion.gate.fault_monitor import FaultMonitor
from companion.gate.faults import Fault, Stage
from companion.gate.outgoing import Outgoing
from companion.gate.plan import Plan
from companion.gate.protocol import Phase
from companion.gate.vehicle import Vehicle
from companion.mavlink.ids import MavCmd, MavComponent
from companion.sides import away_mps
from companion.station_keeping import PATIENCE_S, STANDS_MPS, StationKeeper

ASK_AGAIN_S = 0.5
"""A command may be lost; to ask for a mode twice does no harm."""
HOLD_PATIENCE_S = 2.5
"""A hold that does not show for this long is not to be had: PX4 has none without a global origin. It lands then."""
LAND_MPS = 0.3
"""Downward, where the gate lands by setpoints: slow enough to touch down with."""

AWAY_MPS = 0.5
"""How fast it moves away from a wall that has come too near, at most: a vehicle with a bad GPS was carried sideways at
0.4 m/s while it believed to stand."""

PLACELESS = frozenset(
    {
        Fault.POSE_JUMP, Fault.POSE_FROZEN, Fault.ESTIMATOR, Fault.AIDING_LOST, Fault.GPS_LOST, Fault.ODOMETRY_SILENT,
        Fault.NOT_OBEYED,
    }
)  # fmt: skip
"""While one of these counts the position is not believed: to go back to a place by it would be to fly by it. Whether it
is fresh the gate sees for itself: `Fault.POSE_STALE` is also what an application has that hangs."""
UNSTOPPABLE = frozenset({Fault.POSE_FROZEN, Fault.ESTIMATOR, Fault.NOT_OBEYED})
"""While one of these counts zero velocity means nothing: nobody waits for it to work."""


class FailsafeActions:
    """Carries out the stage of the escalation.

    Args:
        plan: periods and thresholds.
        vehicle: which mode it is in.
        monitor: whether it was ever steered.
        escalation: whose stage; raised when a hold cannot be had.
        outgoing: makes the messages.
    """

    def __init__(
        self, plan: Plan, vehicle: Vehicle, monitor: FaultMonitor, escalation: Escalation, outgoing: Outgoing
    ) -> None:
        self._plan = plan
        self._vehicle = vehicle
        self._monitor = monitor
        self._escalation = escalation
        self._outgoing = outgoing
        self._silent_s: float | None = None
        self._station = StationKeeper()
        self.reset()

    def reset(self) -> None:
        """The flight is over."""
        self._stop_s = self._ask_s = -math.inf
        self._hold_since_s: float | None = None
        self._stopping_since_s: float | None = None
        self._station.release()

    def link_silent(self, now_s: float) -> bool:
        """Whether nothing has come from the autopilot for so long that it may not have heard us either.

        Its own failsafe acts then, and PX4 goes back to offboard on the first setpoint that comes after. So nothing is
        sent until a heartbeat has told what it made of the silence.
        """
        if now_s - self._vehicle.heard_s > self._plan.silence_s:
            self._silent_s = now_s
        if self._silent_s is not None and self._vehicle.heartbeat_s > self._silent_s:
            self._silent_s = None
        return self._silent_s is not None

    def due(self, now_s: float) -> list[bytes]:
        """What is to be sent now."""
        if self.link_silent(now_s):
            return []
        stage = self._escalation.stage
        if stage is Stage.PASS:
            self._station.release()
            self._stopping_since_s = None
            return []
        if self._stopping_since_s is None:
            self._stopping_since_s = now_s
        if stage is Stage.BRAKE:
            return self._stop(now_s)
        if stage is Stage.LAND and self._vehicle.lands_elsewhere(now_s):
            return self._descend(now_s)
        return self._take_mode(stage, now_s)

    def _stop(self, now_s: float, down_mps: float | None = None) -> list[bytes]:
        """Stand, once a period. A vehicle that was never steered by setpoints is not stopped by them.

        PX4's own take-off ignores them and ArduPilot's would be suppressed; each goes straight up and ends by itself,
        and hold comes with its own delay. To go down they are needed in any case: PX4 takes the mode only with them.

        Args:
            now_s: the time.
            down_mps: what to ask for downward; None: it keeps its height.
        """
        if (self._monitor.asked is None and down_mps is None) or now_s - self._stop_s < self._plan.period_s:
            return []
        self._stop_s = now_s
        forward_mps, right_mps, kept_mps = self._back_to_the_place(now_s)
        away_forward_mps, away_right_mps = self._away_from_the_walls(now_s)
        if away_forward_mps or away_right_mps:
            # By its own position it may stand, and the wall comes nearer all the same: what is seen is true.
            self._station.release()
            forward_mps, right_mps = away_forward_mps, away_right_mps
        self._monitor.obedience.on_setpoint(forward_mps, right_mps, now_s)
        down_mps = kept_mps if down_mps is None else down_mps
        return [self._outgoing.velocity(forward_mps, right_mps, down_mps, now_s)]

    def _away_from_the_walls(self, now_s: float) -> tuple[float, float]:
        """Forward and right: away from what is seen nearer than the hard limit and what is crept; zero when nothing."""
        beat, limit = self._monitor.beat, self._plan.thresholds
        # Near the ground, before and after, what is seen ahead is the ground.
        if beat is None or beat.phase is not Phase.EXPLORING or self._monitor.beat_age_s(now_s) > limit.beat_s:
            return 0.0, 0.0
        keep_m = limit.hard_limit_m + self._plan.stopping.creep_m
        forward_mps, left_mps = away_mps(beat.sides, keep_m, min(AWAY_MPS, self._plan.limits.speed_mps))
        looked_s = beat.depth_age_s + self._monitor.beat_age_s(now_s)
        if forward_mps > 0.0 and not (beat.ahead_m > keep_m and looked_s <= limit.depth_s):
            # Nobody looks ahead: nothing near is seen there, and nothing is known to be free.
            forward_mps = 0.0
        return forward_mps, -left_mps

    def _back_to_the_place(self, now_s: float) -> tuple[float, float, float]:
        """Forward, right, down: what keeps it where it came to stand; zero where nobody knows where that is."""
        motion = self._vehicle.motion
        if now_s - motion.fresh_s > self._plan.thresholds.pose_s or self._escalation.counting & PLACELESS:
            self._station.release()
            return 0.0, 0.0, 0.0
        place_m, velocity_mps, yaw_rad = motion.place_m, motion.velocity_mps, motion.yaw_rad
        if place_m is None or velocity_mps is None or yaw_rad is None:
            return 0.0, 0.0, 0.0
        return self._station.velocity(place_m, velocity_mps, yaw_rad, now_s)

    def _descend(self, now_s: float) -> list[bytes]:
        """Land by setpoints, where the autopilot's own landing would fly away; it disarms when it is down."""
        sent = self._stop(now_s, LAND_MPS)
        ours = self._vehicle.personality
        return sent if self._vehicle.confirms(ours.offboard) else sent + self._ask(ours.offboard, now_s)

    def _take_mode(self, stage: Stage, now_s: float) -> list[bytes]:
        """Ask for the mode until it shows; stop by setpoints until then.

        To a hold they bring it to stand first: ArduCopter's BRAKE goes twice as far as zero velocity does.
        """
        ours = self._vehicle.personality
        if self._vehicle.confirms(ours.land) or (stage is Stage.HOLD and self._vehicle.confirms(ours.hold)):
            return []
        sent = self._stop(now_s)
        if stage is Stage.HOLD and self._stops_by_setpoints(now_s):
            return sent
        wanted = ours.hold if stage is Stage.HOLD and self._vehicle.asked_modes != {ours.land} else ours.land
        if stage is Stage.HOLD:
            self._hold_since_s = now_s if self._hold_since_s is None else self._hold_since_s
            if now_s - self._hold_since_s > HOLD_PATIENCE_S:
                self._escalation.force(Stage.LAND)
        return sent + self._ask(wanted, now_s)

    def _stops_by_setpoints(self, now_s: float) -> bool:
        """Whether it still moves, and setpoints are stopping it."""
        stopping_s = now_s - (self._stopping_since_s or now_s)
        flown = self._vehicle.motion.forward_right_mps()
        if not self._vehicle.steered or flown is None or stopping_s > PATIENCE_S:
            return False
        doubtful = bool(self._escalation.counting & UNSTOPPABLE)
        fresh = now_s - self._vehicle.motion.fresh_s <= self._plan.thresholds.pose_s
        return fresh and not doubtful and math.hypot(*flown) > STANDS_MPS

    def _ask(self, mode: int, now_s: float) -> list[bytes]:
        """For a mode, now and then."""
        if now_s - self._ask_s < ASK_AGAIN_S:
            return []
        self._ask_s = now_s
        raw, fields = self._outgoing.mode(self._vehicle.personality, mode)
        self._vehicle.on_command_sent(MavCmd.DO_SET_MODE, fields, MavComponent.ONBOARD_COMPUTER2)
        return [raw]
