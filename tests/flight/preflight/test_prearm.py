"""What the autopilot itself has against being armed is waited for, and told in its own words."""

from __future__ import annotations

import pytest

from companion.autopilot.telemetry import Telemetry
from companion.autopilot.vehicle_state import PrearmState, StatusText
from companion.config.settings import Settings
from companion.flight.events import EventEmitter, console
from companion.flight.preflight.prearm import prearm, reasons
from companion.flight.preflight.ready import until_ready
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd
from tests.autopilot.fake_link import FakeLink
from tests.flight.preflight.test_position import state
from tests.shared.clocks import HandClock

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
BIT = 1 << 28
TEXTS = (
    StatusText(80.0, 2, "PreArm: Accels inconsistent"),
    StatusText(90.0, 2, "PreArm: Gyros inconsistent"),
    StatusText(90.1, 2, "PreArm: AHRS: waiting for home"),
    StatusText(90.2, 6, "EKF3 IMU0 is using external nav data"),
    StatusText(90.3, 2, "PreArm: Gyros inconsistent"),
)


@pytest.mark.parametrize(
    ("found", "ok", "said"),
    [
        (PrearmState.PASSED, True, "it can be armed"),
        (PrearmState.FAILING, False, "it would refuse to arm: Gyros inconsistent; AHRS: waiting for home"),
        (PrearmState.OFF, False, "its arming checks are off"),
        (PrearmState.UNKNOWN, False, "not told"),
    ],
)
def test_ardupilot_has_to_say_that_it_can_be_armed(found: PrearmState, ok: bool, said: str) -> None:
    """Protects whoever has stepped back from a vehicle that then refuses; unknown is not passed."""
    result = prearm(ARDUPILOT, state(ARDUPILOT, 0x33F, prearm=found), TEXTS, 100.0)
    assert (result.ok, result.found) == (ok, said)
    assert (result.fix == "") == ok


@pytest.mark.parametrize("found", list(PrearmState))
def test_px4_says_it_of_the_mode_that_it_is_in_so_it_is_shown_only(found: PrearmState) -> None:
    """Protects the take-off without GPS: it arms in offboard, and the bit speaks of hold, which it may not have."""
    result = prearm(PX4, state(prearm=found), TEXTS, 100.0)
    assert result.ok
    assert result.found == f"{found.value} (in the mode hold)"


def test_reasons_that_are_over_are_not_told() -> None:
    """It says all of them together; what it no longer says, or said long ago, no longer holds."""
    assert reasons(TEXTS, 100.0) == ("Gyros inconsistent", "AHRS: waiting for home")
    assert reasons(TEXTS, 130.0) == ()
    assert reasons((), 100.0) == ()


@pytest.mark.parametrize(
    ("kind", "enabled", "health", "found"),
    [
        (ARDUPILOT, BIT, BIT, PrearmState.PASSED),
        (ARDUPILOT, BIT | 1, 1, PrearmState.FAILING),
        (ARDUPILOT, 1, BIT, PrearmState.OFF),
        (PX4, 0, BIT, PrearmState.PASSED),
        (PX4, 0, 0, PrearmState.FAILING),
        (ARDUPILOT, None, BIT, PrearmState.UNKNOWN),
        (ARDUPILOT, BIT, None, PrearmState.UNKNOWN),
    ],
)
def test_the_bit_is_read_of_sys_status(
    kind: AutopilotKind, enabled: int | None, health: int | None, found: PrearmState
) -> None:
    clock = HandClock()
    link = FakeLink(clock, kind)
    telemetry = Telemetry(link, clock, Settings())
    fields = {"onboard_control_sensors_enabled": enabled, "onboard_control_sensors_health": health}
    link.deliver("SYS_STATUS", fields)
    assert telemetry.state(clock.now_s()).prearm is found
    clock.advance(4.0)
    assert telemetry.state(clock.now_s()).prearm is PrearmState.UNKNOWN, "stale is not fresh"


@pytest.mark.parametrize(
    ("kind", "armable_s", "least_s", "most_s"),
    [(ARDUPILOT, 21.0, 20.5, 23.0), (ARDUPILOT, 1e9, 59.0, 62.0), (PX4, 1e9, 0.0, 3.0)],
)
async def test_an_autopilot_that_knows_its_place_long_before_it_can_be_armed_is_waited_for(
    kind: AutopilotKind, armable_s: float, least_s: float, most_s: float
) -> None:
    """ArduCopter without GPS knew its position 3 s after its start and could be armed after 21."""
    clock = HandClock()
    link = FakeLink(clock, kind)
    telemetry = Telemetry(link, clock, Settings())
    began_s = clock.now_s()
    lines: list[str] = []

    def live(by_s: float) -> None:
        clock.advance(by_s)
        armable = clock.now_s() - began_s > armable_s
        link.deliver("EKF_STATUS_REPORT" if kind is ARDUPILOT else "ESTIMATOR_STATUS", {"flags": 0x33F})
        bits = {"onboard_control_sensors_enabled": BIT, "onboard_control_sensors_health": BIT if armable else 0}
        link.deliver("SYS_STATUS", bits)

    clock.pass_by = live
    settings = Settings().autopilot
    await until_ready(link, telemetry, settings, clock, EventEmitter(console(lines.append)))
    assert least_s <= clock.now_s() - began_s <= most_s
    asked = [one for one in link.sent_named("COMMAND_LONG") if one["command"] == MavCmd.RUN_PREARM_CHECKS]
    if kind is ARDUPILOT:
        assert lines == ["waiting for the autopilot's own checks before arming, up to 60 s"]
        assert len(asked) >= 4, "its reasons, without waiting 30 s for them"
    else:
        assert (lines, asked) == ([], [])
