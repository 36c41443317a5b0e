"""The gate, one message at a time: what passes, what is counted, what is said, to the moment and the digit."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from companion.autopilot.kind import AutopilotKind
from companion.autopilot.personality import Personality, personality
from companion.safety.beat import Goodbye, Phase
from companion.safety.faults import Fault, Stage
from companion.safety.gate import Gate
from companion.safety.mavlink import Frame
from companion.safety.plan import Fence, Plan, Reaction, Stopping
from tests.safety.unit.built import (
    APPLICATION,
    AUTOPILOT,
    AUTOPILOT_NUMBER,
    BEAT,
    GATE,
    GROUND,
    KINDS,
    SETPOINT,
    SYSTEM,
    command,
    frame,
    read,
    setpoint,
)
from tests.safety.unit.built import PLAN as BUILT

NOW_S = 64.0
JUST_S = 2.0**-20
QUIET = Reaction(Stage.PASS, None, None)
PLAN = replace(
    BUILT,
    period_s=0.125,
    silence_s=0.5,
    stopping=Stopping(delay_s=0.25, brake_mps2=0.25),
    limits=replace(BUILT.limits, accel_mps2=100.0),
)
FENCED = replace(PLAN, fence=Fence(north_m=(-4.0, 4.0), east_m=(-4.0, 4.0), down_m=(-4.0, 4.0)))
BOTH = pytest.mark.parametrize("kind", KINDS)


class Scene:
    """A gate at `NOW_S` that knows its autopilot and its application; nothing flies yet."""

    def __init__(self, plan: Plan = PLAN, kind: AutopilotKind = AutopilotKind.PX4, phase: Phase = Phase.GROUND) -> None:
        self.gate = Gate(plan, NOW_S)
        self.kind = kind
        self.heartbeat(self.ours.hold, armed=False)
        self.beat(phase)

    @property
    def ours(self) -> Personality:
        return personality(self.kind)

    def beat(self, phase: Phase, now_s: float = NOW_S, **changes: Any) -> None:
        self.gate.beat(replace(BEAT, t_s=now_s, phase=phase, **changes).packed(), now_s)

    def stage(self) -> Stage:
        return self.gate.stage

    def goodbye(self) -> Goodbye | None:
        return self.gate.goodbye

    def patient_since_s(self) -> float | None:
        return self.gate._answer._hold_since_s

    def heartbeat(self, mode: int, now_s: float = NOW_S, *, armed: bool = True) -> None:
        self.hear("HEARTBEAT", now_s, autopilot=AUTOPILOT_NUMBER[self.kind], base_mode=128 * armed, custom_mode=mode)

    def hear(self, name: str, now_s: float = NOW_S, **fields: Any) -> None:
        self.gate.autopilot_spoke(frame(name, AUTOPILOT, **fields), now_s)

    def at(self, now_s: float = NOW_S, **place: float) -> None:
        self.hear("LOCAL_POSITION_NED", now_s, time_boot_ms=round(1e3 * now_s), **place)
        self.hear("ATTITUDE", now_s, yaw=0.0)

    def mode(self, mode: int, now_s: float = NOW_S) -> bool:
        order = command(176, *self.ours.set_mode_parameters(mode))
        return self.gate.application_spoke(order, now_s) == order.raw

    def passes(self, sent: Frame, now_s: float = NOW_S) -> bool:
        return self.gate.application_spoke(sent, now_s) == sent.raw

    def fly(self) -> None:
        """Armed, in the mode of setpoints, exploring; all is well."""
        assert self.passes(command(400, 1.0))
        assert self.mode(self.ours.offboard)
        self.heartbeat(self.ours.offboard)
        self.at()
        self.beat(Phase.EXPLORING)
        assert self.passes(setpoint())
        self.gate.cycle(NOW_S)
        assert self.gate.airborne
        assert self.stage() is Stage.PASS
        self.gate.take_notices()

    def sent(self, now_s: float) -> list[int]:
        """What the gate says, by the numbers of the messages."""
        return [read(raw)[0].message_id for raw in self.gate.cycle(now_s)]


def flying(plan: Plan = PLAN, kind: AutopilotKind = AutopilotKind.PX4) -> Scene:
    scene = Scene(plan, kind)
    scene.fly()
    return scene


def test_a_new_gate_knows_nothing() -> None:
    """Protects the first moment: nothing flies, nothing is done, nothing was said."""
    gate = Gate(PLAN, NOW_S)
    assert (gate.stage, gate.airborne, gate.armed, gate.goodbye) == (Stage.PASS, False, False, None)
    assert (gate.take_notices(), gate.take_upward(), gate.counts.total()) == ([], [], 0)
    assert [read(raw)[0].message_id for raw in gate.cycle(NOW_S)] == [0], "it lives, and has no more to say"
    assert gate.take_notices() == []
    assert not gate.hangs(NOW_S + 1e6)


def test_a_burst_of_half_a_second_passes_and_no_more() -> None:
    """Protects the autopilot's link: to the message, and with the time that fills up again."""
    scene = Scene()
    gate = Gate(PLAN, NOW_S)
    ping = frame("HEARTBEAT")
    assert [gate.application_spoke(ping, NOW_S) is not None for _ in range(201)] == [True] * 200 + [False]
    assert gate.counts == {"application: flood": 1}
    assert gate.application_spoke(ping, NOW_S + 0.00225) is None
    assert gate.application_spoke(ping, NOW_S + 0.00375) is not None
    assert gate.application_spoke(ping, NOW_S + 0.00375) is None
    later_s = NOW_S + 60.0
    assert sum(gate.application_spoke(ping, later_s) is not None for _ in range(300)) == 200
    assert scene.gate.counts.total() == 0


