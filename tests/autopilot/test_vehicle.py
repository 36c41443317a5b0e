"""The vehicle in flight: what leaves as a setpoint, who has it, and how it is left."""

from __future__ import annotations

import asyncio
import math

import pytest

from companion.autopilot.vehicle import FlightError, TakenOver
from companion.mavlink.firmware import AutopilotKind
from companion.model import Setpoint
from tests.autopilot import scripted
from tests.autopilot.scripted import ARDUPILOT, KINDS, PX4, Flight, flying


async def test_setpoints_turn_and_climb_the_mavlink_way() -> None:
    """To the left, left turn and climb are negative in the autopilot's frame: a sign lost here flies into the roof."""
    async with flying(PX4) as one:
        assert one.vehicle.send(Setpoint(one.clock.now_s(), 0.25, 0.125, 0.5, 0.0625))
        sent = one.setpoints[-1]
        assert (sent["vx"], sent["vy"], sent["vz"], sent["yaw_rate"]) == (0.25, -0.0625, -0.125, -0.5)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", [0, 1, 2, 3])
async def test_what_is_not_finite_never_leaves(bad: float, field: int) -> None:
    """Protects the autopilot from NaN, which MAVLink uses for "not set", and from infinity."""
    async with flying(PX4) as one:
        sent = len(one.setpoints)
        values = [0.1, 0.1, 0.1, 0.1]
        values[field] = bad
        assert not one.vehicle.send(Setpoint(one.clock.now_s(), *values))
        assert len(one.setpoints) == sent
        assert one.vehicle._offboard.silent_because == "the setpoint is not finite"


async def test_nothing_is_sent_before_engaging() -> None:
    """Protects a vehicle that stands, and the people beside it."""
    one = Flight(PX4)
    async with one.vehicle as vehicle:
        assert not vehicle.send(Setpoint(one.clock.now_s(), 0.5, 0.0, 0.0))
        with pytest.raises(FlightError, match="not armed"):
            await vehicle.engage()
        assert one.link.sent == []
    assert one.link.commands == []


async def test_nothing_is_sent_to_an_autopilot_that_is_not_heard() -> None:
    """Protects against steering a vehicle of which nobody knows who has it."""
    async with flying(PX4) as one:
        one.autopilot.heartbeats = False
        went = await one.cruise(5.0)
        assert went[0]
        assert not went[-1]
        assert "heartbeat" in str(one.vehicle._offboard.silent_because)


# Whose the vehicle is in flight: who takes it over has it, and what only looks like that changes nothing.


@pytest.mark.parametrize("mode", [scripted.PX4_POSITION, scripted.PX4_HOLD, scripted.PX4_LAND])
async def test_a_pilot_who_takes_over_is_obeyed_and_nothing_is_taken_back(mode: int) -> None:
    """Protects the pilot's last word, also when the mode returns to ours later."""
    async with flying(PX4) as one:
        await one.cruise(2.0)
        one.autopilot.mode = mode
        one.autopilot.heartbeat()
        asked = len(one.link.commands)
        sent = len(one.setpoints)
        assert not any(await one.cruise(3.0))
        assert one.vehicle.taken_over
        assert "somebody else has the vehicle" in str(one.vehicle._offboard.silent_because)
        for refused in (one.vehicle.engage(), one.vehicle.hold(), one.vehicle.land()):
            with pytest.raises(TakenOver):
                await refused
        one.autopilot.mode = scripted.PX4_OFFBOARD
        one.autopilot.heartbeat()
        assert not any(await one.cruise(2.0))
        assert not one.vehicle._offboard.engaged
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
    async with flying(PX4) as one:
        await one.cruise(1.0)
        await one.clock.sleep(0.75)
        assert one.autopilot.mode == scripted.PX4_HOLD
        assert not any(await one.cruise(4.0))
        assert one.vehicle.taken_over == "hold"
        assert one.autopilot.mode == scripted.PX4_HOLD


async def test_after_a_silence_ardupilot_is_asked_first_and_then_flown_on() -> None:
    """It stays in guided: once a heartbeat has said so, the vehicle is still ours."""
    async with flying(ARDUPILOT) as one:
        await one.cruise(1.0)
        await one.clock.sleep(0.75)
        went = await one.cruise(3.0)
        assert not went[0]
        assert went[-1]
        assert not one.vehicle.taken_over


