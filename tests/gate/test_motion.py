"""What the autopilot's own words of its movement are believed."""

from __future__ import annotations

import math

import pytest

from companion.gate.motion import LARGEST_M, Motion
from companion.gate.vehicle import Vehicle
from companion.model import ABSURD
from tests.gate.built import PLAN

STILL = {"x": 0.0, "y": 0.0, "z": 0.0, "vx": 0.0, "vy": 0.0, "vz": 0.0}


def moved(stamp_s: float, **changes: float) -> dict[str, float]:
    return STILL | {"time_boot_ms": 1e3 * stamp_s} | changes


def test_nothing_is_known_before_it_is_told() -> None:
    """Protects against defaults: no place, no heading, no speed, never fresh."""
    motion = Motion(0.5)
    assert motion.place_m is None
    assert motion.forward_right_mps() is None
    assert motion.after(1.0, 0.0, 0.0) is None
    assert motion.frozen_for_s() == 0.0
    assert motion.fresh_s == -math.inf
    motion.position(moved(1.0), 10.0, armed=True)
    motion.attitude({"yaw": math.nan})
    assert motion.forward_right_mps() is None
    assert motion.place_m == (0.0, 0.0, 0.0)


def test_forward_is_along_the_heading() -> None:
    """Protects the frames: north-east-down, headings clockwise from north."""
    motion = Motion(0.5)
    motion.attitude({"yaw": math.pi / 2.0})
    motion.position(moved(1.0, vx=0.3, vy=0.4), 10.0, armed=True)
    assert motion.forward_right_mps() == pytest.approx((0.4, -0.3))
    assert motion.after(2.0, 0.5, -1.0) == pytest.approx((-0.5, 2.0, -1.0))
    motion.attitude({"yaw": 0.0})
    assert motion.after(2.0, 0.5, -1.0) == (2.0, 0.5, -1.0)
    assert motion.forward_right_mps() == (0.3, 0.4)
    lost = Motion(0.5)
    lost.attitude({"yaw": 0.0})
    assert lost.after(2.0, 0.5, -1.0) is None, "a heading alone is no place"
    assert lost.forward_right_mps() is None
    lost.position(moved(0.0), 10.0, armed=True)
    assert lost.place_m == (0.0, 0.0, 0.0), "also with the first stamp of all"


def test_a_jump_is_what_no_velocity_explains() -> None:
    """Protects fast flight from being taken for a jump, and finds one that is small but for its time."""
    motion = Motion(0.5)
    motion.position(moved(1.0, vx=10.0), 10.0, armed=True)
    motion.position(moved(1.1, x=1.0, vx=10.0), 10.1, armed=True)
    assert motion.jumped_s == -math.inf
    motion.position(moved(1.2, x=1.4, vx=10.0), 10.2, armed=True)
    assert motion.jumped_s == 10.2
    motion.position(moved(1.3, x=2.4, vx=10.0, z=0.45), 10.3, armed=True)
    assert motion.jumped_s == 10.2, "what is left of it is within the limit"
    motion.position(moved(2.4, x=90.0), 11.4, armed=True)
    assert motion.jumped_s == 10.2, "over a long gap nobody can say; the age does"


def test_old_stamps_are_no_news_in_flight() -> None:
    """Protects against what was measured before and comes again; on the ground an autopilot may have started anew."""
    motion = Motion(0.5)
    motion.position(moved(5.0), 10.0, armed=True)
    for stamp_s in (5.0, 4.9, 0.1):
        motion.position(moved(stamp_s, x=1.0), 11.0, armed=True)
        assert motion.fresh_s == 10.0
    motion.position(moved(4.5), 11.0, armed=False)
    assert motion.fresh_s == 10.0
    motion.position(moved(0.1), 11.0, armed=False)
    assert motion.fresh_s == 11.0


