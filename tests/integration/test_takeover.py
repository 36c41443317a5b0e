"""A pilot who takes over, beside a second vehicle on the same port."""

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
from tests.integration.rig import HEIGHT_M, PERSONALITIES, PILOTS_MODE, Stub, aboard
from tests.integration.witness import Witness

OURS, OTHER = 1, 2


@pytest.mark.flight
@pytest.mark.timeout(100)
@pytest.mark.parametrize(
    "personality",
    ["px4", "ardupilot"],
)
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