def test_a_flood_is_a_fault_while_it_lasts() -> None:
    """Protects the pilot's knowledge of it."""
    scene = flying()
    for _ in range(300):
        scene.gate.application_spoke(frame("HEARTBEAT"), NOW_S)
    scene.gate.cycle(NOW_S)
    assert scene.gate.take_notices() == ["flood", "brake: flood"]


@pytest.mark.parametrize(
    ("phase", "hangs"),
    [
        (Phase.GROUND, False),
        (Phase.CLIMBING, True),
        (Phase.EXPLORING, True),
        (Phase.ENDING, True),
        (Phase.ENDED, False),
    ],
)
def test_when_an_application_hangs(phase: Phase, hangs: bool) -> None:
    """Protects a working application from being killed, and a vehicle from one that does not work."""
    scene = Scene(phase=phase)
    assert not scene.gate.hangs(NOW_S + 10.0)
    assert scene.gate.hangs(NOW_S + 10.0 + JUST_S) is hangs
    scene.gate.application_died("fell")
    assert not scene.gate.hangs(NOW_S + 11.0)
    assert scene.gate.take_notices() == ["the application fell"]


def test_a_new_application_starts_afresh() -> None:
    """Protects it from the last one's end, and the vehicle from being believed to be its."""
    scene = flying()
    scene.gate.beat(Goodbye(4).packed(), NOW_S)
    assert scene.goodbye() == Goodbye(4)
    scene.gate.application_died("fell")
    scene.gate.cycle(NOW_S)
    assert scene.stage() is Stage.BRAKE
    scene.gate.application_started()
    assert scene.goodbye() is None
    assert (scene.gate.stage, scene.gate.armed, scene.gate.airborne) == (Stage.PASS, True, False)
    assert not scene.passes(command(400, 1.0)), "it has not ticked yet"
    scene.beat(Phase.CLIMBING)
    assert scene.passes(command(400, 1.0))
    assert scene.gate.airborne


def test_each_beat_that_cannot_be_is_counted_once() -> None:
    """Protects the numbers in the log; a goodbye is none of them."""
    scene = Scene()
    for data in (b"x", replace(BEAT, t_s=NOW_S + 1.0).packed(), Goodbye(0).packed(), replace(BEAT, t_s=NOW_S).packed()):
        scene.gate.beat(data, NOW_S)
    assert scene.gate.counts == {"beat that cannot be": 2}


@pytest.mark.parametrize(
    ("component", "system"), [(AUTOPILOT, 2), (154, SYSTEM), (APPLICATION, SYSTEM), (GATE, SYSTEM), (0, SYSTEM)]
)
def test_only_the_autopilot_of_our_vehicle_is_believed(component: int, system: int) -> None:
    """Protects from the words of a neighbour, a camera, and our own echo."""
    gate = Gate(PLAN, NOW_S)
    gate.autopilot_spoke(frame("HEARTBEAT", component, system, autopilot=12, base_mode=128), NOW_S)
    assert not gate.armed
    assert not gate._vehicle.heard_s > 0.0
    gate.autopilot_spoke(frame("HEARTBEAT", AUTOPILOT, SYSTEM, autopilot=12, base_mode=128), NOW_S)
    assert gate.armed


