"""Whether the estimator knows where it is: the flags as the firmwares send them, and each bit that decides."""

from __future__ import annotations

import pytest

from companion.mavlink.estimator import ESTIMATOR, estimator_valid
from companion.mavlink.firmware import AutopilotKind

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
KNOWN = 1 | 2 | 4 | 8
"""Attitude, both velocities, and a relative position."""


def test_each_firmware_says_it_in_its_own_message() -> None:
    """Protects from waiting for a message that never comes."""
    assert ESTIMATOR == {PX4: "ESTIMATOR_STATUS", ARDUPILOT: "EKF_STATUS_REPORT"}


@pytest.mark.parametrize("kind", [PX4, ARDUPILOT])
@pytest.mark.parametrize(
    ("flags", "valid"),
    [
        (0, False),
        (KNOWN, True),
        (KNOWN - 8 | 16, True),
        (KNOWN | 16, True),
        (KNOWN - 8, False),
        (KNOWN - 1, False),
        (KNOWN - 2, False),
        (KNOWN - 4, False),
        (KNOWN | 32 | 64 | 256 | 512, True),
        (KNOWN | 128, False),
        (831, True),
        (165, False),
    ],
)
def test_attitude_velocities_and_some_position_are_needed(kind: AutopilotKind, flags: int, valid: bool) -> None:
    """Protects from flying on an estimate that is none, and from refusing one that is."""
    assert estimator_valid(kind, flags) is valid


@pytest.mark.parametrize(("kind", "forbidden", "harmless"), [(PX4, 2048, 1024), (ARDUPILOT, 1024, 2048)])
def test_the_bits_that_only_one_firmware_has(kind: AutopilotKind, forbidden: int, harmless: int) -> None:
    """Protects from reading one firmware's bit as the other's: 1024 is a GPS glitch on PX4, no start on ArduPilot."""
    assert not estimator_valid(kind, KNOWN | forbidden)
    assert estimator_valid(kind, KNOWN | harmless)
