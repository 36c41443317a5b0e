"""Take-off, setpoints, takeover and the end of a flight, against an autopilot that does what the real ones did."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from companion.autopilot.kind import AutopilotKind
from companion.autopilot.telemetry import Telemetry
from companion.autopilot.vehicle import FlightError, TakenOver, Vehicle
from companion.config.settings import Settings
from companion.model import Setpoint
from tests.autopilot import scripted
from tests.autopilot.fake_link import HandClock
from tests.autopilot.scripted import ScriptedAutopilot, ScriptedLink

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
KINDS = (PX4, ARDUPILOT)
H_M = 1.5


class Flight:
    """A vehicle on a scripted autopilot, and a clock that only its sleeping moves."""

    def __init__(self, kind: AutopilotKind, gps: bool = True, end: str = "land") -> None:
        self.clock = HandClock()
        self.link = ScriptedLink(self.clock, kind)
        self.autopilot = ScriptedAutopilot(self.link, self.clock)
        self.settings = Settings.model_validate({"autopilot": {"gps": gps}, "mission": {"end_action": end}})
        self.telemetry = Telemetry(self.link, self.clock)
        self.vehicle = Vehicle(self.link, self.telemetry, self.settings, self.clock, self.autopilot.sleep)
        self.autopilot.heartbeat()

    async def up(self) -> None:
        await self.vehicle.take_off(H_M, self.autopilot.measured_m)

    async def up_and_engaged(self) -> None:
        await self.up()
        await self.vehicle.engage()

    async def cruise(self, time_s: float, speed_mps: float = 0.5) -> list[bool]:
        """Send a setpoint every 50 ms, as the application does."""
        went: list[bool] = []
        until_s = self.clock.now_s() + time_s
        while self.clock.now_s() < until_s:
            went.append(self.vehicle.send(Setpoint(self.clock.now_s(), speed_mps, 0.0, 0.0)))
            await self.autopilot.sleep(0.05)
        return went

    @property
    def setpoints(self) -> list[dict[str, Any]]:
        return self.link.sent_named("SET_POSITION_TARGET_LOCAL_NED")

    @property
    def modes_asked(self) -> list[tuple[float, ...]]:
        return [params for command, params in self.link.commands if command == 176]


def fly(flight: Callable[[], Coroutine[Any, Any, None]]) -> None:
    asyncio.run(asyncio.wait_for(flight(), 20.0))


@pytest.mark.parametrize("gps", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_take_off_ends_at_the_measured_height_and_setpoints_then_steer(kind: AutopilotKind, gps: bool) -> None:
    """The whole way on each autopilot: the height is reached and kept for a second before take_off returns."""

    async def flight() -> None:
        one = Flight(kind, gps)
        async with one.vehicle as vehicle:
            await one.up()
            measured_m = one.autopilot.measured_m()
            assert measured_m is not None
            assert abs(measured_m - H_M) <= 0.2
            assert one.autopilot.armed
            await vehicle.engage()
            assert vehicle.engaged
            assert all(await one.cruise(2.0))
            assert one.autopilot.mode == (scripted.PX4_OFFBOARD if kind is PX4 else scripted.GUIDED)
            last = one.setpoints[-1]
            assert (last["coordinate_frame"], last["type_mask"]) == (8, 0x5C7)
            assert (last["vx"], last["vy"]) == (0.5, 0.0)
            assert await vehicle.land()
        assert not one.autopilot.armed

    fly(flight)


def test_setpoints_turn_and_climb_the_mavlink_way() -> None:
    """Left turn and climb are negative in the autopilot's frame: a sign lost here flies into the roof."""

    async def flight() -> None:
        one = Flight(PX4)
        async with one.vehicle as vehicle:
            await one.up_and_engaged()
            assert vehicle.send(Setpoint(one.clock.now_s(), 0.25, 0.125, 0.5))
            sent = one.setpoints[-1]
            assert (sent["vx"], sent["vz"], sent["yaw_rate"]) == (0.25, -0.125, -0.5)

    fly(flight)


