"""What is ordered of a vehicle in flight: nothing over somebody who has it unheard, and a hold only once it stands."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import pytest

from companion.autopilot.interface import LinkError
from companion.autopilot.mode_control import TOLD_WITHIN_S, UNHEARD_S
from companion.autopilot.vehicle import TakenOver, Vehicle
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavState
from companion.model import Setpoint
from companion.station_keeping import PATIENCE_S, STANDS_MPS
from tests.autopilot import scripted
from tests.autopilot.scripted import ARDUPILOT, KINDS, PX4, Flight, flying

ORDERS: dict[str, Callable[[Vehicle], Awaitable[object]]] = {
    "hold": lambda vehicle: vehicle.hold(),
    "land": lambda vehicle: vehicle.land(),
    "leave": lambda vehicle: vehicle._leave(),
}
THEIRS = {PX4: scripted.PX4_POSITION, ARDUPILOT: scripted.LOITER}
AROUND_S = 0.15
"""What steps of the simulation and of polling may add to a time."""


async def ordered(one: Flight, order: str) -> type[Exception] | None:
    """What came of an order: how it failed, None when it did not."""
    try:
        await ORDERS[order](one.vehicle)
    except (TakenOver, LinkError) as failure:
        return type(failure)
    return None


# After a stall.


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("kind", KINDS)
async def test_after_a_deaf_time_a_pilot_who_has_taken_over_keeps_the_vehicle(kind: AutopilotKind, order: str) -> None:
    """Protects the pilot: after 3 s without a heartbeat a landing was ordered over the mode that he had chosen."""
    async with flying(kind) as one:
        await one.cruise(1.0)
        one.autopilot.heartbeats, one.autopilot.mode = False, THEIRS[kind]
        await one.cruise(3.0)
        asked, sent = len(one.link.commands), len(one.setpoints)
        one.autopilot.at(0.5, one.autopilot.heartbeat)
        assert await ordered(one, order) is (None if order == "leave" else TakenOver)
        assert (len(one.link.commands), one.autopilot.mode) == (asked, THEIRS[kind])
        assert not one.vehicle.by_failsafe
        if order == "land":
            assert len(one.setpoints) == sent


@pytest.mark.parametrize("order", ORDERS)
async def test_after_a_stall_of_ours_px4s_failsafe_keeps_the_vehicle(order: str) -> None:
    """Protects PX4's hold: a setpoint ends it, and its heartbeat had not told of it yet when we ordered again."""
    async with flying(PX4) as one:
        await one.cruise(1.0)
        await one.clock.sleep(0.75)
        asked, sent = len(one.link.commands), len(one.setpoints)
        assert await ordered(one, order) is (None if order == "leave" else TakenOver)
        assert (len(one.link.commands), len(one.setpoints)) == (asked, sent)
        assert one.autopilot.mode == scripted.PX4_HOLD
        assert (one.vehicle.taken_over, one.vehicle.by_failsafe) == ("hold", True)


@pytest.mark.parametrize("order", ORDERS)
async def test_after_a_stall_what_is_still_ours_is_ordered_as_soon_as_that_is_told(order: str) -> None:
    """Protects from a vehicle that nobody ends: ArduPilot stays in guided, and the next heartbeat says so."""
    async with flying(ARDUPILOT) as one:
        await one.cruise(1.0)
        await one.clock.sleep(0.75)
        assert await ordered(one, order) is None
        assert one.autopilot.mode == (scripted.BRAKE if order == "hold" else scripted.LAND)


async def test_who_has_landed_it_unheard_is_not_disarmed_under_his_hands() -> None:
    """Protects a pilot who has set the vehicle down: it is told to stand on the ground before it is told to be his."""
    async with flying(PX4) as one:
        one.autopilot.heartbeats, one.autopilot.mode = False, scripted.PX4_POSITION
        one.link.deliver("EXTENDED_SYS_STATE", {"landed_state": 1})
        await one.cruise(UNHEARD_S)
        asked = len(one.link.commands)
        one.autopilot.at(0.5, one.autopilot.heartbeat)
    assert (len(one.link.commands), one.autopilot.armed) == (asked, True)