def test_what_is_not_read_is_heard() -> None:
    """Protects the link from being called dead because of a message that nobody here knows, or a longer one."""
    scene = Scene()
    scene.gate.autopilot_spoke(Frame(b"", 12000, SYSTEM, AUTOPILOT, b"", signed=False), NOW_S + 1.0)
    assert scene.gate._vehicle.heard_s == NOW_S + 1.0
    longer = Frame(b"", 0, SYSTEM, AUTOPILOT, b"\1" * 10, signed=False)
    scene.gate.autopilot_spoke(longer, NOW_S + 2.0)
    assert scene.gate._vehicle.heard_s == NOW_S + 2.0
    assert scene.gate._vehicle.heartbeat_s == NOW_S


ORDER: dict[str, Any] = {"target_system": SYSTEM, "target_component": GATE, "command": 193, "param1": 0.0}


def ordered(scene: Scene) -> bool:
    return Fault.GROUND_STOP in scene.gate._watch.faults(NOW_S)


@pytest.mark.parametrize("name", ["COMMAND_LONG", "COMMAND_INT"])
@pytest.mark.parametrize("system", [0, SYSTEM])
@pytest.mark.parametrize("component", [0, APPLICATION, GATE])
def test_an_order_to_stop_reaches_us_however_it_is_addressed(name: str, system: int, component: int) -> None:
    """Protects the person on the ground: over the autopilot's link, and over their own."""
    order = frame(name, GROUND[1], GROUND[0], **(ORDER | {"target_system": system, "target_component": component}))
    scene = Scene()
    scene.gate.autopilot_spoke(order, NOW_S)
    assert ordered(scene)
    attached = Scene()
    assert attached.gate.ground_spoke(order, "command") is (component == 0)
    assert ordered(attached)
    acks = [fields for fields in (read(raw)[1] for raw in attached.gate.cycle(NOW_S)) if "result" in fields]
    assert [(ack["command"], ack["result"], ack["target_system"], ack["target_component"]) for ack in acks] == (
        [(193, 0, *GROUND)] if component == GATE else []
    )
    assert 77 not in attached.sent(NOW_S), "once"


@pytest.mark.parametrize(
    "changes",
    [
        {"target_system": 2},
        {"target_component": AUTOPILOT},
        {"command": 300},
        {"param1": 1.0},
        {"param1": math.nan},
    ],
)
def test_other_orders_are_not_ours(changes: dict[str, Any]) -> None:
    """Protects the flight from orders to somebody else, and from "continue"."""
    order = frame("COMMAND_LONG", GROUND[1], GROUND[0], **(ORDER | changes))
    scene = Scene()
    scene.gate.autopilot_spoke(order, NOW_S)
    scene.gate.ground_spoke(order, "command")
    assert not ordered(scene)


@pytest.mark.parametrize("component", [APPLICATION, GATE])
def test_a_person_may_sit_at_any_component(component: int) -> None:
    """Protects a ground station that has our numbers, in a system of its own."""
    scene = Scene()
    scene.gate.autopilot_spoke(frame("COMMAND_LONG", component, GROUND[0], **ORDER), NOW_S)
    assert ordered(scene)


def test_who_may_command_may_send_what_nobody_here_knows() -> None:
    """Protects a ground station's work: files, logs, missions."""
    unknown = Frame(b"", 12000, *GROUND, b"", signed=False)
    assert Scene().gate.ground_spoke(unknown, "command") is True


@pytest.mark.parametrize("may", ["read", "odometry"])
def test_who_may_not_command_does_not_stop_either(may: str) -> None:
    """Protects the promise of "read": nothing that comes from there does anything."""
    scene = Scene()
    assert not scene.gate.ground_spoke(frame("COMMAND_LONG", GROUND[1], GROUND[0], **ORDER), may)
    assert not ordered(scene)
    assert scene.gate.counts == {"attached: not permitted": 1}
    assert scene.gate.ground_spoke(frame("HEARTBEAT", 197), may) is (may == "odometry")


def test_the_autopilot_and_the_application_order_nothing_as_a_person() -> None:
    """Protects from taking the vehicle's own words for those of a person."""
    scene = Scene()
    for component in (AUTOPILOT, APPLICATION):
        scene.gate.autopilot_spoke(frame("COMMAND_LONG", component, **ORDER), NOW_S)
    assert not ordered(scene)


