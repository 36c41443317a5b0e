"""What a single setpoint may be, to the last digit."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from companion.gate.geofence import excess_m
from companion.gate.plan import Geofence, Limits
from companion.gate.setpoint_limits import LONGEST_S, SLACK_MPS, UNUSED, Unreadable, VelocitySetpoint, beyond, read

LIMITS = Limits(speed_mps=2.0, climb_mps=1.5, yaw_rate_radps=0.5, accel_mps2=2.0)
PERIOD_S = 0.125
FIELDS: dict[str, Any] = {
    "target_system": 3,
    "target_component": 1,
    "coordinate_frame": 8,
    "type_mask": 0x5C7,
    "vx": 0.1,
    "vy": 0.2,
    "vz": 0.3,
    "yaw_rate": 0.4,
} | dict.fromkeys(UNUSED, 0.0)


def asked(
    vx: float = 0.0, vy: float = 0.0, vz: float = 0.0, yaw_rate: float = 0.0, t_s: float = 10.0
) -> VelocitySetpoint:
    return VelocitySetpoint(t_s, vx, vy, vz, yaw_rate)


def why_not(new: VelocitySetpoint, before: VelocitySetpoint | None) -> str | None:
    return beyond(new, before, LIMITS, PERIOD_S)


def test_a_setpoint_is_read_as_it_is() -> None:
    """Protects the axes from being mixed up, and the time."""
    assert read(FIELDS, 3, 7.5) == VelocitySetpoint(7.5, 0.1, 0.2, 0.3, 0.4)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"target_system": 4}, "for 4/1"),
        ({"target_component": 2}, "for 3/2"),
        ({"coordinate_frame": 9}, "in frame 9"),
        ({"type_mask": 0x5C6}, "with type mask 1478"),
        *(({name: math.nan}, "not finite") for name in ("vx", "vy", "vz", "yaw_rate", *UNUSED)),
        ({"vx": -math.inf}, "not finite"),
    ],
)
def test_what_cannot_be_meant_is_said(changes: dict[str, float], words: str) -> None:
    """Protects against a setpoint for somebody else, in another frame, or with a number that is none, in any field."""
    assert read(FIELDS | changes, 3, 7.5) == Unreadable(words)


@pytest.mark.parametrize("moved", [asked(0.1), asked(0.0, -0.1), asked(0.0, 0.0, 0.1), asked(yaw_rate=-0.1)])
def test_any_movement_is_movement(moved: VelocitySetpoint) -> None:
    """Protects the rule that only a standstill passes without a look ahead."""
    assert not moved.stands_still
    assert asked().stands_still


def test_speed_is_in_the_plane() -> None:
    """Protects the limit of the speed from being kept for each axis alone."""
    assert asked(3.0, -4.0, 12.0).speed_mps == 5.0


BEFORE = asked(1.875, 0.0, 1.375, 0.5, t_s=9.75)


@pytest.mark.parametrize(
    ("new", "before", "words"),
    [
        (asked(2.0), BEFORE, None),
        (asked(2.01), BEFORE, "speed 2.01 m/s"),
        (asked(-1.2, 1.7), asked(-1.2, 1.7), "speed 2.08 m/s"),
        (asked(vz=1.5), BEFORE, None),
        (asked(vz=1.51), BEFORE, "climb 1.51 m/s"),
        (asked(vz=-1.51), asked(vz=-1.5), "climb 1.51 m/s"),
        (asked(yaw_rate=-0.5), BEFORE, None),
        (asked(yaw_rate=0.51), BEFORE, "yaw 0.51 rad/s"),
        (asked(yaw_rate=-0.51), BEFORE, "yaw 0.51 rad/s"),
    ],
)
def test_limits_are_kept_and_may_be_used(new: VelocitySetpoint, before: VelocitySetpoint, words: str | None) -> None:
    """Protects each limit from both sides: at it passes, above it does not, whichever the direction."""
    assert why_not(new, before) == words


@pytest.mark.parametrize(("since_s", "most_mps"), [(0.0, 0.27), (0.0625, 0.27), (0.25, 0.52), (0.5, 1.02), (3.0, 1.02)])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_velocity_grows_no_faster_than_allowed(axis: int, since_s: float, most_mps: float) -> None:
    """Protects against jumps: two that come at once count as a period apart, and a long pause allows no leap."""
    for old_mps, sign in ((0.0, 1.0), (0.25, 1.0), (-0.25, -1.0), (-0.25, 1.0), (0.25, -1.0)):
        kept_mps = abs(old_mps) if old_mps * sign > 0.0 else 0.0
        old, may, may_not = [0.0] * 3, [0.0] * 3, [0.0] * 3
        old[axis] = old_mps
        may[axis], may_not[axis] = sign * (kept_mps + most_mps - 0.002), sign * (kept_mps + most_mps + 0.002)
        before = replace(asked(*old), t_s=10.0 - since_s)
        assert why_not(asked(*may), before) is None
        assert why_not(asked(*may_not), before) == f"jumps by {most_mps:.2f} m/s"


def test_after_a_pause_it_starts_from_standing() -> None:
    """Protects the first setpoint: nothing before it makes it larger."""
    most_mps = LIMITS.accel_mps2 * LONGEST_S + SLACK_MPS
    for axis in range(3):
        may, may_not = [0.0] * 3, [0.0] * 3
        may[axis], may_not[axis] = most_mps, most_mps + 0.002
        assert why_not(asked(*may), None) is None, "as much as is allowed may be used"
        assert why_not(asked(*may_not), None) == "jumps by 1.02 m/s"


def test_to_stop_is_always_allowed() -> None:
    """Protects braking, and what turns round: it has stood in between."""
    for old in (asked(2.0, t_s=10.0), asked(-2.0, t_s=10.0)):
        assert why_not(asked(), old) is None
        assert why_not(asked(math.copysign(0.2, -old.vx_mps)), old) is None


# How far a place is outside.


BOX = Geofence(north_m=(-8.0, 4.0), east_m=(-2.0, 1.0), down_m=(-3.0, 0.5))


def test_nothing_fenced_is_everywhere_inside() -> None:
    """Protects flights without a fence."""
    assert excess_m(Geofence(), 1e6, -1e6, 1e6) == -math.inf


@pytest.mark.parametrize(
    ("place_m", "expected_m"),
    [
        ((0.0, 0.0, -1.0), -1.0),
        ((4.0, 0.0, -1.0), 0.0),
        ((5.5, 0.0, -1.0), 1.5),
        ((-9.0, 0.0, -1.0), 1.0),
        ((0.0, 1.25, -1.0), 0.25),
        ((0.0, -2.5, -1.0), 0.5),
        ((0.0, 0.0, -3.75), 0.75),
        ((0.0, 0.0, 1.0), 0.5),
        ((5.0, 1.5, 2.5), 2.0),
    ],
)
def test_each_side_of_the_box(place_m: tuple[float, float, float], expected_m: float) -> None:
    """Protects every wall of the fence; of several the one that is passed furthest counts."""
    assert excess_m(BOX, *place_m) == expected_m


def test_the_radius_is_about_the_origin_and_in_the_plane() -> None:
    """Protects the cylinder: height does not count, and both directions do."""
    round_m = Geofence(radius_m=5.0)
    assert excess_m(round_m, 3.0, 4.0, -100.0) == 0.0
    assert excess_m(round_m, -6.0, 8.0, 0.0) == 5.0
    assert excess_m(round_m, 0.0, 0.0, 0.0) == -5.0
    assert excess_m(Geofence(north_m=(-8.0, 4.0), radius_m=5.0), 0.0, 7.0, 0.0) == 2.0
