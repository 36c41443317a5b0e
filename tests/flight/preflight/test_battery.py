"""The battery before a flight: what it has left, and that its end will be noticed."""

from __future__ import annotations

from typing import Any

import pytest

from companion.config.mission import MissionSettings
from companion.flight.preflight.battery import battery
from companion.flight.preflight.result import CheckResult
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavChargeState
from tests.autopilot.fake_link import FakeLink
from tests.flight.preflight.test_position import state
from tests.shared.clocks import HandClock

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
FULL = {"battery_percent": 100.0, "voltage_v": 12.6, "charge_state": MavChargeState.OK}


async def looked_at(
    kind: AutopilotKind, low_volt: float | None = 10.5, low_v: float | None = None, silent: bool = False, **found: Any
) -> CheckResult:
    """The check of a battery of three cells, unless it is another."""
    link = FakeLink(HandClock(), kind)
    if low_volt is not None:
        link.params["BATT_LOW_VOLT"] = low_volt
    if silent:
        link.silent_params = {"BATT_LOW_VOLT"}
    return await battery(link, state(kind, 511, **(FULL | found)), MissionSettings(battery_low_v=low_v))


@pytest.mark.parametrize("kind", list(AutopilotKind))
async def test_percent_voltage_and_charge_are_shown(kind: AutopilotKind) -> None:
    result = await looked_at(kind)
    assert result.ok
    assert result.found == "100 %, 12.6 V, charge ok"
    assert result.fix == ""
    assert ("100 % means nothing" in result.reason) == (kind is ARDUPILOT)


@pytest.mark.parametrize(
    ("found", "fix"),
    [
        ({"battery_percent": 20.0}, "charge it"),
        ({"charge_state": MavChargeState.LOW}, "charge it"),
        ({"charge_state": MavChargeState.FAILED}, "charge it"),
        ({"battery_percent": None}, "let the autopilot measure it"),
        ({"low_v": 11.0, "voltage_v": 10.9}, "charge it"),
        ({"low_v": 11.0, "voltage_v": None}, "let the autopilot measure it"),
    ],
)
@pytest.mark.parametrize("kind", list(AutopilotKind))
async def test_one_that_would_end_the_flight_at_once_begins_none(
    kind: AutopilotKind, found: dict[str, Any], fix: str
) -> None:
    """At 100 % too: the autopilot's own judgement and the voltage count besides the percentage."""
    result = await looked_at(kind, **found)
    assert result.failed
    assert result.fix == fix


@pytest.mark.parametrize(
    ("low_volt", "low_v", "voltage_v", "fix"),
    [
        (0.0, None, 12.6, "set BATT_LOW_VOLT or mission.battery_low_v to about 3.5 V a cell"),
        (None, None, 12.6, "set BATT_LOW_VOLT or mission.battery_low_v to about 3.5 V a cell"),
        (10.5, None, 25.2, "BATT_LOW_VOLT 10.5 V is for a battery with fewer cells than this one; set"),
        (0.0, 10.5, 25.2, "mission.battery_low_v 10.5 V is for a battery with fewer cells than this one; set"),
        (0.0, 10.5, 12.6, ""),
        (21.0, None, 25.2, ""),
        (21.0, 10.5, 25.2, ""),
        (10.5, None, None, ""),
    ],
)
async def test_ardupilot_needs_a_voltage_that_ends_the_flight(
    low_volt: float | None, low_v: float | None, voltage_v: float | None, fix: str
) -> None:
    """Its percent begins at 100 at each boot; its own default of 10.5 V is for three cells and never comes with six."""
    result = await looked_at(ARDUPILOT, low_volt, low_v, voltage_v=voltage_v)
    assert result.ok == (fix == "")
    assert result.fix.startswith(fix)


async def test_px4_that_knows_its_cells_is_not_asked_for_a_voltage() -> None:
    assert (await looked_at(PX4, low_volt=None)).ok


async def test_a_threshold_that_cannot_be_read_is_not_known_to_be_there() -> None:
    result = await looked_at(ARDUPILOT, silent=True)
    assert result.failed
    assert result.fix.startswith("BATT_LOW_VOLT is not known")