def test_every_reason_has_its_count() -> None:
    """Protects who looks for the cause in the log."""
    scene = flying()
    for sent in (
        frame("HEARTBEAT", 42),
        frame("HEARTBEAT", APPLICATION, 2),
        frame("MANUAL_CONTROL"),
        frame("COMMAND_INT", target_system=SYSTEM, target_component=1, command=400),
        frame("PARAM_SET", target_system=SYSTEM),
        command(511, target_system=2),
        command(511, target_component=154),
        command(246, 1.0),
        Frame(b"", 12000, SYSTEM, APPLICATION, b"", signed=False),
        Frame(b"", 84, SYSTEM, APPLICATION, b"\1" * 54, signed=False),
    ):
        assert scene.gate.application_spoke(sent, NOW_S) is None
    assert scene.gate.counts == {
        "application: not on the list": 6,
        "application: parameter in flight": 1,
        "application: command for another": 2,
        "application: command refused": 1,
    }


def test_a_refused_command_is_answered_to_the_application() -> None:
    """Protects the application from waiting for an autopilot that never heard of it."""
    scene = Scene()
    assert not scene.passes(command(246, 1.0))
    (raw,) = scene.gate.take_upward()
    found, fields = read(raw)
    assert (found.system_id, found.component_id, found.message_id) == (SYSTEM, GATE, 77)
    assert (fields["command"], fields["result"]) == (246, 1)
    assert (fields["target_system"], fields["target_component"]) == (SYSTEM, APPLICATION)
    assert scene.gate.take_upward() == []
    assert scene.gate.take_notices() == ["command 246 refused"]
    assert scene.passes(command(512, target_component=0))
    assert scene.gate.take_upward() == []


def test_parameters_pass_to_an_autopilot_that_stands() -> None:
    """Protects the failsafes in flight; on the ground they are what pre-flight sets."""
    gate = Gate(PLAN, NOW_S)
    put = frame("PARAM_SET", target_system=SYSTEM)
    assert gate.application_spoke(put, NOW_S) is None
    scene = Scene()
    assert scene.passes(put)
    scene.heartbeat(scene.ours.hold)
    assert not scene.passes(put)


STAGES = (Stage.PASS, Stage.BRAKE, Stage.HOLD, Stage.LAND)


@BOTH
@pytest.mark.parametrize("stage", STAGES)
def test_which_commands_pass_at_which_stage(kind: AutopilotKind, stage: Stage) -> None:
    """Protects the ladder from being climbed down, and the way down from being closed."""
    scene = flying(kind=kind)
    ours = scene.ours
    orders = {
        "arm": command(400, 1.0),
        "disarm": command(400, 0.0),
        "take off": command(22),
        "land": command(21),
        "offboard": command(176, *ours.set_mode_parameters(ours.offboard)),
        "hold": command(176, *ours.set_mode_parameters(ours.hold)),
        "land mode": command(176, *ours.set_mode_parameters(ours.land)),
        "forced": command(400, 0.0, 21196.0),
        "another mode": command(176, 1.0, 1.0, 0.0),
        "another command": command(246, *ours.set_mode_parameters(ours.land)),
    }
    may = {"disarm", "land", "land mode"}
    may |= {"arm", "take off", "offboard"} if stage is Stage.PASS else set()
    may |= {"hold"} if stage < Stage.LAND else set()
    scene.gate._ladder.force(stage)
    assert {name for name, order in orders.items() if scene.passes(order)} == may
    pilots = {AutopilotKind.PX4: 3 << 16, AutopilotKind.ARDUPILOT: 5}[kind]
    scene.heartbeat(pilots)
    assert {name for name, order in orders.items() if scene.passes(order)} == set(), "the pilot has it"
    assert scene.passes(command(512)), "but asking is free"


def test_who_has_not_ticked_for_half_a_second_begins_nothing() -> None:
    """Protects the ground from commands without an application behind them."""
    scene = Scene()
    for order in (command(400, 1.0), command(22)):
        assert scene.passes(order, NOW_S + 0.5)
        assert not scene.passes(order, NOW_S + 0.5 + JUST_S)
    assert scene.passes(command(400, 2.0), NOW_S + 9.0), "whatever that is, it does not arm"


