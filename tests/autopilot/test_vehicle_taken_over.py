"""Whose the vehicle is in flight: who takes it over has it, and what only looks like that changes nothing."""

from __future__ import annotations

import math

import pytest

from companion.autopilot.vehicle import TakenOver
from companion.mavlink.firmware import AutopilotKind
from tests.autopilot import scripted
from tests.autopilot.scripted_flight import ARDUPILOT, KINDS, PX4, Flight


@pytest.mark.parametrize("mode", [scripted.PX4_POSITION, scripted.PX4_HOLD, scripted.PX4_LAND])
async def test_a_pilot_who_takes_over_is_obeyed_and_nothing_is_taken_back(mode: int) -> None:
    """Protects the pilot's last word, also when the mode returns to ours later."""
    one = Flight(PX4)
    async with one.vehicle as vehicle:
        await one.up_and_engaged()
        await one.cruise(2.0)
        one.autopilot.mode = mode
        one.autopilot.heartbeat()
        asked = len(one.link.commands)
        sent = len(one.setpoints)
        assert not any(await one.cruise(3.0))
        assert vehicle.taken_over
        assert "somebody else has the vehicle" in str(vehicle._offboard.silent_because)
        for refused in (vehicle.engage(), vehicle.hold(), vehicle.land()):
            with pytest.raises(TakenOver):
                await refused
        one.autopilot.mode = scripted.PX4_OFFBOARD
        one.autopilot.heartbeat()
        assert not any(await one.cruise(2.0))
        assert not vehicle._offboard.engaged
    assert len(one.link.commands) == asked, "hands off also at the end"
    assert len(one.setpoints) == sent


@pytest.mark.parametrize("kind", KINDS)
async def test_a_pilot_who_takes_over_during_the_take_off_is_obeyed(kind: AutopilotKind) -> None:
    """Protects the pilot's last word while commands of ours are still under way."""
    one = Flight(kind)
    theirs = scripted.PX4_POSITION if kind is PX4 else scripted.LOITER

    def take() -> None:
        one.autopilot.mode = theirs

    one.autopilot.at(2.5, take)
    with pytest.raises(TakenOver):
        async with one.vehicle:
            await one.up()
    assert one.autopilot.mode == theirs
    assert one.autopilot.armed


async def test_a_hang_of_ours_is_a_failsafe_of_px4_and_not_ours_to_undo() -> None:
    """PX4 returns to offboard on the first setpoint after its failsafe, before any heartbeat told of the failsafe."""
    one = Flight(PX4)
    async with one.vehicle as vehicle:
        await one.up_and_engaged()
        await one.cruise(1.0)
        await one.clock.sleep(0.75)
        assert one.autopilot.mode == scripted.PX4_HOLD
        assert not any(await one.cruise(4.0))
        assert vehicle.taken_over == "hold"
        assert one.autopilot.mode == scripted.PX4_HOLD


async def test_after_a_silence_ardupilot_is_asked_first_and_then_flown_on() -> None:
    """It stays in guided: once a heartbeat has said so, the vehicle is still ours."""
    one = Flight(ARDUPILOT)
    async with one.vehicle as vehicle:
        await one.up_and_engaged()
        await one.cruise(1.0)
        await one.clock.sleep(0.75)
        went = await one.cruise(3.0)
        assert not went[0]
        assert went[-1]
        assert not vehicle.taken_over


async def test_a_link_that_drops_out_is_not_flown_on_when_it_comes_back() -> None:
    """The autopilot heard nothing for 10 s, though we went on sending until its heartbeats were missed."""
    one = Flight(PX4)
    async with one.vehicle as vehicle:
        await one.up_and_engaged()
        await one.cruise(1.0)
        one.autopilot.deaf, one.autopilot.heartbeats = True, False
        await one.cruise(10.0)
        one.autopilot.deaf, one.autopilot.heartbeats = False, True
        assert not any(await one.cruise(3.0))
        assert vehicle.taken_over == "hold"


async def test_malformed_heartbeats_change_nothing() -> None:
    """Protects the flight from heartbeats that say nothing, and from those of others."""
    one = Flight(PX4)
    async with one.vehicle as vehicle:
        await one.up_and_engaged()
        for fields in ({}, {"custom_mode": "x", "base_mode": 128}, {"custom_mode": None, "base_mode": math.nan}):
            one.link.deliver("HEARTBEAT", fields)
        one.link.deliver("HEARTBEAT", {"custom_mode": 0, "base_mode": 0}, system_id=2)
        one.link.deliver("HEARTBEAT", {"custom_mode": 0, "base_mode": 0}, component_id=191)
        assert all(await one.cruise(1.0))
        assert not vehicle.taken_over