def test_hold_is_not_height_reached() -> None:
    """PX4 reports hold at 0.6 of the height; the rest is climbed by our own setpoints."""

    async def flight() -> None:
        one = Flight(PX4)
        one.autopilot.ends_take_off_at = 0.6
        async with one.vehicle:
            await one.up()
            measured_m = one.autopilot.measured_m()
            assert measured_m is not None
            assert abs(measured_m - H_M) <= 0.2
            assert one.vehicle.engaged

    fly(flight)


def test_no_setpoint_goes_out_before_ardupilot_flies() -> None:
    """Velocity setpoints before the take-off suppress it; brake is not armable, so guided comes first."""

    async def flight() -> None:
        one = Flight(ARDUPILOT)
        async with one.vehicle:
            await one.up()
            assert one.setpoints == []
            assert not one.autopilot.suppressed
            assert [command for command, _ in one.link.commands] == [176, 400, 22]
            assert one.link.commands[2][1][6] == H_M

    fly(flight)


def test_px4_without_gps_is_told_an_origin_and_arms_in_offboard() -> None:
    async def flight() -> None:
        one = Flight(PX4, gps=False)
        one.autopilot.hold_allowed = False
        async with one.vehicle:
            await one.up()
            origin = one.link.sent_named("SET_GPS_GLOBAL_ORIGIN")
            assert len(origin) == 1
            assert origin[0]["latitude"] != 0
            assert [command for command, _ in one.link.commands] == [176, 400]
            assert one.modes_asked == [(1.0, 6.0, 0.0)]

    fly(flight)


def test_a_refusal_to_arm_is_told_in_the_autopilots_words() -> None:
    async def flight() -> None:
        one = Flight(ARDUPILOT)
        one.autopilot.refuses_to_arm = ["PreArm: Gyros inconsistent"] * 100
        one.autopilot.say("said long before")
        with pytest.raises(FlightError, match=r"refuses to arm \(failed\).*said: PreArm: Gyros inconsistent$"):
            async with one.vehicle:
                await one.up()
        assert not one.autopilot.armed
        assert one.modes_asked == [(1.0, 4.0, 0.0)], "nothing to hold or land: it never armed"

    fly(flight)


def test_a_reason_not_to_arm_may_pass() -> None:
    async def flight() -> None:
        one = Flight(ARDUPILOT)
        one.autopilot.refuses_to_arm = ["AHRS: waiting for home"] * 2
        async with one.vehicle:
            await one.up()
            assert one.autopilot.armed

    fly(flight)


@pytest.mark.parametrize("kind", KINDS)
def test_a_vehicle_that_does_not_lift_is_an_error_and_is_disarmed(kind: AutopilotKind) -> None:
    async def flight() -> None:
        one = Flight(kind)
        one.autopilot.lifts = False
        with pytest.raises(FlightError, match="disarmed before the height was reached"):
            async with one.vehicle:
                await one.up()
        assert not one.autopilot.armed

    fly(flight)


@pytest.mark.parametrize("kind", KINDS)
def test_after_a_refused_take_off_the_vehicle_is_disarmed_where_it_stands(kind: AutopilotKind) -> None:
    async def flight() -> None:
        one = Flight(kind)
        one.autopilot.refuses_to_take_off = True
        with pytest.raises(FlightError, match=r"refuses to take off \(denied\)"):
            async with one.vehicle:
                await one.up()
        assert not one.autopilot.armed
        assert one.link.commands[-1] == (400, (0.0,)), "disarmed, and nothing else was tried"

    fly(flight)


def test_a_height_that_is_never_measured_is_not_reached() -> None:
    """Missing is not zero, and an autopilot in hold is no height."""

    async def flight() -> None:
        one = Flight(PX4)
        with pytest.raises(FlightError, match="not reached within 40 s: the height is not measured"):
            async with one.vehicle as vehicle:
                await vehicle.take_off(H_M, lambda: None)
        assert one.autopilot.mode == scripted.PX4_LAND

    fly(flight)


def test_a_vehicle_that_is_armed_already_is_left_alone() -> None:
    async def flight() -> None:
        one = Flight(PX4)
        one.autopilot.armed = True
        one.autopilot.heartbeat()
        with pytest.raises(FlightError, match="armed already"):
            async with one.vehicle:
                await one.up()
        assert one.link.commands == []

    fly(flight)


