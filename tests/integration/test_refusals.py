"""An autopilot that refuses to arm, and parameters that it does not have or does not take."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from companion.autopilot.interface import LinkError
from companion.autopilot.vehicle import FlightError
from companion.flight.preflight.parameter_check import check_rule
from companion.flight.preflight.parameter_rules import rules
from tests.integration.rig import Aboard, Stage, aboard, both, fly_all

NEVER_S = 300.0
REASON = {"px4": "Arming denied: Resolve system health failures first", "ardupilot": "Arm: System not initialised"}
INTEGER = {"px4": "COM_OBL_RC_ACT", "ardupilot": "AVOID_ENABLE"}
FLOAT = {"px4": "COM_OF_LOSS_T", "ardupilot": "GUID_TIMEOUT"}
FAILSAFES = {"px4": {"COM_OF_LOSS_T", "COM_OBL_RC_ACT"}, "ardupilot": {"GUID_TIMEOUT", "AVOID_ENABLE"}}


@pytest.mark.flight
@pytest.mark.timeout(100)
async def test_what_the_autopilot_refuses_is_told_in_its_own_words_and_nothing_is_armed(tmp_path: Path) -> None:
    """Protects the person on the ground, who must see why, and the flight that must not begin half configured."""
    with both(tmp_path, boot_s=NEVER_S, parameters=()) as stages:
        await fly_all(stages, _refused)


async def _refused(ours: Stage) -> None:
    personality, relay, witness = ours.personality, ours.relay, ours.witness
    async with aboard(ours.port) as flight:
        async with flight.vehicle as vehicle:
            # Both at once, as neither may wait for the other's answers.
            taking_off = asyncio.create_task(vehicle.take_off(1.5, flight.height_m))
            await _parameters(personality, flight)
            with pytest.raises(FlightError, match="refuses to arm") as refusal:
                await taking_off
            assert REASON[personality] in str(refusal.value), "its own words, whole"
            assert await flight.stream(0.2) == 0, "and no setpoint goes to a vehicle that is not flying"
        relay.dead = True
        with pytest.raises(LinkError, match="did not answer a question for parameter"):
            await flight.link.get_param(FLOAT[personality])
    assert not witness.ever_armed
    assert relay.seen.setpoints() == []


async def _parameters(personality: str, flight: Aboard) -> None:
    link, whole, real = flight.link, INTEGER[personality], FLOAT[personality]
    assert await link.get_param("NO_SUCH_PARAM") is None
    with pytest.raises(LinkError, match="has no parameter NO_SUCH_TOO"):
        await link.set_param("NO_SUCH_TOO", 1)
    with pytest.raises(LinkError, match=f"{whole} is a 32-bit integer"):
        await link.set_param(whole, 0.5)
    with pytest.raises(LinkError, match="not a finite number"):
        await link.set_param(real, float("nan"))
    wanted = [rule for rule in rules(link.kind, flight.settings) if rule.name in FAILSAFES[personality]]
    assert len(wanted) == 2
    found = [await check_rule(link, rule, fix=False) for rule in wanted]
    assert [result.ok for result in found] == [False, False], "the defaults of both autopilots fly on for too long"
    fixed = [await check_rule(link, rule, fix=True) for rule in wanted]
    assert all(result.ok and result.fix.startswith("set by --fix") for result in fixed)
    again = [await check_rule(link, rule, fix=False) for rule in wanted]
    assert all(result.ok and not result.fix for result in again), "they stayed set"
    assert await link.get_param(real) == pytest.approx(0.5)
    assert await link.get_param(whole) == {"px4": 5, "ardupilot": 0}[personality]
