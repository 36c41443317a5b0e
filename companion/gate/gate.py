"""The gate: what passes, what is stopped, and what is done when something is late or wrong. Pure.

Messages and the time go in, messages come out. Upwards everything passes, which needs no code here: the gate only
listens. Downwards passes what is permitted; a setpoint that breaks a limit is replaced by a stop.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from companion.gate import allowlist
from companion.gate.escalation import Escalation
from companion.gate.failsafe_actions import FailsafeActions
from companion.gate.fault_monitor import EVENT_S, FaultMonitor
from companion.gate.faults import Fault, Stage
from companion.gate.geofence import excess_m
from companion.gate.outgoing import Outgoing
from companion.gate.plan import Plan
from companion.gate.protocol import Goodbye, Notice, Phase, unpacked
from companion.gate.setpoint_limits import Unreadable, VelocitySetpoint, beyond, read
from companion.gate.vehicle import READ, Vehicle
from companion.mavlink.codec import NAMES, Frame, decode
from companion.mavlink.ids import MavCmd, MavComponent, MavResult

ORDERS = frozenset({"COMMAND_LONG", "COMMAND_INT"})
ARMING_BEAT_S = 0.5
"""An application that has not completed a tick for this long arms nothing."""
TOLD_AGAIN_S = 1.0
"""A pilot reads no faster."""
BURST_S = 0.5
"""Messages of this time may come at once."""
STAGE_S = 0.125
"""The application is told the stage again this often: a notice of it may have been lost."""
NOT_LISTED = "not on the list"
STOPPABLE = frozenset({MavComponent.ALL, MavComponent.AUTOPILOT1, MavComponent.ONBOARD_COMPUTER2})
"""Whom a person may have meant with a stop. For the application the same order is a pause, after which the flight can
go on; one that is too ill to obey completes no ticks, and is stopped for that."""

Fields = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Verdict:
    """The gate's answer to one message of the application.

    Attributes:
        raw: what goes to the autopilot: the message, or a stop in its place; None: nothing does.
        refused: why nothing does, as it is counted; empty when something does.
    """

    raw: bytes | None
    refused: str = ""


class Gate:
    """One gate; see the package.

    Args:
        plan: everything it is told.
        now_s: the time of its start, in s of CLOCK_MONOTONIC, as every other time here.

    Attributes:
        goodbye: the application's last word; None while it has not said it.
        counts: what did not pass, by reason; the reasons are a fixed set.
    """

    def __init__(self, plan: Plan, now_s: float) -> None:
        self.goodbye: Goodbye | None = None
        self.counts: Counter[str] = Counter()
        self._plan = plan
        self._vehicle = Vehicle(plan.thresholds)
        self._monitor = FaultMonitor(plan, self._vehicle)
        self._escalation = Escalation(plan.reactions, plan.recover_s)
        self._outgoing = Outgoing(plan.system_id)
        self._failsafe = FailsafeActions(plan, self._vehicle, self._monitor, self._escalation, self._outgoing)
        self._answers: list[bytes] = []
        self._upward: list[bytes] = []
        self._tokens = plan.thresholds.messages_hz * BURST_S
        self._tokens_s = now_s
        self._was_airborne = False
        self._told_taken_over = False
        self._told_stage = Stage.PASS
        self._noticed_s = -math.inf

    @property
    def stage(self) -> Stage:
        """What is being done."""
        return self._escalation.stage

    @property
    def airborne(self) -> bool:
        """Whether the vehicle is armed, by the application, and nobody else has taken it."""
        return self._vehicle.airborne and self._vehicle.taken_over is None

    @property
    def armed(self) -> bool:
        """By the autopilot's newest word."""
        return self._vehicle.armed

    @property
    def carries_odometry(self) -> bool:
        """Whether the autopilot flies by odometry that passes through the gate: without the gate it would have none."""
        return self._vehicle.armed and math.isfinite(self._vehicle.odometry.fresh_s)

    def on_application_started(self) -> None:
        """A new process of the application."""
        self.goodbye = None
        self._monitor.reset()
        self._vehicle.reset()
        self._escalation.reset()

    def on_application_died(self, why: str) -> None:
        """Its process ended without a last word."""
        self._monitor.died = True
        self._outgoing.note(f"the application {why}", Fault.APPLICATION)

    def hangs(self, now_s: float) -> bool:
        """Whether the application has to be killed: it should tick, and has not for long."""
        phase = self._monitor.phase
        at_work = Phase.GROUND < phase < Phase.ENDED and not self._monitor.died
        return at_work and self._monitor.beat_age_s(now_s) > self._plan.thresholds.hang_s

    def drain_notices(self, now_s: float) -> list[Notice]:
        """What there is to tell since the last call, for the log and the application; the stage at least now and then.

        A notice without a text only says the stage again.
        """
        notices = [Notice(self.stage, fault, words) for fault, words in self._outgoing.drain_notices()]
        if not notices and now_s - self._noticed_s >= STAGE_S:
            notices = [Notice(self.stage, self._escalation.because)]
        if notices:
            self._noticed_s = now_s
        return notices

    def drain_upward(self) -> list[bytes]:
        """The gate's own messages for the application since the last call: answers to commands that it refused."""
        taken, self._upward = self._upward, []
        return taken

    def on_word(self, data: bytes, now_s: float) -> None:
        """One datagram of the application's own socket."""
        said = unpacked(data)
        if isinstance(said, Goodbye):
            self.goodbye = said
        elif said is None or not self._monitor.on_beat(said, now_s):
            self.counts["beat that cannot be"] += 1

    def on_autopilot_message(self, frame: Frame, now_s: float) -> None:
        """One message that came over the autopilot's link; it passes on to the application, whatever it is."""
        ours = frame.system_id == self._plan.system_id
        if ours and frame.component_id in (MavComponent.ONBOARD_COMPUTER, MavComponent.ONBOARD_COMPUTER2):
            return  # our own, sent back
        name = NAMES.get(frame.message_id)
        own = ours and frame.component_id == MavComponent.AUTOPILOT1
        # Nearly everything that comes only passes through: it is not worth to be read.
        fields = decode(frame) if (name in READ if own else name in ORDERS) else None
        if own:
            self._vehicle.on_message(name if fields is not None else None, fields or {}, now_s)
            if name == "LOCAL_POSITION_NED" and self._vehicle.motion.fresh_s == now_s:
                self._monitor.on_position(now_s)
        elif fields is not None:
            self._on_foreign_command(fields, frame)

    def on_attached_message(self, frame: Frame, may: str, now_s: float) -> bool:
        """One message of somebody attached: whether it passes to the autopilot."""
        name, fields = NAMES.get(frame.message_id), decode(frame)
        feeds = may == "odometry" and name in allowlist.ODOMETRY
        commands = may == "command" and name not in allowlist.SETPOINTS
        if not feeds and not commands:
            self.counts["attached: not permitted"] += 1
            return False
        if fields is None:
            return True
        if feeds and name in allowlist.PLACES:
            self._vehicle.odometry.on_place(str(name), fields, now_s)
        if feeds and name in allowlist.TRACKED and self.airborne and not self._vehicle.odometry.believed:
            # An autopilot that is told nothing brakes and lands; one that is told this runs away.
            self.counts["attached: odometry that repeats itself or leaps"] += 1
            return False
        # A pause ends here: ArduCopter would freeze in guided and fly on with the next word.
        if name in ORDERS and self._on_foreign_command(fields, frame):
            return False
        return fields.get("target_component") not in (MavComponent.ONBOARD_COMPUTER, MavComponent.ONBOARD_COMPUTER2)

    def on_application_message(self, frame: Frame, now_s: float) -> Verdict:
        """Judge one message of the application."""
        verdict = self._judge(frame, now_s)
        if verdict.refused:
            self.counts[f"application: {verdict.refused}"] += 1
        return verdict

    def cycle(self, now_s: float) -> list[bytes]:
        """What the gate itself has to say now, to the autopilot and everybody attached."""
        self._notice_flight_end()
        if self.airborne:
            found = self._monitor.faults(now_s)
            # What an application that has ended its flight no longer tells is not over: the landing stays due.
            ended = self._monitor.phase is Phase.ENDED and self.stage >= Stage.HOLD
            lasting = self._escalation.counting if ended else frozenset()
            for fault in sorted(self._escalation.update(frozenset(found) | lasting, now_s)):
                self._outgoing.say(f"{fault} {found[fault]}".strip(), fault)
        elif self._vehicle.taken_over is not None and self._vehicle.airborne and not self._told_taken_over:
            self._told_taken_over = True
            who = "autopilot's failsafe" if self._vehicle.by_failsafe else "mode"
            self._outgoing.say(f"hands off: {who} {self._vehicle.taken_over}", urgent=True)
        answers, self._answers = self._answers, []
        if self.airborne:
            answers += self._failsafe.due(now_s)
        if self.stage is not self._told_stage:
            self._told_stage = self.stage
            because = self._escalation.because
            # Down and disarmed, or in other hands, nothing "is well" again: it is over.
            if self.airborne or self.stage is not Stage.PASS:
                why = because or ("all is well" if self.stage is Stage.PASS else "ordered")
                self._outgoing.say(f"{self.stage.name.lower()}: {why}", because, urgent=True)
        return answers + self._outgoing.due(self.stage, self.airborne, now_s)

    def _notice_flight_end(self) -> None:
        airborne = self._vehicle.airborne
        if self._was_airborne and not airborne:
            self._vehicle.end_flight()
            self._escalation.reset()
            self._failsafe.reset()
            self._monitor.obedience.reset()
            self._told_taken_over = False
        self._was_airborne = airborne

    def _judge(self, frame: Frame, now_s: float) -> Verdict:
        if not self._has_token(now_s):
            self._monitor.flooded_s = now_s
            return Verdict(None, "flood")
        name, fields = NAMES.get(frame.message_id), decode(frame)
        if fields is None or (frame.system_id, frame.component_id) != (
            self._plan.system_id,
            MavComponent.ONBOARD_COMPUTER,
        ):
            return Verdict(None, NOT_LISTED)
        if name == allowlist.SETPOINT:
            return self._setpoint(frame, fields, now_s)
        if name == "PARAM_SET":
            standing = self._vehicle.kind is not None and not self._vehicle.armed
            return Verdict(frame.raw) if standing else Verdict(None, "parameter in flight")
        if name == "COMMAND_LONG":
            return self._command(frame, fields, now_s)
        asks = name == "COMMAND_INT" and fields["command"] in allowlist.ASKING
        listed = asks or name in allowlist.ALWAYS or (name == allowlist.FILES and allowlist.only_reads(frame.payload))
        return Verdict(frame.raw) if listed else Verdict(None, NOT_LISTED)

    def _setpoint(self, frame: Frame, fields: Fields, now_s: float) -> Verdict:
        asked = read(fields, self._plan.system_id, now_s)
        why = asked.why if isinstance(asked, Unreadable) else self._why_not(asked)
        if isinstance(asked, VelocitySetpoint):
            self._monitor.asked = asked
        if self._vehicle.taken_over is not None or self._failsafe.link_silent(now_s):
            return Verdict(None, "setpoint, but hands are off")
        if why is not None:
            if now_s - self._monitor.bad_s > TOLD_AGAIN_S:
                self._outgoing.say(f"setpoint rejected: {why}", Fault.SETPOINT_BAD)
            self._monitor.bad_s = now_s
            self.counts["application: setpoint that broke a limit"] += 1
        if self.stage >= Stage.BRAKE:
            return Verdict(None, "setpoint while the gate stops")
        # The one after it is no better for being alike; the stage that stops them all comes with the next cycle.
        if now_s - self._monitor.bad_s < EVENT_S or not isinstance(asked, VelocitySetpoint):
            return Verdict(self._outgoing.velocity(0.0, 0.0, 0.0, now_s))
        self._monitor.obedience.on_setpoint(asked.vx_mps, asked.vy_mps, now_s)
        return Verdict(frame.raw)

    def _why_not(self, asked: VelocitySetpoint) -> str | None:
        """What speaks against a setpoint that can be read; None: nothing."""
        reason = beyond(asked, self._monitor.asked, self._plan.limits, self._plan.period_s)
        if reason is not None or asked.stands_still:
            return reason
        beat, phase = self._monitor.beat, self._monitor.phase
        if phase is Phase.ENDING and asked.only_sinks:
            # Where the autopilot's own landing would fly away, the application lands by setpoints.
            return None
        if phase not in (Phase.CLIMBING, Phase.EXPLORING):
            return f"in phase {phase.name.lower()}"
        if asked.speed_mps > 0.0 and (phase is Phase.CLIMBING or beat is None or math.isnan(beat.ahead_m)):
            return "path not observed"
        return self._leaves_the_fence(asked)

    def _leaves_the_fence(self, asked: VelocitySetpoint) -> str | None:
        motion, stopping = self._vehicle.motion, self._plan.stopping
        if motion.place_m is None:
            return None
        ahead_s = stopping.delay_s + self._plan.period_s + asked.speed_mps / (2.0 * stopping.brake_mps2)
        there = motion.after(asked.vx_mps * ahead_s, asked.vy_mps * ahead_s, asked.vz_mps * ahead_s)
        beyond_m = -math.inf if there is None else excess_m(self._plan.fence, *there)
        return "leaves the geofence" if beyond_m > max(0.0, excess_m(self._plan.fence, *motion.place_m)) else None

    def _command(self, frame: Frame, fields: Fields, now_s: float) -> Verdict:
        command = int(fields["command"])
        if fields["target_system"] != self._plan.system_id or fields["target_component"] not in (
            0,
            MavComponent.AUTOPILOT1,
        ):
            return Verdict(None, "command for another")
        if command in allowlist.ASKING:
            return Verdict(frame.raw)
        if command not in allowlist.MOVING or not self._may_move(command, fields, now_s):
            self._outgoing.note(f"command {command} refused")
            self._upward.append(
                self._outgoing.acknowledge(
                    command, MavResult.TEMPORARILY_REJECTED, self._plan.system_id, MavComponent.ONBOARD_COMPUTER
                )
            )
            return Verdict(None, "command refused")
        if self._vehicle.lands_elsewhere(now_s) and self._lands(command, fields):
            self._escalation.force(Stage.LAND)
            self._outgoing.note("the autopilot's own landing would fly away: landing by setpoints")
            return Verdict(None, "landing that would fly away")
        self._vehicle.on_command_sent(command, fields, MavComponent.ONBOARD_COMPUTER)
        return Verdict(frame.raw)

    def _may_move(self, command: int, fields: Fields, now_s: float) -> bool:
        """Whether a command that moves may pass now: to end a flight always, unless somebody else has the vehicle."""
        ours = self._vehicle.personality
        # After a silence the autopilot may have acted by itself, or a pilot: nobody is overruled unseen.
        if self._vehicle.taken_over is not None or (self._vehicle.airborne and self._failsafe.link_silent(now_s)):
            return False
        if command == MavCmd.COMPONENT_ARM_DISARM:
            arms = fields["param1"] == 1.0
            return not allowlist.is_forced(fields) and (not arms or self._may_begin(now_s))
        if command == MavCmd.NAV_TAKEOFF:
            return self._may_begin(now_s)
        if command == MavCmd.NAV_LAND:
            return True
        mode = allowlist.mode_asked_for(ours.kind, fields)
        if mode == ours.offboard:
            return self.stage is Stage.PASS and (not self._vehicle.armed or self._has_it(now_s))
        return mode == ours.land or (mode == ours.hold and self.stage < Stage.LAND)

    def _lands(self, command: int, fields: Fields) -> bool:
        ours = self._vehicle.personality
        if command == MavCmd.NAV_LAND:
            return True
        return command == MavCmd.DO_SET_MODE and allowlist.mode_asked_for(ours.kind, fields) == ours.land

    def _has_it(self, now_s: float) -> bool:
        """Whether an armed vehicle is the application's, or may become it now: by its own mission, from nobody else."""
        return self._vehicle.airborne or (self._vehicle.hands_over and self._may_begin(now_s))

    def _may_begin(self, now_s: float) -> bool:
        """Whether a flight may: who ordered a stop before it has not taken that back."""
        ticks = self._monitor.beat_age_s(now_s) <= ARMING_BEAT_S
        return self.stage is Stage.PASS and ticks and not self._monitor.stop_ordered

    def _on_foreign_command(self, fields: Fields, frame: Frame) -> bool:
        """A command of somebody else: whether it is the stop that a person at a ground station orders.

        A pause for the autopilot is one too: who presses the button of a ground station means the vehicle.
        """
        if fields["command"] != MavCmd.DO_PAUSE_CONTINUE or fields["param1"] != 0.0:
            return False
        if fields["target_system"] not in (0, self._plan.system_id) or fields["target_component"] not in STOPPABLE:
            return False
        if not (self._monitor.stop_ordered or self.airborne):
            self._outgoing.say("stop ordered: nothing takes off", Fault.GROUND_STOP)
        self._monitor.stop_ordered = True
        self._answers.append(
            self._outgoing.acknowledge(
                MavCmd.DO_PAUSE_CONTINUE, MavResult.ACCEPTED, frame.system_id, frame.component_id
            )
        )
        return True

    def _has_token(self, now_s: float) -> bool:
        most = self._plan.thresholds.messages_hz * BURST_S
        self._tokens = min(most, self._tokens + (now_s - self._tokens_s) * self._plan.thresholds.messages_hz)
        self._tokens_s = now_s
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True
