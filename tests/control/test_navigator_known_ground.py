"""R2 over known ground: decided once, flown straight by straight, and left where the scan does not confirm it."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest

from companion.control.decisions import Choice
from companion.control.informed import Way
from companion.control.known_ground import Place
from companion.control.target import TargetKind
from companion.model import Mode
from tests.control.scene import measurement, scan_of
from tests.control.stages import DT_S, OPEN, ORIGIN, Fixed, beside, in_boundary, mode_of

WAY = Way(12.0, Place(3.0, 2.0, 0.0), Place(6.0, 5.0, 0.0))
"""From ORIGIN: straight to (3, 2), and on to (6, 5)."""


def offered(monkeypatch: pytest.MonkeyPatch, way: Way | None = WAY, then: Way | None = None) -> None:
    """The choice knows that way, and from its first straight the other one."""
    monkeypatch.setattr(Choice, "better_way", lambda *_: way)
    monkeypatch.setattr(Choice, "onward", lambda *_: then)
    monkeypatch.setattr(Choice, "side", lambda *_: 1)
    monkeypatch.setattr(Choice, "has_been_seen", lambda *_: False)


def test_a_way_over_known_ground_is_taken_with_all_but_p_min(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects Theorem 1: both outcomes keep at least p_min, whatever the known ground says; each is one draw."""
    offered(monkeypatch)
    taken = 0
    for seed in range(300):
        navigator = in_boundary(-1, choice="informed", least_probability=0.2, rng=np.random.default_rng(seed))
        navigator.step(beside(-1), ORIGIN, 0.0)
        assert navigator.status.draws == 1
        taken += mode_of(navigator) is Mode.TANGENT
    # Of 300 with 0.8: 240, three standard deviations are 21.
    assert 219 <= taken <= 261


def test_a_straight_leads_to_the_next_and_the_last_one_to_the_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the way: it is decided once, and flown to its end."""
    offered(monkeypatch, then=Way(5.0, Place(6.0, 5.0, 0.0), Place(6.0, 5.0, 0.0)))
    navigator = in_boundary(-1, choice="informed", rng=Fixed(0.99))
    navigator.step(beside(-1), ORIGIN, 0.0)
    target = navigator.status.target
    assert target is not None
    assert target.kind is TargetKind.KNOWN
    assert (target.x_m, target.y_m) == pytest.approx((3.0, 2.0))
    navigator.step(OPEN, replace(ORIGIN, x_m=2.95, y_m=1.95), 1.0)
    target = navigator.status.target
    assert target is not None
    assert target.kind is TargetKind.KNOWN
    assert (target.x_m, target.y_m) == pytest.approx((6.0, 5.0))
    offered(monkeypatch, then=None)
    navigator.step(OPEN, replace(ORIGIN, x_m=5.95, y_m=4.95), 2.0)
    assert (mode_of(navigator), navigator.status.gamma) == (Mode.BOUNDARY, 1)
    assert navigator.status.draws == 1


def test_a_straight_that_the_scan_does_not_confirm_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from known ground that is wrong: rock in the corridor ends it, a single bad image does not."""
    offered(monkeypatch)
    blocked: list[bool] = []
    monkeypatch.setattr(Choice, "block_way", lambda *_: blocked.append(True))
    facing = replace(ORIGIN, yaw_rad=math.atan2(2.0, 3.0))
    rock = scan_of(lambda b: 2.0 if abs(b) < 0.2 else math.inf)
    for times, ends in ((8, False), (13, True)):
        navigator = in_boundary(-1, choice="informed", rng=Fixed(0.99))
        navigator.step(beside(-1), ORIGIN, 0.0)
        for i in range(times):
            navigator.step(measurement(rock, d_m=2.0, d_bearing_rad=0.0), facing, DT_S * (i + 1))
            if blocked:
                break
        assert (mode_of(navigator) is Mode.BOUNDARY) == ends
        assert bool(blocked) == ends