async def test_a_link_that_drops_out_is_not_flown_on_when_it_comes_back() -> None:
    """The autopilot heard nothing for 10 s, though we went on sending until its heartbeats were missed."""
    async with flying(PX4) as one:
        await one.cruise(1.0)
        one.autopilot.deaf, one.autopilot.heartbeats = True, False
        await one.cruise(10.0)
        one.autopilot.deaf, one.autopilot.heartbeats = False, True
        assert not any(await one.cruise(3.0))
        assert one.vehicle.taken_over == "hold"


async def test_malformed_heartbeats_change_nothing() -> None:
    """Protects the flight from heartbeats that say nothing, and from those of others."""
    async with flying(PX4) as one:
        for fields in ({}, {"custom_mode": "x", "base_mode": 128}, {"custom_mode": None, "base_mode": math.nan}):
            one.link.deliver("HEARTBEAT", fields)
        one.link.deliver("HEARTBEAT", {"custom_mode": 0, "base_mode": 0}, system_id=2)
        one.link.deliver("HEARTBEAT", {"custom_mode": 0, "base_mode": 0}, component_id=191)
        assert all(await one.cruise(1.0))
        assert not one.vehicle.taken_over


# The end of a flight: whatever ends it, the vehicle holds or lands, or somebody is told that it does not.


@pytest.mark.parametrize("kind", KINDS)
async def test_a_mode_that_is_accepted_but_never_shows_is_an_error(kind: AutopilotKind) -> None:
    """Protects against believing an acknowledgement: a vehicle lands when its heartbeat says so."""
    async with flying(kind) as one:
        one.autopilot.ignores_modes = True
        began_s = one.clock.now_s()
        with pytest.raises(FlightError, match="does not show it"):
            await one.vehicle.land()
        assert 2.5 < one.clock.now_s() - began_s < 5.5


@pytest.mark.parametrize("end", ["hold", "land"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("error", [RuntimeError, asyncio.CancelledError, KeyboardInterrupt])
async def test_whatever_happens_the_vehicle_is_left_holding_or_landing(
    kind: AutopilotKind, end: str, error: type[BaseException]
) -> None:
    """Protects the vehicle from every way in which our program can end."""
    one = Flight(kind, end=end)
    raised: BaseException | None = None
    try:
        async with one.vehicle:
            await one.up_and_engaged()
            await one.cruise(1.0)
            raise error
    except BaseException as caught:  # noqa: BLE001  the test raises all kinds
        raised = caught
    assert type(raised) is error
    holding = scripted.PX4_HOLD if kind is PX4 else scripted.BRAKE
    landing = scripted.PX4_LAND if kind is PX4 else scripted.LAND
    assert one.autopilot.mode == (holding if end == "hold" else landing)
    sent = len(one.setpoints)
    await one.clock.sleep(2.0)
    assert len(one.setpoints) == sent, "nothing streams on"


async def test_cancelling_again_and_again_does_not_stop_the_leaving() -> None:
    """Protects the last command of a flight from a person who presses Ctrl-C more than once."""
    one = Flight(PX4, end="hold")

    async def fly_on() -> None:
        async with one.vehicle:
            await one.up_and_engaged()
            while True:
                await one.cruise(1.0)

    task = asyncio.ensure_future(fly_on())
    while not one.vehicle._offboard.engaged:
        await one.clock.sleep(0.05)
    while not task.done():
        task.cancel()
        await asyncio.sleep(0)
    assert task.cancelled()
    assert one.autopilot.mode == scripted.PX4_HOLD


async def test_a_take_off_that_is_broken_off_lands() -> None:
    """A cancelled manoeuvre and the leaving overlap: the leaving wins."""
    one = Flight(PX4, gps=False)
    async with one.vehicle:
        task = asyncio.ensure_future(one.up())
        while one.autopilot.height_m < 0.5:
            await one.clock.sleep(0.05)
        task.cancel()
    assert one.autopilot.mode == scripted.PX4_LAND
    assert not one.vehicle.taken_over


async def test_where_hold_is_refused_it_lands() -> None:
    """Without a global origin PX4 cannot hold."""
    one = Flight(PX4, gps=False, end="hold")
    one.autopilot.hold_allowed = False
    async with one.vehicle:
        await one.up_and_engaged()
    assert one.autopilot.mode == scripted.PX4_LAND


async def test_with_a_dead_link_nothing_is_streamed_and_somebody_is_told(caplog: pytest.LogCaptureFixture) -> None:
    """Protects the person who must know that nothing of ours can end this flight."""
    async with flying(PX4) as one:
        one.link.gone = True
        assert not one.vehicle.send(Setpoint(one.clock.now_s(), 0.5, 0.0, 0.0))
        sent = len(one.setpoints)
    assert len(one.setpoints) == sent
    assert "failsafe has to end this flight" in caplog.text