def test_an_arming_may_take_its_time() -> None:
    """Protects the take-off: between the order and the motors nothing may make the gate forget whose flight it is."""
    scene = Scene()
    assert scene.passes(command(400, 1.0))
    scene.gate.cycle(NOW_S)
    scene.gate.cycle(NOW_S + 0.01)
    scene.heartbeat(scene.ours.hold, NOW_S + 0.02)
    assert scene.gate.airborne


def test_faults_that_come_together_are_told_in_one_order() -> None:
    """Protects tests and logs from sets, which have none."""
    scene = flying()
    never = dict.fromkeys(("depth_age_s", "ranges_age_s", "pose_age_s", "map_age_s"), math.inf)
    scene.beat(Phase.EXPLORING, **never)
    scene.gate.application_died("fell")
    scene.gate.cycle(NOW_S)
    _, *told = scene.gate.take_notices()
    names = ["application died", "depth_stale never", "map never", "pose_stale never", "ranges_stale never"]
    assert told == [*names, "brake: application"]


def test_what_is_told_of_a_fault_and_of_its_answer() -> None:
    """Protects the pilot's reading: the fault with its number once, the stage with its cause, and the end of it."""
    scene = flying()
    scene.beat(Phase.EXPLORING, depth_age_s=0.75)
    assert scene.sent(NOW_S) == [84, 253]
    assert scene.gate.take_notices() == ["depth_stale 0.75 s", "brake: depth_stale"]
    assert scene.sent(NOW_S + 0.0625) == [], "not twice in a period, and the pilot reads the first text yet"
    for later_s in (0.6, 1.2, 1.8):
        now_s = NOW_S + later_s
        scene.heartbeat(scene.ours.offboard, now_s)
        scene.at(now_s, x=1e-3 * later_s)
        scene.beat(Phase.EXPLORING, now_s)
        scene.gate.application_spoke(setpoint(), now_s)
        scene.gate.cycle(now_s)
    assert scene.stage() is Stage.PASS
    assert scene.gate.take_notices()[-1] == "pass: all is well"


def test_an_order_is_told_without_numbers() -> None:
    """Protects the same for faults that have none."""
    scene = flying()
    scene.gate.autopilot_spoke(frame("COMMAND_LONG", GROUND[1], GROUND[0], **ORDER), NOW_S)
    assert scene.sent(NOW_S)[:2] == [77, 84], "the answer goes out with the stop"
    assert scene.gate.take_notices() == ["ground_stop", "brake: ground_stop"]


def test_hands_are_off_once_in_each_flight() -> None:
    """Protects the pilot from being told again and again, and from not being told the next time."""
    scene = flying()
    for _ in range(2):
        scene.heartbeat(3 << 16)
        assert not scene.gate.airborne
        scene.gate.cycle(NOW_S)
        scene.gate.cycle(NOW_S)
        assert scene.gate.take_notices() == ["hands off, mode position"]
        scene.heartbeat(3 << 16, armed=False)
        scene.gate.cycle(NOW_S)
        scene.heartbeat(3 << 16)
        assert not scene.gate.airborne, "who arms it now is somebody else"
        scene.gate.cycle(NOW_S)
        assert scene.gate.take_notices() == []
        scene.heartbeat(3 << 16, armed=False)
        scene.gate.application_started()
        scene.beat(Phase.CLIMBING)
        scene.fly()


def test_after_a_flight_the_ladder_is_at_its_foot() -> None:
    """Protects the next flight from the stage, the faults and the patience of the last."""
    scene = flying()
    scene.gate.autopilot_spoke(frame("COMMAND_LONG", GROUND[1], GROUND[0], **ORDER), NOW_S)
    scene.gate._ladder.force(Stage.HOLD)
    scene.gate.cycle(NOW_S)
    assert scene.patient_since_s() == NOW_S
    assert scene.stage() is Stage.HOLD
    assert scene.mode(scene.ours.land)
    scene.heartbeat(scene.ours.land)
    scene.gate.cycle(NOW_S)
    scene.heartbeat(scene.ours.land, armed=False)
    scene.gate.cycle(NOW_S)
    assert scene.stage() is Stage.PASS
    assert scene.patient_since_s() is None
    assert not scene.gate._ladder.counting


def test_on_the_ground_nothing_is_a_fault() -> None:
    """Protects from stops, modes and texts before anything flies."""
    scene = Scene()
    for second in range(1, 9):
        assert scene.sent(NOW_S + second) == [0]
    assert scene.gate.take_notices() == []