@pytest.mark.parametrize("mode", [scripted.PX4_POSITION, scripted.PX4_HOLD, scripted.PX4_LAND])
def test_a_pilot_who_takes_over_is_obeyed_and_nothing_is_taken_back(mode: int) -> None:
    async def flight() -> None:
        one = Flight(PX4)
        async with one.vehicle as vehicle:
            await one.up_and_engaged()
            await one.cruise(2.0)
            one.autopilot.mode = mode
            one.autopilot.heartbeat()
            asked = len(one.link.commands)
            sent = len(one.setpoints)
            assert not any(await one.cruise(3.0))
            assert vehicle.pilot_took_over
            assert "somebody else has the vehicle" in str(vehicle.silent_because)
            for refused in (vehicle.engage(), vehicle.hold(), vehicle.land()):
                with pytest.raises(TakenOver):
                    await refused
            one.autopilot.mode = scripted.PX4_OFFBOARD
            one.autopilot.heartbeat()
            assert not any(await one.cruise(2.0))
            assert not vehicle.engaged
        assert len(one.link.commands) == asked, "hands off also at the end"
        assert len(one.setpoints) == sent

    fly(flight)


@pytest.mark.parametrize("kind", KINDS)
def test_a_pilot_who_takes_over_during_the_take_off_is_obeyed(kind: AutopilotKind) -> None:
    async def flight() -> None:
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

    fly(flight)


def test_a_hang_of_ours_is_a_failsafe_of_px4_and_not_ours_to_undo() -> None:
    """PX4 returns to offboard on the first setpoint after its failsafe, before any heartbeat told of the failsafe."""

    async def flight() -> None:
        one = Flight(PX4)
        async with one.vehicle as vehicle:
            await one.up_and_engaged()
            await one.cruise(1.0)
            await one.autopilot.sleep(0.75)
            assert one.autopilot.mode == scripted.PX4_HOLD
            assert not any(await one.cruise(4.0))
            assert vehicle.pilot_took_over
            assert vehicle.foreign_mode == "hold"
            assert one.autopilot.mode == scripted.PX4_HOLD

    fly(flight)


def test_after_a_silence_ardupilot_is_asked_first_and_then_flown_on() -> None:
    """It stays in guided: once a heartbeat has said so, the vehicle is still ours."""

    async def flight() -> None:
        one = Flight(ARDUPILOT)
        async with one.vehicle as vehicle:
            await one.up_and_engaged()
            await one.cruise(1.0)
            await one.autopilot.sleep(0.75)
            went = await one.cruise(3.0)
            assert not went[0]
            assert went[-1]
            assert not vehicle.pilot_took_over

    fly(flight)


def test_a_link_that_drops_out_is_not_flown_on_when_it_comes_back() -> None:
    """The autopilot heard nothing for 10 s, though we went on sending until its heartbeats were missed."""

    async def flight() -> None:
        one = Flight(PX4)
        async with one.vehicle as vehicle:
            await one.up_and_engaged()
            await one.cruise(1.0)
            one.autopilot.deaf, one.autopilot.heartbeats = True, False
            await one.cruise(10.0)
            one.autopilot.deaf, one.autopilot.heartbeats = False, True
            assert not any(await one.cruise(3.0))
            assert vehicle.foreign_mode == "hold"

    fly(flight)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", [0, 1, 2])
def test_what_is_not_finite_never_leaves(bad: float, field: int) -> None:
    async def flight() -> None:
        one = Flight(PX4)
        async with one.vehicle as vehicle:
            await one.up_and_engaged()
            sent = len(one.setpoints)
            values = [0.1, 0.1, 0.1]
            values[field] = bad
            assert not vehicle.send(Setpoint(one.clock.now_s(), *values))
            assert len(one.setpoints) == sent
            assert vehicle.silent_because == "the setpoint is not finite"

    fly(flight)


def test_nothing_is_sent_before_engaging() -> None:
    async def flight() -> None:
        one = Flight(PX4)
        async with one.vehicle as vehicle:
            assert not vehicle.send(Setpoint(one.clock.now_s(), 0.5, 0.0, 0.0))
            with pytest.raises(FlightError, match="not armed"):
                await vehicle.engage()
            assert one.link.sent == []
        assert one.link.commands == []

    fly(flight)


