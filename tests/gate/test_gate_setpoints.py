"""What a setpoint may be: limits, distance, fence, phase and place."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from companion.gate.faults import Fault, Stage
from companion.gate.plan import Geofence, Reaction
from companion.gate.protocol import Phase
from companion.mavlink.codec import Frame
from tests.gate.built import BEAT, PLAN, Air, command, in_the_air, read, setpoint, texts_of
from tests.gate.gate_scene import JUST_S, NOW_S, Scene, flying
from tests.gate.gate_scene import PLAN as SCENE_PLAN

WRONG = [
    ({"vx": math.nan}, "not finite"),
    ({"yaw": math.inf}, "not finite"),
    ({"vx": 0.6}, "speed 0.60 m/s"),
    ({"vx": 0.4, "vy": 0.4}, "speed 0.57 m/s"),
    ({"vz": -0.5}, "climb 0.50 m/s"),
    ({"yaw_rate": 0.7}, "yaw 0.70 rad/s"),
    ({"vx": 0.5}, "jumps by 0.40 m/s"),
    ({"vz": 0.3}, "jumps by 0.30 m/s"),
    ({"coordinate_frame": 1}, "in frame 1"),
    ({"type_mask": 0}, "with type mask 0"),
    ({"target_system": 7}, "for 7/1"),
    ({"target_component": 0}, "for 1/0"),
]


@pytest.mark.parametrize(("changes", "words"), WRONG)
def test_a_setpoint_that_breaks_a_limit_becomes_a_stop(changes: dict[str, float], words: str) -> None:
    """Protects the vehicle from each kind of wrong setpoint: replaced, counted, told, and the next ones with it."""
    air = in_the_air()
    raw = air.ask(setpoint(**({"vx": 0.1} | changes)))
    assert raw is not None
    _, fields = read(raw)
    assert [fields[name] for name in ("vx", "vy", "vz", "yaw_rate")] == [0.0] * 4
    assert (fields["target_system"], fields["coordinate_frame"], fields["type_mask"]) == (1, 8, 0x5C7)
    air.run(0.6)
    assert f"setpoint rejected: {words}" in air.notices
    assert air.faults()[Fault.SETPOINT_BAD] == 1
    assert air.gate.counts["application: setpoint that broke a limit"] >= 1
    texts = [fields["text"] for _, name, fields in air.sent if name == "STATUSTEXT"]
    assert texts == ["gate: brake: setpoint_bad", f"gate: setpoint rejected: {words}"[:50]], "what is done comes first"
    assert air.stage() is Stage.BRAKE
    assert air.ask(setpoint(**({"vx": 0.1} | changes))) is None, "the gate's own stops go out already"
    air.run(1.5)
    assert air.stage() is Stage.PASS


def test_speed_grows_slowly_and_a_stop_comes_at_once() -> None:
    """Protects both sides of the acceleration limit: a jump up is refused, braking never is."""
    air = in_the_air()
    air.setpoints = False
    for vx in (0.21, 0.32, 0.43, 0.54, 0.0):
        air.run(0.05)
        assert air.ask(setpoint(vx)) == setpoint(vx).raw
    air.run(0.05)
    assert air.ask(setpoint(-0.13)) is not None
    assert air.gate.counts["application: setpoint that broke a limit"] == 1
    air = in_the_air()
    assert air.ask(setpoint(-0.11)) == setpoint(-0.11).raw, "what turns round has stood in between"


def test_who_does_not_know_what_is_ahead_does_not_move() -> None:
    """Protects against flying into the unknown, with or without eyes."""
    air = in_the_air()
    air.beat = replace(BEAT, ahead_m=math.nan)
    air.run(0.1)
    assert "setpoint rejected: path not observed" in air.notices
    assert air.ask(setpoint(yaw_rate=0.3)) is None
    air = in_the_air()
    air.beat = replace(BEAT, phase=Phase.CLIMBING)
    air.wanted = (0.0, 0.0, -0.1, 0.0)
    air.run(0.3)
    assert air.stage() is Stage.PASS, "a take-off by setpoints climbs"
    air.wanted = (0.05, 0.0, 0.0, 0.0)
    air.run(0.1)
    assert air.stage() is Stage.BRAKE, "and does nothing else"
    air = in_the_air()
    air.beat = replace(BEAT, phase=Phase.ENDING)
    air.run(0.1)
    assert "setpoint rejected: in phase ending" in air.notices


def test_a_wall_that_comes_too_near_is_not_flown_into() -> None:
    """Protects against an application that ignores the wall: the distance is what is left after stopping."""
    air = in_the_air()
    air.position["vx"] = 0.5
    # 0.5 m/s · (0.15 + 2 · 0.05 s) + 0.25 / 1.6 m, and up to 0.05 s since the beat: 0.28 to 0.31 m.
    air.beat = replace(BEAT, ahead_m=0.85)
    air.run(0.3)
    assert air.stage() is Stage.PASS
    air.beat = replace(BEAT, ahead_m=0.77)
    air.run(0.1)
    assert air.faults()[Fault.DISTANCE] == 1
    assert air.stage() is Stage.BRAKE
    air.position["vx"] = 0.0
    air.wanted = (0.0, 0.0, 0.0, 0.3)
    air.run(1.5)
    assert air.stage() is Stage.PASS, "standing there it may turn away"
    air = in_the_air()
    air.positions = False
    air.tell("LOCAL_POSITION_NED", time_boot_ms=round(air.now_s * 1e3))
    air.wanted = (0.2, 0.0, 0.0, 0.0)
    air.beat = replace(BEAT, ahead_m=0.4)
    air.run(0.1)
    assert air.faults()[Fault.DISTANCE] == 1, "what is asked for counts as well as what is flown"


def test_the_fence_keeps_in_and_lets_back() -> None:
    """Protects the fence from both sides: nothing leads out of it, and from outside the way back is free."""
    fenced = replace(PLAN, fence=Geofence(north_m=(-50.0, 3.0), east_m=(-2.0, 2.0), down_m=(-2.5, 0.5), radius_m=60.0))
    air = in_the_air(fenced)
    assert air.stage() is Stage.PASS
    air.position["x"] = 2.98
    air.run(1.5)
    assert "setpoint rejected: leaves the geofence" in air.notices
    air.wanted = (-0.1, 0.0, 0.0, 0.0)
    air.run(1.5)
    assert air.stage() is Stage.PASS
    air = in_the_air(fenced)
    air.position["z"] = -2.6
    air.run(0.05)
    assert air.faults()[Fault.FENCE] == 1
    out = replace(
        PLAN,
        fence=Geofence(north_m=(-50.0, 3.0)),
        reactions=PLAN.reactions
        | {Fault.FENCE: Reaction(Stage.PASS, None, None), Fault.POSE_JUMP: Reaction(Stage.PASS, None, None)},
    )
    air = in_the_air(out)
    air.position["x"] = 3.4
    air.run(0.1)
    air.wanted = (-0.1, 0.0, 0.0, 0.0)
    air.run(1.5)
    assert air.ask(setpoint(-0.1)) == setpoint(-0.1).raw, "back inside"
    assert air.ask(setpoint(0.05)) != setpoint(0.05).raw, "not further out"


def test_a_fence_without_a_place_or_a_heading_says_nothing_of_setpoints() -> None:
    """Protects the start: a vehicle that does not tell where it is is stopped for that, not for the fence."""
    fenced = replace(PLAN, fence=Geofence(radius_m=1.0))
    air = Air(fenced)
    air.positions = False
    air.heartbeat()
    air.run(0.1)
    assert air.ask(setpoint(0.1)) == setpoint(0.1).raw
    air.tell("LOCAL_POSITION_NED", time_boot_ms=5, x=0.9)
    assert air.ask(setpoint(0.1)) == setpoint(0.1).raw


def test_what_does_not_pass_is_not_closing() -> None:
    """Protects the pilot's text: a setpoint of 5 m/s is a bad setpoint, and no wall that comes near."""
    air = in_the_air()
    air.beat = replace(BEAT, ahead_m=1.4)
    assert air.ask(setpoint(5.0)) is not None
    air.run(0.02)
    assert air.faults()[Fault.DISTANCE] == 0
    assert air.faults()[Fault.SETPOINT_BAD] == 1