def said(scene: Scene, sent: Frame, now_s: float = NOW_S) -> list[str]:
    """What is told of a setpoint; nothing: it passes."""
    raw = scene.gate.application_spoke(sent, now_s)
    if raw == sent.raw:
        return []
    assert raw is not None
    fields = read(raw)[1]
    assert [fields[name] for name in ("vx", "vy", "vz", "yaw_rate")] == [0.0] * 4
    return scene.gate.take_notices()


def test_a_setpoint_that_cannot_be_meant_is_told_and_forgotten() -> None:
    """Protects the next one from being compared with it."""
    scene = flying()
    assert said(scene, setpoint(math.nan)) == ["setpoint not finite"]
    assert said(scene, setpoint(0.1)) == []


def test_a_bad_setpoint_is_told_again_when_it_was_good_for_a_second() -> None:
    """Protects the pilot from twenty texts a second, and from none at all."""
    scene = flying(replace(PLAN, silence_s=9.0))
    bad = setpoint(9.0)
    assert said(scene, bad) == ["setpoint 9.00 m/s"]
    assert said(scene, bad, NOW_S + 1.0) == []
    assert said(scene, bad, NOW_S + 2.0 + JUST_S) == ["setpoint 9.00 m/s"]
    assert scene.gate.counts == {"application: setpoint that broke a limit": 3}


@pytest.mark.parametrize("stage", STAGES[1:])
def test_while_the_gate_stops_no_setpoint_passes(stage: Stage) -> None:
    """Protects the stop from being overwritten, by good setpoints too."""
    scene = flying()
    scene.gate._ladder.force(stage)
    assert scene.gate.application_spoke(setpoint(), NOW_S) is None
    assert scene.gate.application_spoke(setpoint(9.0), NOW_S) is None
    assert scene.gate.counts == {
        "application: setpoint while the gate stops": 2,
        "application: setpoint that broke a limit": 1,
    }


def test_hands_off_is_hands_off() -> None:
    """Protects the pilot, and an autopilot that may not hear: not even a stop goes out, and no fault is made of it."""
    scene = flying()
    scene.gate.autopilot_spoke(frame("COMMAND_LONG", GROUND[1], GROUND[0], **ORDER), NOW_S)
    assert 84 in scene.sent(NOW_S)
    scene.gate.take_notices()
    assert scene.gate.application_spoke(setpoint(9.0), NOW_S + 0.75) is None
    scene.heartbeat(3 << 16, NOW_S + 1.0)
    assert scene.gate.application_spoke(setpoint(), NOW_S + 1.0) is None
    assert scene.gate.counts == {"application: setpoint, but hands are off": 2}
    assert scene.gate.take_notices() == []
    assert scene.sent(NOW_S + 1.0) == [0, 253]


@pytest.mark.parametrize("phase", list(Phase))
def test_what_may_be_asked_for_in_which_phase(phase: Phase) -> None:
    """Protects each phase: standing always, climbing in a take-off, all of it when it explores and sees."""
    scene = flying()
    scene.beat(phase)
    word = f"setpoint in phase {phase.name.lower()}"
    climbing, flies = phase is Phase.CLIMBING, phase in (Phase.CLIMBING, Phase.EXPLORING)
    assert said(scene, setpoint()) == []
    assert said(scene, setpoint(vz=-0.1)) == ([] if flies else [word])
    assert said(scene, setpoint(yaw_rate=0.1), NOW_S + 0.01) == [] or not flies
    unknown = ["setpoint into the unknown"] if climbing else ([] if flies else [word])
    for sideways in (setpoint(vx=0.1), setpoint(vy=-0.1)):
        fresh = flying()
        fresh.beat(phase)
        assert said(fresh, sideways) == unknown


def test_into_the_unknown_one_may_look_but_not_go() -> None:
    """Protects against flying where nothing was seen; to turn round and to climb shows more."""
    for sent, words in (
        (setpoint(vx=0.1), ["setpoint into the unknown"]),
        (setpoint(vy=0.1), ["setpoint into the unknown"]),
        (setpoint(yaw_rate=0.1), []),
        (setpoint(vz=0.1), []),
    ):
        scene = flying()
        scene.beat(Phase.EXPLORING, ahead_m=math.nan)
        assert said(scene, sent) == words