def test_while_it_turns_towards_it_nothing_need_be_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects ways that lead back: behind the vehicle nobody looks."""
    offered(monkeypatch, Way(12.0, Place(-3.0, 0.0, 0.0), Place(-3.0, 0.0, 0.0)))
    behind = scan_of(lambda b: math.nan if abs(b) > 0.75 else math.inf)
    navigator = in_boundary(-1, choice="informed", rng=Fixed(0.99))
    navigator.step(beside(-1), ORIGIN, 0.0)
    for i in range(40):
        setpoint = navigator.step(measurement(behind), ORIGIN, DT_S * (i + 1))
        assert mode_of(navigator) is Mode.TANGENT
        assert setpoint.yaw_rate_radps != 0.0


@pytest.mark.parametrize(
    ("then", "draw", "mode", "draws"),
    [
        (Way(5.0, Place(6.0, 1.0, 0.0), Place(9.0, 1.0, 0.0)), 0.0, Mode.TANGENT, 1),
        (Way(5.0, Place(-6.0, 1.0, 0.0), Place(-6.0, 1.0, 0.0)), 0.99, Mode.TANGENT, 2),
        (Way(5.0, Place(-6.0, 1.0, 0.0), Place(-6.0, 1.0, 0.0)), 0.0, Mode.BOUNDARY, 2),
        (None, 0.99, Mode.BOUNDARY, 1),
    ],
    ids=["ahead", "back", "back, refused", "nothing is left"],
)
def test_what_has_been_seen_from_afar_is_not_flown_to(
    monkeypatch: pytest.MonkeyPatch, then: Way | None, draw: float, mode: Mode, draws: int
) -> None:
    """Protects the way: it ends when its goal is in view. Going on ahead is the same decision, turning back another."""
    offered(monkeypatch)
    navigator = in_boundary(-1, choice="informed", rng=Fixed(0.99))
    navigator.step(beside(-1), ORIGIN, 0.0)
    monkeypatch.setattr(Choice, "onward", lambda *_: then)
    monkeypatch.setattr(Choice, "has_been_seen", lambda *_: True)
    monkeypatch.setattr(navigator, "_rng", Fixed(draw))
    navigator.step(OPEN, ORIGIN, DT_S)
    assert (mode_of(navigator), navigator.status.draws) == (mode, draws)
    if then is not None and mode is Mode.TANGENT:
        target = navigator.status.target
        assert target is not None
        assert (target.x_m, target.y_m) == pytest.approx((then.straight.x_m, then.straight.y_m))


def post(d_m: float, bearing_rad: float) -> float:
    """Something at that distance, ahead on the left, and nothing else."""
    return d_m if abs(bearing_rad - 0.9) < 0.1 else math.inf


def test_where_something_is_nearer_than_the_critical_margin_it_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects d_c: under a low roof it stood 13 s with rock at 0.75 m beside, since its target came no nearer."""
    offered(monkeypatch, Way(12.0, Place(-3.0, 0.0, 0.0), Place(-3.0, 0.0, 0.0)))
    blocked: list[bool] = []
    monkeypatch.setattr(Choice, "block_way", lambda *_: blocked.append(True))
    for d_m, ends in ((0.81, False), (0.78, True)):
        navigator = in_boundary(-1, choice="informed", rng=Fixed(0.99))
        navigator.step(beside(-1), ORIGIN, 0.0)
        beside_it = scan_of(functools.partial(post, d_m))
        for i in range(13):
            navigator.step(measurement(beside_it, d_m=d_m, d_bearing_rad=0.9), ORIGIN, DT_S * (i + 1))
        assert bool(blocked) == ends


def test_the_coin_does_not_ask_the_ground_whether_anything_is_left() -> None:
    """Protects the end of a flight by the paper's coin: it searches no ways. What it left out it tells all the same."""
    for choice, knows in (("coin", False), ("frontier", True), ("informed", True)):
        navigator = in_boundary(-1, choice=choice, rng=Fixed(0.99))
        navigator.step(beside(-1), ORIGIN, 0.0)
        assert (navigator.is_way_left(ORIGIN) is not None) is knows
        assert list(navigator.left_out(ORIGIN)), "one look sees the beginning of more"