@pytest.mark.parametrize("name", ["x", "y", "z", "vx", "vy", "vz"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -2e6])
def test_what_is_no_number_is_no_news(name: str, value: float) -> None:
    """Protects everything behind it from numbers that no flight has."""
    motion = Motion(0.5)
    motion.position(moved(1.0), 10.0, armed=True)
    motion.position(moved(1.1, **{name: value}), 10.1, armed=True)
    assert motion.fresh_s == 10.0
    assert motion.place_m == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_jump_is_judged_against_the_mean_velocity_on_each_axis(axis: str) -> None:
    """Protects a vehicle that speeds up or brakes: the way between two positions is that of the mean of two speeds."""
    for before_mps, after_mps, way_m, jumps in (
        (0.0, 8.0, 2.0, False),
        (0.0, 8.0, 2.5, False),
        (0.0, 8.0, 2.5625, True),
        (8.0, 0.0, 1.4375, True),
        (-4.0, -4.0, -2.0, False),
        (0.0, 0.0, -0.5, False),
        (0.0, 0.0, -0.5625, True),
    ):
        motion = Motion(0.5)
        motion.position(moved(2.0, **{axis: 16.0, f"v{axis}": before_mps}), 10.0, armed=True)
        motion.position(moved(2.5, **{axis: 16.0 + way_m, f"v{axis}": after_mps}), 10.5, armed=True)
        assert (motion.jumped_s == 10.5) is jumps


def test_a_jump_is_judged_over_a_short_time_only() -> None:
    """Protects from calling a jump what happened while nobody looked: its age says so instead."""
    for gap_s, jumps in ((0.5, True), (0.9375, True), (1.0, False), (1.5, False)):
        motion = Motion(0.5)
        motion.position(moved(2.0), 10.0, armed=True)
        motion.position(moved(2.0 + gap_s, x=4.0), 10.0 + gap_s, armed=True)
        assert (motion.jumped_s > 0.0) is jumps
    motion.position(moved(1.0, x=50.0), 20.0, armed=False)
    assert motion.fresh_s == 20.0
    assert motion.jumped_s == -math.inf, "an autopilot that started anew has its place anew"


def test_how_far_back_a_stamp_means_a_restart() -> None:
    """Protects from old packets on the ground as well: only a second back is a new beginning."""
    for back_s, anew in ((0.0, False), (0.9375, False), (1.0, True), (1.5, True)):
        motion = Motion(0.5)
        motion.position(moved(8.0), 10.0, armed=False)
        motion.position(moved(8.0 - back_s), 11.0, armed=False)
        assert (motion.fresh_s == 11.0) is anew
        motion.position(moved(8.0 - back_s + 0.5), 12.0, armed=False)
        assert (motion.fresh_s == 12.0) is (anew or back_s < 0.5)


def test_a_thousand_kilometres_are_too_far() -> None:
    """Protects the arithmetic behind it: at the bound it is no place, below it is."""
    motion = Motion(0.5)
    motion.position(moved(1.0, x=1e6), 10.0, armed=True)
    motion.attitude({"yaw": 1e6})
    motion.attitude({"yaw": -2e6})
    assert motion.after(0.0, 0.0, 0.0) is None
    motion.position(moved(1.0, x=-999_999.0), 10.0, armed=True)
    assert motion.after(0.0, 0.0, 0.0) is None, "without a heading nobody knows where ahead is"
    assert motion.forward_right_mps() is None
    motion.attitude({"yaw": 0.0})
    assert motion.after(0.0, 0.0, 0.0) == (-999_999.0, 0.0, 0.0)
    motion.attitude({"yaw": math.nan})
    assert motion.after(1.0, 0.0, 0.0) == (-999_998.0, 0.0, 0.0), "what it does not say now it said before"


def test_frozen_is_every_number_to_the_last_bit() -> None:
    """Protects a vehicle that hovers very still: one number that trembles is enough to live."""
    motion = Motion(0.5)
    for i in range(50):
        motion.position(moved(0.1 * i, vz=1e-6 * (i % 2)), 0.1 * i, armed=True)
    assert motion.frozen_for_s() == 0.0
    for i in range(50, 56):
        motion.position(moved(0.1 * i, vz=1e-6), 0.1 * i, armed=True)
    assert motion.frozen_for_s() == pytest.approx(0.6)
    motion.position(moved(5.5, vz=0.0), 9.0, armed=True)
    assert motion.frozen_for_s() == pytest.approx(0.6), "what comes late says nothing"


def test_a_vehicle_begins_anew_before_anything_was_heard() -> None:
    """Protects the very start, before the first heartbeat."""
    vehicle = Vehicle(PLAN.thresholds)
    vehicle.reset()
    assert (vehicle.armed, vehicle.airborne, vehicle.taken_over, vehicle._mode_monitor.mode) == (
        False,
        False,
        None,
        None,
    )
    vehicle.on_command_sent(176, {"param2": math.nan, "param3": 0.0}, 191)
    assert vehicle.asked_modes == frozenset()


def test_what_is_absurd_is_so_on_both_sides() -> None:
    """The gate has the number for itself, because it may not import numpy."""
    assert LARGEST_M == ABSURD
