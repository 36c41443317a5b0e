"""A setpoint in its phase and its place: which ones pass, and what is told of the others."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from companion.gate.faults import Fault, Stage
from companion.gate.plan import Geofence, Reaction
from companion.gate.protocol import Phase
from companion.mavlink.codec import Frame
from tests.gate.built import command, read, setpoint, texts_of
from tests.gate.gate_scene import JUST_S, NOW_S, PLAN, Scene, flying

QUIET = Reaction(Stage.PASS, None, None)
FENCED = replace(PLAN, fence=Geofence(north_m=(-4.0, 4.0), east_m=(-4.0, 4.0), down_m=(-4.0, 4.0)))


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
    scene = flying(replace(PLAN, silence_s=9.0))
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
