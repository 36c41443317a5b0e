"""The numbers of the modes: a wrong one would ask the autopilot for something else."""

from __future__ import annotations

import pytest

from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.modes import mode_name, personality, px4_mode, result_name

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT


@pytest.mark.parametrize(
    ("kind", "custom_mode", "name"),
    [
        (PX4, 0x00060000, "offboard"),
        (PX4, 0x03040000, "hold"),
        (PX4, 0x06040000, "land"),
        (PX4, 0x02040000, "takeoff"),
        (PX4, 0x05040000, "return"),
        (PX4, 0x00030000, "position"),
        (ARDUPILOT, 4, "guided"),
        (ARDUPILOT, 17, "brake"),
        (ARDUPILOT, 9, "land"),
        (ARDUPILOT, 5, "loiter"),
        (ARDUPILOT, 6, "rtl"),
    ],
)
def test_modes_are_named_by_their_numbers_on_the_wire(kind: AutopilotKind, custom_mode: int, name: str) -> None:
    assert mode_name(kind, custom_mode) == name


@pytest.mark.parametrize("kind", list(AutopilotKind))
@pytest.mark.parametrize("custom_mode", [-1, 12345, 2**32 - 1, 0xFF040000])
def test_an_unknown_mode_is_named_by_its_number(kind: AutopilotKind, custom_mode: int) -> None:
    assert mode_name(kind, custom_mode).startswith("mode ")


def test_an_unknown_mode_of_px4_is_named_by_both_its_numbers() -> None:
    assert mode_name(PX4, 12 << 16 | 7 << 24) == "mode 12/7"
    assert mode_name(ARDUPILOT, 99) == "mode 99"


def test_mode_requests_carry_the_measured_parameters() -> None:
    """DO_SET_MODE as measured: (1, 6, 0) is offboard on PX4, (1, 4) guided on ArduPilot."""
    px4, ardupilot = personality(PX4), personality(ARDUPILOT)
    assert px4.set_mode_parameters(px4.offboard) == (1.0, 6.0, 0.0)
    assert px4.set_mode_parameters(px4.hold) == (1.0, 4.0, 3.0)
    assert px4.set_mode_parameters(px4.land) == (1.0, 4.0, 6.0)
    assert ardupilot.set_mode_parameters(ardupilot.offboard) == (1.0, 4.0, 0.0)
    assert ardupilot.set_mode_parameters(ardupilot.hold) == (1.0, 17.0, 0.0)


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_the_modes_that_we_ask_for_differ(kind: AutopilotKind) -> None:
    """Takeover is seen by the mode: two that are alike could not be told apart."""
    ours = personality(kind)
    assert ours.kind is kind
    assert len({ours.offboard, ours.hold, ours.land}) == 3
    assert ours.land not in ours.taking_off


def test_px4_packs_main_and_sub_mode() -> None:
    assert px4_mode(4, 3) == 0x03040000


def test_results_have_names() -> None:
    assert result_name(4) == "failed"
    assert result_name(99) == "result 99"
