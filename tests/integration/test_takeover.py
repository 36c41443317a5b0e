"""Who has the vehicle: a pilot who takes over, and setpoints that stop and come again."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from companion.autopilot.interface import LinkError
from companion.autopilot.vehicle import TakenOver
from sitl.autopilot.mavlink import dialect as m
from sitl.launch.processes import free_udp_ports
from tests.integration.relay import UdpRelay
from tests.integration.rig import HEIGHT_M, PERSONALITIES, PILOTS_MODE, Aboard, Stage, Stub, aboard, both, fly_all
from tests.integration.witness import Witness, apart_m, speed_mps
from tests.shared.beside import until

OURS, OTHER = 1, 2


@pytest.mark.flight
@pytest.mark.timeout(100)
@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
async def test_the_pilot_of_our_vehicle_is_obeyed_at_once_and_the_one_of_another_is_not(
    personality: str, tmp_path: Path
) -> None:
    """Protects the pilot's last word, and a second vehicle whose autopilot sends on the same port.

    The other vehicle, of the other firmware, must neither be flown by us nor decide anything for us.
    """
    (port,) = free_udp_ports(1)
    stranger = next(name for name in PERSONALITIES if name != personality)
    with (
        UdpRelay(port) as relay,
        Witness() as witness,
        Witness(system_id=OTHER) as others_witness,
        Stub(tmp_path, personality, (relay.port, witness.port), OURS).running() as stub,
        Stub(tmp_path, stranger, (port, others_witness.port), OTHER).running() as other,
    ):
        await _fly(personality, port, (relay, witness, stub), (others_witness, other))


async def _fly(personality: str, port: int, ours: tuple[UdpRelay, Witness, Stub], others: tuple[Witness, Stub]) -> None:
    (relay, witness, stub), (others_witness, other) = ours, others
    with pytest.raises(LinkError, match=r"only autopilots of other systems: 1, 2\. Set autopilot\.system_id"):
        async with aboard(port, system_id=9, connect_timeout_s=2.5):
            pytest.fail("which vehicle to fly is never guessed")
    async with aboard(port, OURS) as flight:
        assert flight.link.kind == personality, "that of our system id, not the one that came first"
        async with flight.vehicle as vehicle:
            await flight.fly()
            other.pilot_takes_over()
            assert await flight.stream(1.6, 0.3) > 20
            assert others_witness.mode in PILOTS_MODE.values()
            assert not vehicle.taken_over, "it is another vehicle's pilot"

            stub.pilot_takes_over()
            asked_s = time.monotonic()
            await flight.stream(4.0, 0.3, while_true=lambda: not vehicle.taken_over)
            assert time.monotonic() - asked_s < 1.6, "the heartbeat that tells comes once a second"
            assert vehicle.taken_over == PILOTS_MODE[personality]
            hands_off_s = time.monotonic()
            assert await flight.stream(0.3, 0.3) == 0
            for take_back in (vehicle.engage, vehicle.hold, vehicle.land):
                with pytest.raises(TakenOver, match=PILOTS_MODE[personality]):
                    await take_back()
        await asyncio.sleep(1.5)
        assert relay.seen.setpoints(hands_off_s) == []
        commands = {message.command for message in relay.seen.commands(hands_off_s)}
        flown_by = {m.MAV_CMD_DO_SET_MODE, m.MAV_CMD_COMPONENT_ARM_DISARM, m.MAV_CMD_NAV_LAND}
        assert not commands & flown_by, "nothing takes the vehicle back, also not the end of the block"
        assert (witness.mode, witness.armed) == (PILOTS_MODE[personality], True)
        assert abs(witness.pose().z_m - HEIGHT_M) < 0.5, "it is where the pilot took it"
        assert not others_witness.ever_armed, "what was meant for ours has not armed the other"
        assert max(abs(pose.z_m) for pose in tuple(others_witness.poses)) < 0.2


# What each autopilot does when setpoints stop, and when they come again.


SPEED_MPS = 0.5


@pytest.mark.slow
@pytest.mark.timeout(120)
async def test_silence_stops_the_vehicle_and_only_what_was_not_taken_away_goes_on(tmp_path: Path) -> None:
    """Protects the last layer of safety: an application that fails falls silent, and the autopilot must then stop.

    And what comes after: PX4 has taken the vehicle with its failsafe, so that it is no longer ours, even when
    somebody's setpoints bring it back to offboard. ArduPilot only waits in guided for the next setpoint.
    """
    with both(tmp_path) as stages:
        await fly_all(stages, _fall_silent)


async def _fall_silent(ours: Stage) -> None:
    personality, relay, witness = ours.personality, ours.relay, ours.witness
    async with aboard(ours.port) as flight:
        async with flight.vehicle as vehicle:
            await flight.fly()
            assert await flight.stream(2.5, SPEED_MPS) > 30
            silent_s = time.monotonic()
            await asyncio.sleep(3.5)

            assert witness.speed_at(silent_s) > 0.3, "it flew before"
            assert witness.speed_at(silent_s + 0.3) > 0.25, "it flies on as long as the silence may still end"
            still = [speed_mps(pose) for pose in tuple(witness.poses) if pose.t_s > silent_s + 2.6]
            assert len(still) > 20
            assert max(still) < 0.12, "standing 1.3 (PX4) or 1.7 s (ArduPilot) after the loss; noise is 0.01 m/s"
            way_m = apart_m(witness.pose_at(silent_s), witness.pose())
            assert 0.15 < way_m < 0.8, "0.4 and 0.54 m were measured on the real ones"
            assert abs(witness.pose().z_m - HEIGHT_M) < 0.5, "and it neither lands nor climbs"
            assert relay.seen.setpoints(silent_s + 0.1) == [], "nothing repeats the last setpoint"
            if personality == "px4":
                await _after_px4s_failsafe(witness, flight)
            else:
                assert (witness.mode, vehicle.taken_over) == ("guided", None)
                assert await flight.stream(2.0, SPEED_MPS) > 25
                assert witness.speed_at(time.monotonic() - 0.2) > 0.2, "guided again, without being asked to"
            left_s = time.monotonic()
        await asyncio.sleep(1.2)
        commands = relay.seen.commands(left_s)
        if personality == "px4":
            assert [message for message in commands if message.command == m.MAV_CMD_DO_SET_MODE] == []
            assert witness.mode != "land", "it is not ours to land"
        else:
            assert witness.mode == "land", "leaving the block lands"


async def _after_px4s_failsafe(witness: Witness, flight: Aboard) -> None:
    vehicle = flight.vehicle
    assert witness.mode == "hold"
    assert vehicle.taken_over == "hold"
    assert await flight.stream(0.3, SPEED_MPS) == 0
    somebodys = m.MAVLink_set_position_target_local_ned_message(0, 1, 1, m.MAV_FRAME_BODY_NED, 0x5C7, *([0.0] * 11))

    def back_in_offboard() -> bool:
        witness.send(somebodys)
        return witness.mode == "offboard"

    await until(back_in_offboard, "offboard by itself", 2.0)
    assert vehicle.taken_over, "that does not make it ours again"
    assert await flight.stream(0.2) == 0
