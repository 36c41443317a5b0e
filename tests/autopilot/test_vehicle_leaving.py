"""The end of a flight: whatever ends it, the vehicle holds or lands, or somebody is told that it does not."""

from __future__ import annotations

import asyncio

import pytest

from companion.autopilot.vehicle import FlightError
from companion.mavlink.firmware import AutopilotKind
from companion.model import Setpoint
from tests.autopilot import scripted
from tests.autopilot.scripted_flight import KINDS, PX4, Flight


@pytest.mark.parametrize("kind", KINDS)
async def test_a_mode_that_is_accepted_but_never_shows_is_an_error(kind: AutopilotKind) -> None:
    """Protects against believing an acknowledgement: a vehicle lands when its heartbeat says so."""
    one = Flight(kind)
    async with one.vehicle as vehicle:
        await one.up_and_engaged()
        one.autopilot.ignores_modes = True
        began_s = one.clock.now_s()
        with pytest.raises(FlightError, match="does not show it"):
            await vehicle.land()
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
    one = Flight(PX4)
    async with one.vehicle as vehicle:
        await one.up_and_engaged()
        one.link.gone = True
        assert not vehicle.send(Setpoint(one.clock.now_s(), 0.5, 0.0, 0.0))
        sent = len(one.setpoints)
    assert len(one.setpoints) == sent
    assert "failsafe has to end this flight" in caplog.text
