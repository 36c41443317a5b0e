"""Odometry on its way to the autopilot: what repeats itself or leaps is worse than none."""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.gate.odometry import FASTEST_MPS, Odometry
from tests.gate.built import PLAN, Air, frame, in_the_air

JUMP_M = PLAN.thresholds.pose_jump_m


def place(x: float = 0.0, y: float = 0.0, z: float = 0.0, frame_number: int = 0) -> dict[str, Any]:
    return {"x": x, "y": y, "z": z, "reset_counter": frame_number}


@pytest.mark.parametrize("name", ["x", "y", "z"])
def test_what_repeats_itself_is_none(name: str) -> None:
    """Protects from a tracker that hangs and goes on sending: both autopilots ran away by it."""
    odometry = Odometry(JUMP_M)
    assert odometry.fresh_s == -math.inf
    odometry.on_place("ODOMETRY", place(), 64.0)
    odometry.on_place("ODOMETRY", place(), 65.0)
    assert (odometry.believed, odometry.fresh_s) == (False, 64.0)
    odometry.on_place("ODOMETRY", place() | {name: 1e-9}, 66.0)
    assert (odometry.believed, odometry.fresh_s) == (True, 66.0)
    for value in (math.nan, math.inf):
        odometry.on_place("ODOMETRY", place() | {name: value}, 67.0)
        assert (odometry.believed, odometry.fresh_s) == (False, 66.0), "nor is one that says no number"


def test_a_leap_that_nobody_announced_is_believed_no_more() -> None:
    """Protects from a tracker that has lost itself: PX4 flew a metre after it."""
    odometry = Odometry(JUMP_M)
    odometry.on_place("ODOMETRY", place(), 64.0)
    odometry.on_place("ODOMETRY", place(JUMP_M + 0.25 * FASTEST_MPS), 64.25)
    assert odometry.believed, "a fast flight over a gap is none"
    odometry.on_place("ODOMETRY", place(5.0), 64.5)
    odometry.on_place("ODOMETRY", place(5.001), 64.53125)
    assert (odometry.believed, odometry.fresh_s) == (False, 64.25), "the next one is near, and as lost"
    odometry.on_place("ODOMETRY", place(5.002, frame_number=1), 64.5625)
    assert odometry.believed, "it says that it begins anew"


def test_a_leap_that_is_announced_is_the_autopilots_business() -> None:
    """Protects a tracker that corrects itself as MAVLink has it: the autopilot moves its estimate along."""
    odometry = Odometry(JUMP_M)
    odometry.on_place("ODOMETRY", place(), 64.0)
    odometry.on_place("ODOMETRY", place(9.0, frame_number=1), 64.0625)
    assert odometry.believed


def test_a_new_flight_misses_nothing_that_never_came_in_it() -> None:
    """Protects a flight without odometry through the gate from the one before, which had it."""
    odometry = Odometry(JUMP_M)
    odometry.on_place("ODOMETRY", place(), 64.0)
    odometry.on_place("ODOMETRY", place(9.0), 64.0625)
    odometry.reset()
    assert (odometry.believed, odometry.fresh_s) == (True, -math.inf)
    odometry.on_place("ODOMETRY", place(), 66.0)
    assert odometry.fresh_s == 66.0, "the same place is news again"


def feed(air: Air, name: str, **fields: Any) -> bool:
    return air.gate.on_attached_message(frame(name, 197, **fields), "odometry", air.now_s)


@pytest.mark.parametrize("name", ["ODOMETRY", "VISION_POSITION_ESTIMATE"])
def test_the_autopilot_is_not_told_what_is_not_believed(name: str) -> None:
    """Protects from the runaway: told nothing the autopilot brakes; and where it stands on the ground all passes."""
    ground = Air()
    assert [feed(ground, name, x=1.0) for _ in range(2)] == [True, True], "a tracker at rest may well repeat itself"
    air = in_the_air()
    assert [feed(air, name, x=1.0) for _ in range(2)] == [True, False]
    assert not feed(air, "VISION_SPEED_ESTIMATE"), "its velocity is as old"
    assert feed(air, "HEARTBEAT"), "that the tracker lives may be known"
    assert air.gate.counts["attached: odometry that repeats itself or leaps"] == 2
    assert feed(air, name, x=1.5)
    assert feed(air, "VISION_SPEED_ESTIMATE")


def test_the_gate_carries_odometry_while_anybody_flies_by_it() -> None:
    """Protects the vehicle that its pilot has taken: when the application ends, the gate keeps its eyes open."""
    air = in_the_air()
    carries = [air.gate.carries_odometry]
    feed(air, "ODOMETRY", x=1.0)
    air.mode = air.ours.hold
    air.heartbeat()
    carries.append(air.gate.carries_odometry)
    air.armed = False
    air.heartbeat()
    carries.append(air.gate.carries_odometry)
    assert carries == [False, True, False], "none passed at first, and on the ground it is nobody's eyes"
