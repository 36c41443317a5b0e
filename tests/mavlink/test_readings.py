"""What is read out of the autopilot's messages: modes, the state of its estimator, jumps, texts."""

from __future__ import annotations

import pytest

from companion.mavlink.estimator import ESTIMATOR, estimator_valid, not_known
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavChargeState
from companion.mavlink.modes import mode_name, personality, px4_mode, result_name
from companion.mavlink.position_jump import LONGEST_GAP_S, position_jump_m
from companion.text_table import printable

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


def test_a_charge_is_low_or_worse_but_not_charging() -> None:
    """Protects from flying on a battery that failed, whose number is above "low"."""
    low = {MavChargeState(number) for number in (2, 3, 4, 5, 6)}
    assert {state for state in MavChargeState if state.is_low} == low


def test_results_have_names() -> None:
    assert result_name(4) == "failed"
    assert result_name(99) == "result 99"


# Whether the estimator knows where it is: the flags as the firmwares send them, and each bit that decides.


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
        (831, True),
        (319, True),
        (383, True),
        (165, False),
        (229, False),
    ],
)
def test_attitude_velocities_and_some_position_are_needed(kind: AutopilotKind, flags: int, valid: bool) -> None:
    """Protects from flying on an estimate that is none, and from refusing one that is."""
    assert estimator_valid(kind, flags) is valid


@pytest.mark.parametrize("flags", [1023, 511, 895, 383, 831, 319])
def test_px4_is_valid_at_rest_and_in_the_air(flags: int) -> None:
    """As PX4 sends them: 128 says that it is at rest there. Forbidding it refused every flight and landed the first."""
    assert estimator_valid(PX4, flags)


@pytest.mark.parametrize("flags", [KNOWN | 128, 511, 0x33F | 128])
def test_ardupilot_in_its_constant_position_mode_knows_none(flags: int) -> None:
    """There the same bit says that it flies by no position at all."""
    assert not_known(ARDUPILOT, flags) == ("position",)


@pytest.mark.parametrize(
    ("kind", "flags", "lacking"),
    [
        (PX4, 229, ("horizontal velocity", "position")),
        (PX4, 0, ("attitude", "horizontal velocity", "vertical velocity", "position")),
        (PX4, 1023 | 2048, ("acceleration",)),
        (ARDUPILOT, 0xA7, ("position",)),
        (ARDUPILOT, 0x25, ("horizontal velocity", "position")),
        (ARDUPILOT, 1024, ("attitude", "horizontal velocity", "vertical velocity", "position")),
        (ARDUPILOT, 0x33F, ()),
    ],
)
def test_what_is_not_known_is_named_once(kind: AutopilotKind, flags: int, lacking: tuple[str, ...]) -> None:
    """Protects whoever reads why it does not fly."""
    assert not_known(kind, flags) == lacking


@pytest.mark.parametrize(("kind", "forbidden", "harmless"), [(PX4, 2048, 1024), (ARDUPILOT, 1024, 2048)])
def test_the_bits_that_only_one_firmware_has(kind: AutopilotKind, forbidden: int, harmless: int) -> None:
    """Protects from reading one firmware's bit as the other's: 1024 is a GPS glitch on PX4, no start on ArduPilot."""
    assert not estimator_valid(kind, KNOWN | forbidden)
    assert estimator_valid(kind, KNOWN | harmless)


# Jumps of the position: what flying explains is none.


STANDING = (1.0, 2.0, -3.0, 0.0, 0.0, 0.0)


def test_what_the_velocities_explain_is_no_jump() -> None:
    """The mean of both velocities: a constant acceleration is explained as well."""
    after = (1.0 + 0.5 * 0.8 * 0.5, 2.0, -3.0, 0.8, 0.0, 0.0)
    assert position_jump_m(STANDING, after, 0.5) == pytest.approx(0.0)


@pytest.mark.parametrize("axis", range(3))
def test_the_rest_is_measured_along_every_axis(axis: int) -> None:
    after = tuple(value + (0.7 if i == axis else 0.0) for i, value in enumerate(STANDING))
    assert position_jump_m(STANDING, after, 0.1) == pytest.approx(0.7)  # type: ignore[arg-type]  # of six again


@pytest.mark.parametrize("dt_s", [0.0, -0.1, LONGEST_GAP_S])
def test_over_no_time_or_too_long_a_gap_nobody_can_say(dt_s: float) -> None:
    assert position_jump_m(STANDING, (9.0, 9.0, 9.0, 0.0, 0.0, 0.0), dt_s) == 0.0


# Texts from the wire: nothing in them steers the terminal of whoever reads them.


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Arming denied", "Arming denied"),
        ("\x1b[2J gone", "[2J gone"),
        ("two\nlines\ttab", "two lines tab"),
        ("\u202eright to left", "right to left"),
        ("", ""),
    ],
)
def test_only_what_can_be_printed_is_left_of_a_text(text: str, shown: str) -> None:
    assert printable(text) == shown
