"""The gate: what passes, what is stopped, and what is done when something is late or wrong. Pure.

Messages and the time go in, messages come out. Upwards everything passes, which needs no code here: the gate only
listens. Downwards passes what is permitted; a setpoint that breaks a limit is replaced by a stop.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

from companion.gate import allowlist as permits
from companion.gate.escalation import Ladder
from companion.gate.failsafe_actions import Answer
from companion.gate.fault_monitor import EVENT_S, Watch
from companion.gate.faults import Fault, Stage
from companion.gate.geofence import excess_m
from companion.gate.outgoing import Voice
from companion.gate.plan import Plan
from companion.gate.protocol import Goodbye, Notice, Phase, unpacked
from companion.gate.setpoint_limits import Asked, beyond, read
from companion.gate.vehicle import READ, Vehicle
from companion.gate.verdict import Verdict
from companion.mavlink.codec import NAMES, Frame, decode
from companion.mavlink.ids import MavCmd, MavComponent, MavResult

ORDERS = frozenset({"COMMAND_LONG", "COMMAND_INT"})
ARMING_BEAT_S = 0.5
"""An application that has not completed a tick for this long arms nothing."""
TOLD_AGAIN_S = 1.0
"""A pilot reads no faster."""
BURST_S = 0.5
"""Messages of this time may come at once."""
STAGE_S = 0.1
"""The application is told the stage again this often: a notice of it may have been lost."""
NOT_LISTED = "not on the list"

Fields = Mapping[str, Any]


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
        self._vehicle = Vehicle(plan.thresholds.pose_jump_m)
        self._watch = Watch(plan, self._vehicle)
        self._ladder = Ladder(plan.reactions, plan.recover_s)
        self._voice = Voice(plan.system_id)
        self._answer = Answer(plan, self._vehicle, self._watch, self._ladder, self._voice)
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
        return self._ladder.stage

    @property
    def airborne(self) -> bool:
        """Whether the vehicle is armed, by the application, and nobody else has taken it."""
        return self._vehicle.airborne and self._vehicle.taken_over is None

    @property
    def armed(self) -> bool:
        """By the autopilot's newest word."""
        return self._vehicle.armed

    def application_started(self) -> None:
        """A new process of the application."""
        self.goodbye = None
        self._watch.begin()
        self._vehicle.begin()
        self._ladder.reset()

    def application_died(self, why: str) -> None:
        """Its process ended without a last word."""
        self._watch.died = True
        self._voice.note(f"the application {why}", Fault.APPLICATION)

    def hangs(self, now_s: float) -> bool:
        """Whether the application has to be killed: it should tick, and has not for long."""
        phase = self._watch.phase
        at_work = Phase.GROUND < phase < Phase.ENDED and not self._watch.died
        return at_work and self._watch.beat_age_s(now_s) > self._plan.thresholds.hang_s

    def take_notices(self, now_s: float) -> list[Notice]:
        """What there is to tell since the last call, for the log and the application; the stage at least now and then.

        A notice without a text only says the stage again.
        """
        notices = [Notice(self.stage, fault, words) for fault, words in self._voice.take_notices()]
        if not notices and now_s - self._noticed_s >= STAGE_S:
            notices = [Notice(self.stage, self._ladder.because)]
        if notices:
            self._noticed_s = now_s
        return notices

    def take_upward(self) -> list[bytes]:
        """The gate's own messages for the application since the last call: answers to commands that it refused."""
        taken, self._upward = self._upward, []
        return taken

    def beat(self, data: bytes, now_s: float) -> None:
        """One datagram of the application's own socket."""
        said = unpacked(data)
        if isinstance(said, Goodbye):
            self.goodbye = said
        elif said is None or not self._watch.take(said, now_s):
            self.counts["beat that cannot be"] += 1

    def autopilot_spoke(self, frame: Frame, now_s: float) -> None:
        """One message that came over the autopilot's link; it passes on to the application, whatever it is."""
        ours = frame.system_id == self._plan.system_id
        if ours and frame.component_id in (MavComponent.ONBOARD_COMPUTER, MavComponent.ONBOARD_COMPUTER2):
            return  # our own, sent back
        name = NAMES.get(frame.message_id)
        own = ours and frame.component_id == MavComponent.AUTOPILOT1
        # Nearly everything that comes only passes through: it is not worth to be read.
        fields = decode(frame) if (name in READ if own else name in ORDERS) else None
        if own:
            self._vehicle.spoke(name if fields is not None else None, fields or {}, now_s)
        elif fields is not None:
            self._ordered(fields, frame)

    def ground_spoke(self, frame: Frame, may: str) -> bool:
        """One message of somebody attached: whether it passes to the autopilot."""
        name, fields = NAMES.get(frame.message_id), decode(frame)
        feeds = may == "odometry" and name in permits.ODOMETRY
        commands = may == "command" and name not in permits.SETPOINTS
        if not feeds and not commands:
            self.counts["attached: not permitted"] += 1
            return False
        if fields is None:
            return True
        if name in ORDERS:
            self._ordered(fields, frame)
        return fields.get("target_component") not in (MavComponent.ONBOARD_COMPUTER, MavComponent.ONBOARD_COMPUTER2)

    def application_spoke(self, frame: Frame, now_s: float) -> Verdict:
        """Judge one message of the application."""
        verdict = self._judge(frame, now_s)
        if verdict.refused:
            self.counts[f"application: {verdict.refused}"] += 1
        return verdict

    def cycle(self, now_s: float) -> list[bytes]:
        """What the gate itself has to say now, to the autopilot and everybody attached."""
        self._note_the_end_of_a_flight()
        if self.airborne:
            found = self._watch.faults(now_s)
            # What an application that has ended its flight no longer tells is not over: the landing stays due.
            ended = self._watch.phase is Phase.ENDED and self.stage >= Stage.HOLD
            lasting = self._ladder.counting if ended else frozenset()
            for fault in sorted(self._ladder.update(frozenset(found) | lasting, now_s)):
                self._voice.say(f"{fault} {found[fault]}".strip(), fault)
        elif self._vehicle.taken_over is not None and self._vehicle.airborne and not self._told_taken_over:
            self._told_taken_over = True
            self._voice.say(f"hands off, mode {self._vehicle.taken_over}")
        answers, self._answers = self._answers, []
        if self.airborne:
            answers += self._answer.due(now_s)
        if self.stage is not self._told_stage:
            self._told_stage = self.stage
            because = self._ladder.because
            self._voice.say(f"{self.stage.name.lower()}: {because or 'all is well'}", because)
        return answers + self._voice.due(self.stage, self.airborne, now_s)

    def _note_the_end_of_a_flight(self) -> None:
        airborne = self._vehicle.airborne
        if self._was_airborne and not airborne:
            self._vehicle.land_here()
            self._ladder.reset()
            self._answer.reset()
            self._told_taken_over = False
        self._was_airborne = airborne

    def _judge(self, frame: Frame, now_s: float) -> Verdict:
        if not self._has_token(now_s):
            self._watch.flooded_s = now_s
            return Verdict.refusal("flood")
        name, fields = NAMES.get(frame.message_id), decode(frame)
        if fields is None or (frame.system_id, frame.component_id) != (
            self._plan.system_id,
            MavComponent.ONBOARD_COMPUTER,
        ):
            return Verdict.refusal(NOT_LISTED)
        if name == permits.SETPOINT:
            return self._setpoint(frame, fields, now_s)
        if name == "PARAM_SET":
            standing = self._vehicle.kind is not None and not self._vehicle.armed
            return Verdict.passed(frame.raw) if standing else Verdict.refusal("parameter in flight")
        if name == "COMMAND_LONG":
            return self._command(frame, fields, now_s)
        asks = name == "COMMAND_INT" and fields["command"] in permits.ASKING
        listed = asks or name in permits.ALWAYS
        return Verdict.passed(frame.raw) if listed else Verdict.refusal(NOT_LISTED)

    def _setpoint(self, frame: Frame, fields: Fields, now_s: float) -> Verdict:
        asked = read(fields, self._plan.system_id, now_s)
        why = asked if isinstance(asked, str) else self._why_not(asked)
        if isinstance(asked, Asked):
            self._watch.asked = asked
        if self._vehicle.taken_over is not None or self._answer.deaf(now_s):
            return Verdict.refusal("setpoint, but hands are off")
        if why is not None:
            if now_s - self._watch.bad_s > TOLD_AGAIN_S:
                self._voice.say(f"setpoint {why}", Fault.SETPOINT_BAD)
            self._watch.bad_s = now_s
            self.counts["application: setpoint that broke a limit"] += 1
        if self.stage >= Stage.BRAKE:
            return Verdict.refusal("setpoint while the gate stops")
        # The one after it is no better for being alike; the stage that stops them all comes with the next cycle.
        good = now_s - self._watch.bad_s >= EVENT_S
        return Verdict.passed(frame.raw if good else self._voice.stop(now_s))

    def _why_not(self, asked: Asked) -> str | None:
        """What speaks against a setpoint that can be read; None: nothing."""
        reason = beyond(asked, self._watch.asked, self._plan.limits, self._plan.period_s)
        if reason is not None or asked.stands_still:
            return reason
        beat, phase = self._watch.beat, self._watch.phase
        if phase not in (Phase.CLIMBING, Phase.EXPLORING):
            return f"in phase {phase.name.lower()}"
        if asked.speed_mps > 0.0 and (phase is Phase.CLIMBING or beat is None or math.isnan(beat.ahead_m)):
            return "into the unknown"
        return self._leaves_the_fence(asked)

    def _leaves_the_fence(self, asked: Asked) -> str | None:
        motion, stopping = self._vehicle.motion, self._plan.stopping
        if motion.place_m is None:
            return None
        ahead_s = stopping.delay_s + self._plan.period_s + asked.speed_mps / (2.0 * stopping.brake_mps2)
        there = motion.after(asked.vx_mps * ahead_s, asked.vy_mps * ahead_s, asked.vz_mps * ahead_s)
        beyond_m = -math.inf if there is None else excess_m(self._plan.fence, *there)
        return "over the fence" if beyond_m > max(0.0, excess_m(self._plan.fence, *motion.place_m)) else None

    def _command(self, frame: Frame, fields: Fields, now_s: float) -> Verdict:
        command = int(fields["command"])
        if fields["target_system"] != self._plan.system_id or fields["target_component"] not in (
            0,
            MavComponent.AUTOPILOT1,
        ):
            return Verdict.refusal("command for another")
        if command in permits.ASKING:
            return Verdict.passed(frame.raw)
        if command not in permits.MOVING or not self._may_move(command, fields, now_s):
            self._voice.note(f"command {command} refused")
            self._upward.append(
                self._voice.acknowledge(
                    command, MavResult.TEMPORARILY_REJECTED, self._plan.system_id, MavComponent.ONBOARD_COMPUTER
                )
            )
            return Verdict.refusal("command refused")
        self._vehicle.told(command, fields, MavComponent.ONBOARD_COMPUTER)
        return Verdict.passed(frame.raw)

    def _may_move(self, command: int, fields: Fields, now_s: float) -> bool:
        """Whether a command that moves may pass now: to end a flight always, unless somebody else has the vehicle."""
        ours = self._vehicle.personality
        if self._vehicle.taken_over is not None:
            return False
        if command == MavCmd.COMPONENT_ARM_DISARM:
            arms = fields["param1"] == 1.0
            return not permits.is_forced(fields) and (not arms or self._may_begin(now_s))
        if command == MavCmd.NAV_TAKEOFF:
            return self._may_begin(now_s)
        if command == MavCmd.NAV_LAND:
            return True
        mode = permits.mode_asked_for(ours.kind, fields)
        if mode == ours.offboard:
            return self.stage is Stage.PASS
        return mode == ours.land or (mode == ours.hold and self.stage < Stage.LAND)

    def _may_begin(self, now_s: float) -> bool:
        return self.stage is Stage.PASS and self._watch.beat_age_s(now_s) <= ARMING_BEAT_S

    def _ordered(self, fields: Fields, frame: Frame) -> None:
        """A command of somebody else, which may be the stop that a person at a ground station orders."""
        if fields["command"] != MavCmd.DO_PAUSE_CONTINUE or fields["param1"] != 0.0:
            return
        if fields["target_system"] not in (0, self._plan.system_id):
            return
        if fields["target_component"] not in (0, MavComponent.ONBOARD_COMPUTER, MavComponent.ONBOARD_COMPUTER2):
            return
        self._watch.stop_ordered = True
        if fields["target_component"] == MavComponent.ONBOARD_COMPUTER2:
            self._answers.append(
                self._voice.acknowledge(
                    MavCmd.DO_PAUSE_CONTINUE, MavResult.ACCEPTED, frame.system_id, frame.component_id
                )
            )

    def _has_token(self, now_s: float) -> bool:
        most = self._plan.thresholds.messages_hz * BURST_S
        self._tokens = min(most, self._tokens + (now_s - self._tokens_s) * self._plan.thresholds.messages_hz)
        self._tokens_s = now_s
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True
