"""What the autopilot knows about where it is: what is missing is named, with what to do about it."""

from __future__ import annotations

from typing import Any

import pytest

from companion.autopilot.vehicle_state import VehicleState
from companion.config.autopilot import AutopilotSettings
from companion.flight.preflight.position import estimator, standing
from companion.flight.preflight.result import CheckResult
from companion.mavlink.estimator import estimator_valid
from companion.mavlink.firmware import AutopilotKind

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT


def state(kind: AutopilotKind = PX4, flags: int | None = 511, **changes: Any) -> VehicleState:
    """A vehicle that stands on the ground."""
    well: dict[str, Any] = {
        "armed": False,
        "mode": "hold",
        "landed": True,
        "battery_percent": 80.0,
        "heartbeat_age_s": 0.5,
        "pose_age_s": 0.03,
        "position_valid": flags is not None and estimator_valid(kind, flags),
        "version": "1.17.0",
        "estimator_flags": flags,
    }
    return VehicleState(**(well | changes))


def looked_at(kind: AutopilotKind, flags: int | None, gps: bool = False, **changes: Any) -> CheckResult:
    return estimator(kind, state(kind, flags, **changes), AutopilotSettings(gps=gps))


@pytest.mark.parametrize("flags", [1023, 511, 895, 383, 831, 319])
def test_px4_that_knows_where_it_is_passes_at_rest_and_in_the_air(flags: int) -> None:
    """Protects every flight on PX4: with the bit that says "at rest" forbidden it never flew."""
    result = looked_at(PX4, flags)
    assert result.ok
    assert f"flags {flags}" in result.found
    assert result.fix == ""


@pytest.mark.parametrize(
    ("kind", "flags", "gps", "found", "fix"),
    [
        (PX4, 229, False, "horizontal velocity and position are not known (flags 229)", "EKF2_EV_CTRL"),
        (PX4, 165, False, "horizontal velocity and position are not known (flags 165)", "sends ODOMETRY"),
        (PX4, 229, True, "horizontal velocity and position are not known (flags 229)", "autopilot.gps: false"),
        (ARDUPILOT, 0x25, False, "horizontal velocity and position are not known (flags 37)", "VISO_TYPE"),
        (ARDUPILOT, 0xA7, True, "position is not known (flags 167)", "no fix"),
        (PX4, 511 - 4, False, "vertical velocity is not known (flags 507)", "EKF2_HGT_REF"),
        (ARDUPILOT, 0x33F - 4, False, "vertical velocity is not known (flags 827)", "EK3_SRC1_POSZ"),
        (ARDUPILOT, 1024, True, "attitude, horizontal velocity, vertical velocity and position are not", "level"),
        (PX4, 511 | 2048, False, "acceleration is not known (flags 2559)", "calibrate"),
        (PX4, None, False, "no ESTIMATOR_STATUS comes", "look at the link"),
        (ARDUPILOT, None, False, "no EKF_STATUS_REPORT comes", "look at the link"),
    ],
)
def test_what_is_missing_is_said_with_what_to_do_and_nobody_is_told_to_wait(
    kind: AutopilotKind, flags: int | None, gps: bool, found: str, fix: str
) -> None:
    """Protects whoever stands beside it: "wait until it has settled" was said for ever."""
    result = looked_at(kind, flags, gps)
    assert result.failed
    assert found in result.found
    assert fix in result.fix
    assert "wait" not in result.fix


def test_a_good_estimate_that_comes_late_is_the_links_fault() -> None:
    result = looked_at(PX4, 511, pose_age_s=0.6)
    assert result.failed
    assert "0.60 s old" in result.found
    assert "late" in result.fix


@pytest.mark.parametrize(
    ("speed_mps", "ok", "found"),
    [
        (0.02, True, "it says to move at 0.02 m/s"),
        (0.11, False, "it says to move at 0.11 m/s"),
        (None, False, "its velocity is not known"),
    ],
)
@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_an_autopilot_that_stands_and_says_that_it_moves_does_not_fly(
    kind: AutopilotKind, speed_mps: float | None, ok: bool, found: str
) -> None:
    """Protects every stop: with a velocity that is wrong by 0.11 m/s the real one drifted into walls."""
    result = standing(kind, state(kind, speed_mps=speed_mps))
    assert (result.ok, result.found) == (ok, found)
    assert ("EKF2_ACC_NOISE" in result.fix) == (not ok and kind is PX4)