@pytest.mark.parametrize("kind", KINDS)
async def test_a_link_that_stays_silent_carries_no_order(kind: AutopilotKind) -> None:
    """Protects from an order into the dark, and from waiting for ever: whoever has the vehicle is its failsafe."""
    async with flying(kind) as one:
        one.autopilot.heartbeats = False
        await one.cruise(UNHEARD_S)
        asked, begun_s = len(one.link.commands), one.clock.now_s()
        with pytest.raises(LinkError, match=r"has not told its mode for .* s: nothing is ordered unseen"):
            await one.vehicle.land()
        assert one.clock.now_s() - begun_s == pytest.approx(TOLD_WITHIN_S, abs=AROUND_S)
        assert len(one.link.commands) == asked


async def test_while_heartbeats_come_and_setpoints_go_an_order_waits_for_nothing() -> None:
    """Protects the landing at the end of each flight from a second of waiting for what is known."""
    async with flying(PX4) as one:
        await one.cruise(1.9)
        begun_s = one.clock.now_s()
        asked_s: list[float] = []
        one.link.on_command = lambda *_: asked_s.append(one.clock.now_s())
        await one.vehicle.land()
        assert asked_s == [begun_s]


@pytest.mark.parametrize(
    ("status", "whose"),
    [
        (MavState.ACTIVE, "somebody else has the vehicle (mode hold)"),
        (MavState.CRITICAL, "the autopilot's own failsafe has the vehicle (mode hold)"),
        (MavState.EMERGENCY, "the autopilot's own failsafe has the vehicle (mode hold)"),
    ],
)
async def test_a_failsafe_of_the_autopilot_is_told_as_one(
    status: MavState, whose: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Protects who looks for the cause: a failsafe was told as a pilot who took over."""
    async with flying(PX4) as one:
        beat = {"custom_mode": scripted.PX4_HOLD, "base_mode": 128, "system_status": status}
        one.link.deliver("HEARTBEAT", beat)
        assert one.vehicle.by_failsafe == (status is not MavState.ACTIVE)
        with pytest.raises(TakenOver) as refused:
            await one.vehicle.hold()
        assert str(refused.value) == f"{whose}: the application keeps its hands off"
    assert whose in caplog.text


# Standing, then holding.


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("ends", ["hold", "land", "block"])
async def test_a_mode_is_asked_for_once_it_stands(kind: AutopilotKind, ends: str) -> None:
    """Protects from ArduCopter's brake, which needs twice the way that zero velocity does, and lands it where it is."""
    async with flying(kind, end="hold") as one:
        one.autopilot.moves(0.4)
        await one.cruise(0.5)
        begun_s, sent, asked = one.clock.now_s(), len(one.setpoints), len(one.modes_asked)
        asked_s: list[float] = []
        one.link.on_command = lambda *_: asked_s.append(one.clock.now_s())
        one.autopilot.at(0.5, lambda: one.autopilot.moves(STANDS_MPS + 0.01))
        one.autopilot.at(1.0, lambda: one.autopilot.moves(STANDS_MPS - 0.01))
        if ends == "hold":
            await one.vehicle.hold()
        elif ends == "land":
            await one.vehicle.land(timeout_s=2.0)
        else:
            await one.vehicle.__aexit__(None, None, None)
        streamed = one.setpoints[sent:]
        assert len(streamed) == pytest.approx(1.0 / 0.05, abs=3)
        assert {(each["vx"], each["vy"], each["vz"], each["yaw_rate"]) for each in streamed} == {(0.0, 0.0, 0.0, 0.0)}
        assert asked_s[0] - begun_s == pytest.approx(1.0, abs=AROUND_S)
        assert len(one.modes_asked) == asked + 1
        await one.cruise(1.0)
        assert len(one.setpoints) == sent + len(streamed), "what holds is left alone"


@pytest.mark.parametrize("moves", [True, False])
async def test_a_vehicle_that_never_stands_holds_all_the_same(moves: bool) -> None:
    """Protects from waiting for a velocity estimate that never says so, or for a position that is not there."""
    async with flying(ARDUPILOT) as one:
        if moves:
            one.autopilot.moves(0.4)
        begun_s = one.clock.now_s()
        asked_s: list[float] = []
        one.link.on_command = lambda *_: asked_s.append(one.clock.now_s())
        await one.vehicle.hold()
        assert asked_s[0] - begun_s == pytest.approx(PATIENCE_S, abs=AROUND_S)
        assert one.autopilot.mode == scripted.BRAKE


async def test_a_pilot_who_takes_over_while_it_comes_to_stand_is_obeyed() -> None:
    """Protects the pilot's last word from the mode that was still to be asked for."""
    async with flying(PX4) as one:
        one.autopilot.moves(0.4)

        def take() -> None:
            one.autopilot.mode = scripted.PX4_POSITION
            one.autopilot.heartbeat()

        one.autopilot.at(1.0, take)
        asked = len(one.link.commands)
        with pytest.raises(TakenOver):
            await one.vehicle.hold()
        assert (len(one.link.commands), one.autopilot.mode) == (asked, scripted.PX4_POSITION)


async def test_a_flight_that_ends_by_landing_sends_no_setpoint_after_its_end() -> None:
    """Protects the landing: where nobody has to stand first, nothing streams beside the mode."""
    async with flying(PX4, end="land") as one:
        one.autopilot.moves(0.4)
        await one.cruise(0.5)
        sent = len(one.setpoints)
        went: list[bool] = []
        # What is still running beside the end may go on sending.
        one.link.on_command = lambda *_: went.append(one.vehicle.send(Setpoint(one.clock.now_s(), 0.5, 0.0, 0.0)))
    assert went == [False]
    assert one.autopilot.mode == scripted.PX4_LAND
    assert len(one.setpoints) == sent


@pytest.mark.parametrize("end", ["hold", "land"])
async def test_a_vehicle_that_could_not_be_left_in_order_gets_no_setpoint_any_more(end: str) -> None:
    """Protects from a link that comes back: what then leaves would end the failsafe that has the vehicle."""
    async with flying(ARDUPILOT, end=end) as one:
        one.link.gone = True
    one.link.gone = False
    one.autopilot.heartbeat()
    assert not one.vehicle.send(Setpoint(one.clock.now_s(), 0.5, 0.0, 0.0))
    assert one.vehicle._offboard.silent_because == "not engaged"


async def test_where_its_own_landing_would_fly_away_it_stands_first_and_is_led_down() -> None:
    """Protects from a landing at latitude 0, longitude 0, and from one that comes down half a metre further on."""
    async with flying(PX4, end="land") as one:
        one.link.deliver("GPS_GLOBAL_ORIGIN", {"latitude": 1, "longitude": 1, "altitude": 0})
        one.autopilot.moves(0.4)
        await one.cruise(0.5)
        sent, asked = len(one.setpoints), len(one.modes_asked)
        one.autopilot.at(1.0, lambda: one.autopilot.moves(STANDS_MPS - 0.01))
        assert not await one.vehicle.land(timeout_s=4.0)
        streamed = one.setpoints[sent:]
        assert {(each["vx"], each["vy"], each["yaw_rate"]) for each in streamed} == {(0.0, 0.0, 0.0)}
        down_mps = [each["vz"] for each in streamed]
        assert down_mps[:15] == [0.0] * 15, "for nearly a second"
        assert down_mps[-1] == pytest.approx(0.3)
        assert len(one.modes_asked) == asked, "no mode of its own"
