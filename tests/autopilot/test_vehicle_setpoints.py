"""What leaves as a setpoint, and when none does."""

from __future__ import annotations

import math

import pytest

from companion.autopilot.vehicle import FlightError
from companion.model import Setpoint
from tests.autopilot.scripted_flight import PX4, Flight


async def test_setpoints_turn_and_climb_the_mavlink_way() -> None:
    """Left turn and climb are negative in the autopilot's frame: a sign lost here flies into the roof."""
    one = Flight(PX4)
    async with one.vehicle as vehicle:
        await one.up_and_engaged()
        assert vehicle.send(Setpoint(one.clock.now_s(), 0.25, 0.125, 0.5))
        sent = one.setpoints[-1]
        assert (sent["vx"], sent["vz"], sent["yaw_rate"]) == (0.25, -0.125, -0.5)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", [0, 1, 2])
async def test_what_is_not_finite_never_leaves(bad: float, field: int) -> None:
    """Protects the autopilot from NaN, which MAVLink uses for "not set", and from infinity."""
    one = Flight(PX4)
    async with one.vehicle as vehicle:
        await one.up_and_engaged()
        sent = len(one.setpoints)
        values = [0.1, 0.1, 0.1]
        values[field] = bad
        assert not vehicle.send(Setpoint(one.clock.now_s(), *values))
        assert len(one.setpoints) == sent
        assert vehicle._offboard.silent_because == "the setpoint is not finite"


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
    one = Flight(PX4)
    async with one.vehicle as vehicle:
        await one.up_and_engaged()
        one.autopilot.heartbeats = False
        went = await one.cruise(5.0)
        assert went[0]
        assert not went[-1]
        assert "heartbeat" in str(vehicle._offboard.silent_because)