def test_nothing_is_sent_to_an_autopilot_that_is_not_heard() -> None:
    async def flight() -> None:
        one = Flight(PX4)
        async with one.vehicle as vehicle:
            await one.up_and_engaged()
            one.autopilot.heartbeats = False
            went = await one.cruise(5.0)
            assert went[0]
            assert not went[-1]
            assert "heartbeat" in str(vehicle.silent_because)

    fly(flight)


@pytest.mark.parametrize("kind", KINDS)
def test_a_mode_that_is_accepted_but_never_shows_is_an_error(kind: AutopilotKind) -> None:
    async def flight() -> None:
        one = Flight(kind)
        async with one.vehicle as vehicle:
            await one.up_and_engaged()
            one.autopilot.ignores_modes = True
            began_s = one.clock.now_s()
            with pytest.raises(FlightError, match="does not show it"):
                await vehicle.land()
            assert 2.5 < one.clock.now_s() - began_s < 5.5

    fly(flight)


@pytest.mark.parametrize("end", ["hold", "land"])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("error", [RuntimeError, asyncio.CancelledError, KeyboardInterrupt])
def test_whatever_happens_the_vehicle_is_left_holding_or_landing(
    kind: AutopilotKind, end: str, error: type[BaseException]
) -> None:
    async def flight() -> None:
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
        await one.autopilot.sleep(2.0)
        assert len(one.setpoints) == sent, "nothing streams on"

    fly(flight)


def test_cancelling_again_and_again_does_not_stop_the_leaving() -> None:
    async def flight() -> None:
        one = Flight(PX4, end="hold")

        async def fly_on() -> None:
            async with one.vehicle:
                await one.up_and_engaged()
                while True:
                    await one.cruise(1.0)

        task = asyncio.ensure_future(fly_on())
        while not one.vehicle.engaged:
            await one.autopilot.sleep(0.05)
        while not task.done():
            task.cancel()
            await asyncio.sleep(0)
        assert task.cancelled()
        assert one.autopilot.mode == scripted.PX4_HOLD

    fly(flight)


def test_a_take_off_that_is_broken_off_lands() -> None:
    """A cancelled manoeuvre and the leaving overlap: the leaving wins."""

    async def flight() -> None:
        one = Flight(PX4, gps=False)
        async with one.vehicle:
            task = asyncio.ensure_future(one.up())
            while one.autopilot.height_m < 0.5:
                await one.autopilot.sleep(0.05)
            task.cancel()
        assert one.autopilot.mode == scripted.PX4_LAND
        assert not one.vehicle.pilot_took_over

    fly(flight)


def test_where_hold_is_refused_it_lands() -> None:
    """Without a global origin PX4 cannot hold."""

    async def flight() -> None:
        one = Flight(PX4, gps=False, end="hold")
        one.autopilot.hold_allowed = False
        async with one.vehicle:
            await one.up_and_engaged()
        assert one.autopilot.mode == scripted.PX4_LAND

    fly(flight)


def test_with_a_dead_link_nothing_is_streamed_and_somebody_is_told(caplog: pytest.LogCaptureFixture) -> None:
    async def flight() -> None:
        one = Flight(PX4)
        async with one.vehicle as vehicle:
            await one.up_and_engaged()
            one.link.gone = True
            assert not vehicle.send(Setpoint(one.clock.now_s(), 0.5, 0.0, 0.0))
            sent = len(one.setpoints)
        assert len(one.setpoints) == sent

    fly(flight)
    assert "failsafe has to end this flight" in caplog.text


def test_malformed_heartbeats_change_nothing() -> None:
    async def flight() -> None:
        one = Flight(PX4)
        async with one.vehicle as vehicle:
            await one.up_and_engaged()
            for fields in ({}, {"custom_mode": "x", "base_mode": 128}, {"custom_mode": None, "base_mode": math.nan}):
                one.link.deliver("HEARTBEAT", fields)
            one.link.deliver("HEARTBEAT", {"custom_mode": 0, "base_mode": 0}, system_id=2)
            one.link.deliver("HEARTBEAT", {"custom_mode": 0, "base_mode": 0}, component_id=191)
            assert all(await one.cruise(1.0))
            assert not vehicle.pilot_took_over

    fly(flight)