def test_the_same_jump_again_is_no_smaller() -> None:
    """Protects the moment until the next cycle: a refused setpoint must not make way for its like."""
    air = in_the_air()
    for _ in range(3):
        raw = air.ask(setpoint(0.5))
        assert raw is not None
        assert read(raw)[1]["vx"] == 0.0


# A setpoint in its phase and its place: which ones pass, and what is told of the others.


QUIET = Reaction(Stage.PASS, None, None)
FENCED = replace(SCENE_PLAN, fence=Geofence(north_m=(-4.0, 4.0), east_m=(-4.0, 4.0), down_m=(-4.0, 4.0)))


def said(scene: Scene, sent: Frame, now_s: float = NOW_S) -> list[str]:
    """What is told of a setpoint; nothing: it passes."""
    raw = scene.gate.on_application_message(sent, now_s).raw
    if raw == sent.raw:
        return []
    assert raw is not None
    fields = read(raw)[1]
    assert [fields[name] for name in ("vx", "vy", "vz", "yaw_rate")] == [0.0] * 4
    return texts_of(scene.gate)


def test_a_setpoint_that_cannot_be_meant_is_told_and_forgotten() -> None:
    """Protects the next one from being compared with it."""
    scene = flying()
    assert said(scene, setpoint(math.nan)) == ["setpoint rejected: not finite"]
    assert said(scene, setpoint(0.1)) == []


