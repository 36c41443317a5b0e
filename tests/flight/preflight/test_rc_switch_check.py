"""The transmitter's switch before a flight: heard, and not on."""

from __future__ import annotations

import pytest

from companion.config.settings import Settings
from companion.flight.preflight import check_names
from companion.flight.preflight.rc_switch_check import RC_SWITCH, check_switch
from tests.autopilot.test_rc_switch import HIGH, LOW, MIDDLE, Transmitter


@pytest.mark.parametrize(
    ("pulse_us", "started", "ok", "found"),
    [
        (LOW, False, True, "stands low"),
        (MIDDLE, False, True, "stands middle"),
        (HIGH, False, False, "stands high"),
        (HIGH, True, True, "stands high"),
        (0, False, False, "not heard: channel 7 is not there, or just being moved"),
        (0, True, False, "not heard: channel 7 is not there, or just being moved"),
    ],
)
def test_a_switch_that_is_on_before_the_start_is_refused(pulse_us: int, started: bool, ok: bool, found: str) -> None:
    """Protects whoever stands beside a vehicle whose switch was left on; after the start it has to be."""
    pilot = Transmitter().stands(pulse_us)
    (result,) = check_switch(pilot.switch, started, pilot.clock.now_s())
    assert (result.name, result.ok, result.found) == (RC_SWITCH, ok, found)
    assert (result.fix == "") is ok


def test_a_transmitter_that_is_off_is_refused_with_the_reason() -> None:
    pilot = Transmitter().stands(LOW).stands(LOW, heard=False)
    (result,) = check_switch(pilot.switch, False, pilot.clock.now_s())
    assert not result.ok
    assert "hears no transmitter" in result.found
    assert "switch the transmitter on" in result.fix


def test_there_is_no_check_without_a_switch() -> None:
    assert check_switch(None, False, 0.0) == ()
    assert RC_SWITCH not in check_names(Settings())
    with_one = Settings.model_validate({"mission": {"rc_switch": {"channel": 8}}})
    assert RC_SWITCH in check_names(with_one)