@pytest.mark.parametrize(
    ("axis", "sent", "way_m"),
    [
        ("x", setpoint(vx=0.5), 0.6875),
        ("x", setpoint(vx=-0.5), 0.6875),
        ("y", setpoint(vy=0.25), 0.21875),
        ("y", setpoint(vy=-0.25), 0.21875),
        ("z", setpoint(vz=0.25), 0.09375),
        ("z", setpoint(vz=-0.25), 0.09375),
    ],
)
def test_what_would_stop_outside_the_fence_is_refused(axis: str, sent: Frame, way_m: float) -> None:
    """Protects the fence by the way of a stop: v · (0.25 + 0.125 s), and in the plane v² / (2 · 0.25 m/s²).

    To its edge it passes, beyond it does not; from outside, what leads no further out passes.
    """
    fields = read(sent.raw)[1]
    sign = math.copysign(1.0, fields[f"v{axis}"])
    for place_m, passes in (
        (sign * (4.0 - way_m), True),
        (sign * (4.0 - way_m + 2.0**-10), False),
        (sign * 4.5, False),
        (-sign * 4.5, True),
    ):
        scene = Scene(FENCED)
        assert scene.passes(command(400, 1.0))
        assert scene.mode(scene.ours.offboard)
        scene.heartbeat(scene.ours.offboard)
        scene.at(**{axis: place_m})
        scene.beat(Phase.EXPLORING)
        assert said(scene, sent) == ([] if passes else ["setpoint over the fence"])


def test_where_the_place_or_the_heading_is_not_known_the_fence_says_nothing() -> None:
    """Protects from a fence that raises; the place itself is watched for elsewhere."""
    scene = Scene(FENCED, phase=Phase.EXPLORING)
    assert said(scene, setpoint(0.1)) == []
    scene.hear("LOCAL_POSITION_NED", time_boot_ms=1, x=3.999)
    assert said(scene, setpoint(0.2)) == []
    scene.hear("ATTITUDE", yaw=0.0)
    assert said(scene, setpoint(0.3)) == ["setpoint over the fence"]


def test_along_the_outside_of_the_fence_one_may_go() -> None:
    """Protects the way back in, which need not be the shortest."""
    scene = flying(replace(FENCED, reactions=dict.fromkeys(Fault, QUIET)))
    scene.at(NOW_S + 0.25, x=4.5)
    assert said(scene, setpoint(vy=0.1), NOW_S + 0.25) == []
    assert said(scene, setpoint(vx=0.1), NOW_S + 0.25) == ["setpoint over the fence"]


def test_setpoints_of_another_form_are_on_no_list() -> None:
    """Protects the one form that is checked."""
    scene = flying()
    assert scene.gate.application_spoke(frame(SETPOINT, 42, target_system=SYSTEM), NOW_S) is None
    assert scene.gate.application_spoke(frame("SET_ATTITUDE_TARGET", target_system=SYSTEM), NOW_S) is None
    assert scene.gate.counts == {"application: not on the list": 2}


@pytest.mark.parametrize(
    ("blind_s", "after", "stage"),
    [
        (3.0, Phase.ENDED, Stage.LAND),
        (0.5, Phase.ENDED, Stage.PASS),
        (3.0, Phase.EXPLORING, Stage.HOLD),
    ],
)
def test_a_landing_stays_due_when_the_application_ends_its_flight_in_a_hold(
    blind_s: float, after: Phase, stage: Stage
) -> None:
    """Protects a vehicle that was stopped: who ends tells no more, which is not the same as that all is well."""
    scene = flying(replace(PLAN, reactions=PLAN.reactions | {Fault.DEPTH_STALE: Reaction(Stage.BRAKE, 3.0, 10.0)}))
    for quarter in range(12 * 4):
        now_s = NOW_S + quarter / 4
        blind = now_s <= NOW_S + blind_s
        shown = {Stage.HOLD: scene.ours.hold, Stage.LAND: scene.ours.land}.get(scene.stage(), scene.ours.offboard)
        scene.heartbeat(shown, now_s)
        scene.at(now_s, x=1e-3 * (quarter % 3))
        scene.beat(Phase.EXPLORING if blind else after, now_s, depth_age_s=9.0 if blind else 0.0)
        scene.gate.application_spoke(setpoint(), now_s)
        scene.gate.cycle(now_s)
    assert scene.stage() is stage
