"""What each autopilot does when setpoints stop, and when they come again."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from sitl.autopilot.mavlink import dialect as m
from tests.integration.rig import HEIGHT_M, Aboard, Stage, aboard, both, fly_all
from tests.integration.witness import Witness, apart_m, speed_mps
from tests.shared.beside import until

SPEED_MPS = 0.5


@pytest.mark.slow
@pytest.mark.timeout(120)
async def test_silence_stops_the_vehicle_and_only_what_was_not_taken_away_goes_on(tmp_path: Path) -> None:
    """Protects the last layer of safety: an application that fails falls silent, and the autopilot must then stop.

    And what comes after: PX4 has taken the vehicle with its failsafe, so that it is no longer ours, even when
    somebody's setpoints bring it back to offboard. ArduPilot only waits in guided for the next setpoint.
    """
    with both(tmp_path) as stages:
        await fly_all(stages, _fly)


async def _fly(ours: Stage) -> None:
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
