"""Over a shaft the vehicle goes back along the way that it came."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from companion.config.load import load_settings
from companion.control.trail import AHEAD_MPS, BACK_M, BACK_MPS, STEPS, Trail
from companion.gate.fault_monitor import CLOSING_MPS
from companion.model import Input, Mode, Pose, Setpoint
from tests.control.stages import DT_S, OPEN, ORIGIN, beside, in_boundary, mode_of

SETTINGS = load_settings(None, "flight")
LOST = replace(beside(1), h_m=None, missing=(Input.HEIGHT,), over_shaft=True)


def flown(trail: Trail, metres: float, yaw_rad: float = 0.0) -> Pose:
    """Straight on from ORIGIN."""
    pose = ORIGIN
    for i in range(round(metres / 0.05) + 1):
        pose = replace(ORIGIN, x_m=0.05 * i * math.cos(yaw_rad), y_m=0.05 * i * math.sin(yaw_rad), yaw_rad=yaw_rad)
        trail.note(pose)
    return pose


def gone_back(trail: Trail, pose: Pose) -> list[Pose]:
    """A vehicle that does what it is asked for, until nothing is."""
    poses = [pose]
    while (asked := trail.back_mps(pose)) is not None:
        forward_mps, left_mps = asked
        assert forward_mps <= AHEAD_MPS + 1e-9
        assert math.hypot(forward_mps, left_mps) == pytest.approx(BACK_MPS) or forward_mps == pytest.approx(AHEAD_MPS)
        cos, sin = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        x_m = pose.x_m + DT_S * (forward_mps * cos - left_mps * sin)
        y_m = pose.y_m + DT_S * (forward_mps * sin + left_mps * cos)
        pose = replace(pose, x_m=x_m, y_m=y_m)
        poses.append(pose)
        assert len(poses) < 1000
    return poses


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, math.pi, -2.0])
def test_it_goes_back_a_metre_along_the_way_it_came(yaw_rad: float) -> None:
    """Protects from hovering over a shaft until the flight ends there, and lands."""
    trail = Trail()
    pose = flown(trail, 2.0, yaw_rad)
    assert trail.back_mps(pose) is None, "as long as all is well it flies on"
    trail.begin(pose)
    poses = gone_back(trail, pose)
    assert math.dist((pose.x_m, pose.y_m), (poses[-1].x_m, poses[-1].y_m)) == pytest.approx(BACK_M, abs=0.02)
    off_m = [abs(one.x_m * math.sin(yaw_rad) - one.y_m * math.cos(yaw_rad)) for one in poses]
    assert max(off_m) < 0.01
    assert trail.back_mps(poses[-1]) is None, "once"


@pytest.mark.parametrize("turned_rad", [0.0, 1.0, 2.0, 2.5, math.pi, -1.9])
def test_wherever_it_has_turned_meanwhile_the_gate_lets_it_go_back(turned_rad: float) -> None:
    """The place that it leaves counts as rock: whoever closes in on that is stopped, held, and landed there."""
    assert AHEAD_MPS < CLOSING_MPS
    trail = Trail()
    pose = replace(flown(trail, 2.0), yaw_rad=turned_rad)
    trail.begin(pose)
    poses = gone_back(trail, pose)
    assert poses[-1].x_m == pytest.approx(2.0 - BACK_M, abs=0.02)
    assert max(abs(one.y_m) for one in poses) < 0.01
    ground_s = 0.5 / AHEAD_MPS
    assert ground_s < SETTINGS.mission.input_timeout_s, (
        "what it flew on while it braked is behind it before it is landed"
    )


def test_round_a_corner_it_goes_back_round_the_corner() -> None:
    """Protects from the rock that the straight way back would lead through; the nose stays where it looks."""
    trail = Trail()
    flown(trail, 1.0)
    pose = ORIGIN
    for i in range(11):
        pose = replace(ORIGIN, x_m=1.0, y_m=0.05 * i, yaw_rad=math.pi / 2.0)
        trail.note(pose)
    trail.begin(pose)
    for one in gone_back(trail, pose):
        assert min(abs(one.y_m), abs(one.x_m - 1.0)) < 0.1, one


def test_it_goes_no_further_than_it_knows() -> None:
    """Protects from the unknown: after the little that it has flown it stands."""
    trail = Trail()
    pose = flown(trail, 0.4)
    trail.begin(pose)
    assert gone_back(trail, pose)[-1].x_m == pytest.approx(0.0, abs=0.13)
    empty = Trail()
    empty.begin(ORIGIN)
    assert empty.back_mps(ORIGIN) is None
    long = Trail()
    flown(long, 50.0)
    assert len(long._places) == STEPS


def test_without_ground_the_law_goes_back_and_flies_on_afterwards() -> None:
    """Protects the mission: at the open edge of a scan it held, and ended after ten seconds."""
    navigator = in_boundary(1)
    for i in range(40):
        navigator.step(beside(1), replace(ORIGIN, x_m=0.05 * i), i * DT_S)
    edge = replace(ORIGIN, x_m=1.95)
    asked: list[Setpoint] = [navigator.step(LOST, edge, (40 + i) * DT_S) for i in range(10)]
    assert mode_of(navigator) is Mode.HOLD
    assert asked[-1].speed_mps == pytest.approx(-BACK_MPS, abs=0.01)
    assert (asked[-1].climb_mps, asked[-1].yaw_rate_radps) == (0.0, 0.0)
    over_ground = navigator.step(beside(1), replace(edge, x_m=1.5), 3.0)
    assert over_ground.speed_mps == pytest.approx(-BACK_MPS, abs=0.06), "d_s from the edge, not only back above ground"
    navigator.step(beside(1), replace(edge, x_m=0.9), 4.0)
    assert mode_of(navigator) is Mode.BOUNDARY


@pytest.mark.parametrize(
    ("missing", "over_shaft"),
    [
        ((Input.DEPTH, Input.HEIGHT), True),
        ((Input.HEIGHT, Input.POSE), True),
        ((Input.DEPTH,), False),
        ((Input.HEIGHT,), False),
    ],
)
def test_without_more_it_stands(missing: tuple[Input, ...], over_shaft: bool) -> None:
    """Protects from moving blind, and from going back a metre for each reading that a beam has missed."""
    navigator = in_boundary(1)
    for i in range(20):
        navigator.step(beside(1), replace(ORIGIN, x_m=0.05 * i), i * DT_S)
    for i in range(5):
        told = replace(OPEN, h_m=None, missing=missing, over_shaft=over_shaft)
        found = navigator.step(told, replace(ORIGIN, x_m=1.0), 1.0 + i * DT_S)
        assert (found.speed_mps, found.lateral_mps) == (0.0, 0.0)