def test_a_bad_setpoint_is_told_again_when_it_was_good_for_a_second() -> None:
    """Protects the pilot from twenty texts a second, and from none at all."""
    scene = flying(replace(SCENE_PLAN, silence_s=9.0))
    bad = setpoint(9.0)
    assert said(scene, bad) == ["setpoint rejected: speed 9.00 m/s"]
    assert said(scene, bad, NOW_S + 1.0) == []
    assert said(scene, bad, NOW_S + 2.0 + JUST_S) == ["setpoint rejected: speed 9.00 m/s"]
    assert scene.gate.counts == {"application: setpoint that broke a limit": 3}


@pytest.mark.parametrize("phase", list(Phase))
def test_what_may_be_asked_for_in_which_phase(phase: Phase) -> None:
    """Protects each phase: standing always, climbing in a take-off, all of it when it explores and sees."""
    scene = flying()
    scene.beat(phase)
    word = f"setpoint rejected: in phase {phase.name.lower()}"
    climbing, flies = phase is Phase.CLIMBING, phase in (Phase.CLIMBING, Phase.EXPLORING)
    assert said(scene, setpoint()) == []
    assert said(scene, setpoint(vz=-0.1)) == ([] if flies else [word])
    assert said(scene, setpoint(yaw_rate=0.1), NOW_S + 0.01) == [] or not flies
    unknown = ["setpoint rejected: path not observed"] if climbing else ([] if flies else [word])
    for sideways in (setpoint(vx=0.1), setpoint(vy=-0.1)):
        fresh = flying()
        fresh.beat(phase)
        assert said(fresh, sideways) == unknown


def test_into_the_unknown_one_may_look_but_not_go() -> None:
    """Protects against flying where nothing was seen; to turn round and to climb shows more."""
    for sent, words in (
        (setpoint(vx=0.1), ["setpoint rejected: path not observed"]),
        (setpoint(vy=0.1), ["setpoint rejected: path not observed"]),
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
        assert said(scene, sent) == ([] if passes else ["setpoint rejected: leaves the geofence"])


def test_where_the_place_or_the_heading_is_not_known_the_fence_says_nothing() -> None:
    """Protects from a fence that raises; the place itself is watched for elsewhere."""
    scene = Scene(FENCED, phase=Phase.EXPLORING)
    assert said(scene, setpoint(0.1)) == []
    scene.hear("LOCAL_POSITION_NED", time_boot_ms=1, x=3.999)
    assert said(scene, setpoint(0.2)) == []
    scene.hear("ATTITUDE", yaw=0.0)
    assert said(scene, setpoint(0.3)) == ["setpoint rejected: leaves the geofence"]


def test_along_the_outside_of_the_fence_one_may_go() -> None:
    """Protects the way back in, which need not be the shortest."""
    scene = flying(replace(FENCED, reactions=dict.fromkeys(Fault, QUIET)))
    scene.at(NOW_S + 0.25, x=4.5)
    assert said(scene, setpoint(vy=0.1), NOW_S + 0.25) == []
    assert said(scene, setpoint(vx=0.1), NOW_S + 0.25) == ["setpoint rejected: leaves the geofence"]
