"""Tables and numbers of what may pass."""

from __future__ import annotations

import math

import pytest

from companion.gate.allowlist import is_forced, mode_asked_for
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.modes import personality, px4_mode


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_a_mode_is_read_as_it_is_asked_for(kind: AutopilotKind) -> None:
    """Protects the comparison with the modes that may pass: both ways through the same numbers."""
    ours = personality(kind)
    for mode in (ours.offboard, ours.hold, ours.land):
        _, main, sub = ours.set_mode_parameters(mode)
        assert mode_asked_for(kind, {"param2": main, "param3": sub}) == mode


@pytest.mark.parametrize(
    ("main", "sub", "mode"),
    [
        (0.0, 0.0, 0),
        (255.0, 255.0, 255 << 16 | 255 << 24),
        (6.9, 0.9, px4_mode(6)),
        (256.0, 0.0, None),
        (0.0, 256.0, None),
        (-0.5, 0.0, None),
        (4.0, -0.5, None),
        (math.nan, 0.0, None),
        (4.0, math.nan, None),
        (math.inf, 0.0, None),
        (4.0, math.inf, None),
    ],
)
def test_what_is_no_byte_is_no_mode(main: float, sub: float, mode: int | None) -> None:
    """Protects the gate from raising, and from reading another mode than the autopilot."""
    assert mode_asked_for(AutopilotKind.PX4, {"param2": main, "param3": sub}) == mode


@pytest.mark.parametrize(("main", "mode"), [(4.0, 4), (6.9, 6), (255.0, 255), (256.0, None), (math.nan, None)])
def test_ardupilot_has_one_number(main: float, mode: int | None) -> None:
    """Protects the same where the second number means nothing."""
    found = mode_asked_for(AutopilotKind.ARDUPILOT, {"param2": main, "param3": 3.0})
    assert found == mode
    assert not isinstance(found, float)


@pytest.mark.parametrize(("magic", "forced"), [(0.0, False), (21196.0, True), (2989.0, True), (1.0, True)])
def test_any_magic_number_is_force(magic: float, forced: bool) -> None:
    """Protects the autopilot's checks, and the motors in the air, also from magic numbers of other firmware."""
    assert is_forced({"param2": magic}) is forced
