"""A vehicle in the air that is taken over from its own mission: flown from there on, or left to whoever has it."""

from __future__ import annotations

import pytest

from companion.autopilot.mode_control import ModeRefused
from companion.autopilot.vehicle import FlightError, TakenOver
from companion.mavlink.ids import MavCmd, MavResult
from tests.autopilot.scripted import ARDUPILOT, GUIDED, H_M, LAND, LOITER, Flight

AUTO, TOOK_OFF_TO_M = 3, 2.2


def in_its_mission() -> Flight:
    """Armed by somebody else, hovering where its mission took it."""
    one = Flight(ARDUPILOT)
    autopilot = one.autopilot
    autopilot.mode, autopilot.armed, autopilot.height_m = AUTO, True, TOOK_OFF_TO_M
    autopilot.heartbeat()
    return one


async def over(one: Flight) -> None:
    await one.vehicle.take_over(H_M, one.autopilot.measured_m)


async def test_it_is_brought_to_the_height_and_then_follows_setpoints() -> None:
    one = in_its_mission()
    async with one.vehicle as vehicle:
        await over(one)
        assert one.autopilot.mode == GUIDED
        measured_m = one.autopilot.measured_m()
        assert measured_m is not None
        assert abs(measured_m - H_M) <= 0.2
        await vehicle.engage()
        assert all(await one.cruise(1.0))
        assert {command for command, _ in one.link.commands} == {MavCmd.DO_SET_MODE}, "neither armed nor taken off"


async def test_what_is_taken_over_is_left_landing() -> None:
    """Protects from a vehicle that hovers because its take-off was somebody else's."""
    one = in_its_mission()
    async with one.vehicle:
        await over(one)
    assert one.autopilot.mode == LAND


async def test_a_handover_that_is_refused_changes_nothing() -> None:
    """Protects the mission, and the pilot behind it: they keep what they have."""
    one = in_its_mission()
    one.link.answer = lambda command, _: MavResult.FAILED if command == MavCmd.DO_SET_MODE else MavResult.ACCEPTED
    with pytest.raises(ModeRefused, match="guided"):
        async with one.vehicle:
            await over(one)
    assert one.autopilot.mode == AUTO
    assert [command for command, _ in one.link.commands] == [MavCmd.DO_SET_MODE]
    assert one.setpoints == []


async def test_a_vehicle_that_is_disarmed_is_not_taken_over() -> None:
    one = in_its_mission()
    one.autopilot.armed = False
    one.autopilot.heartbeat()
    with pytest.raises(FlightError, match="not armed"):
        async with one.vehicle:
            await over(one)
    assert one.link.commands == []


async def test_a_pilot_who_takes_it_meanwhile_has_it() -> None:
    one = in_its_mission()

    def pilot() -> None:
        one.autopilot.mode = LOITER
        one.autopilot.heartbeat()

    one.autopilot.at(0.3, pilot)
    with pytest.raises(TakenOver, match="loiter"):
        async with one.vehicle:
            await over(one)
    assert one.autopilot.mode == LOITER
