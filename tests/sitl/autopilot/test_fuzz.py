"""Garbage, truncated, oversized, replayed and foreign messages: nothing crashes, nothing moves the vehicle."""

from __future__ import annotations

import math
import random
import struct

import pytest

from companion.model import Pose
from sitl.autopilot import ARDUPILOT, PX4, Personality
from sitl.autopilot.codec import Decoder, Encoder
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from tests.sitl.autopilot.rig import Rig, command_long, odometry, setpoint

BOTH = pytest.mark.parametrize("personality", [PX4, ARDUPILOT], ids=["px4", "ardupilot"])
HARMLESS = [
    setpoint(0.5),
    setpoint(math.nan, vz=-1.0),
    setpoint(1e30, yaw_rate=math.inf),
    odometry(1.0, 2.0, 3.0),
    odometry(math.nan, math.inf, -math.inf, [math.nan] * 4),
    command_long(m.MAV_CMD_DO_SET_MODE, math.nan, math.nan, math.inf),
    command_long(m.MAV_CMD_SET_MESSAGE_INTERVAL, math.nan, math.nan),
    command_long(m.MAV_CMD_SET_MESSAGE_INTERVAL, 1e30, -math.inf),
    command_long(m.MAV_CMD_SET_MESSAGE_INTERVAL, 30, math.nan),
    command_long(m.MAV_CMD_REQUEST_MESSAGE, math.inf),
    command_long(m.MAV_CMD_GET_MESSAGE_INTERVAL, math.nan),
    command_long(m.MAV_CMD_COMPONENT_ARM_DISARM, math.nan, 21196.0),
    command_long(m.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, math.nan),
    m.MAVLink_param_set_message(1, 1, b"\xff\xfe\x00\x01", math.nan, 200),
    m.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", math.inf, 9),
    m.MAVLink_param_request_read_message(1, 1, b"\x80" * 16, -32768),
    m.MAVLink_obstacle_distance_message(0, 255, [0] * 72, 0, 65535, 0, math.nan, math.nan, 12),
    m.MAVLink_obstacle_distance_message(0, 0, [1] * 72, 255, 0, 65535, math.inf, -math.inf, 12),
    m.MAVLink_timesync_message(-(2**63), 2**63 - 1),
    m.MAVLink_set_gps_global_origin_message(1, 2**31 - 1, -(2**31), 0),
    m.MAVLink_set_mode_message(1, 1, 2**32 - 1),
    m.MAVLink_vision_position_estimate_message(0, math.nan, 0.0, 0.0, 0.0, 0.0, math.nan),
    m.MAVLink_vision_speed_estimate_message(0, math.inf, 0.0, 0.0),
]


def spoiled(packet: bytes, rng: random.Random, kind: int) -> bytes:
    """A packet with something wrong with it: garbage, cut off, one bit, oversized, another content."""
    if kind == 0:
        return rng.randbytes(rng.randrange(1, 600))
    if kind == 1:
        return packet[: rng.randrange(len(packet))]
    if kind == 2:
        at = rng.randrange(10, len(packet))
        return packet[:at] + bytes([packet[at] ^ 1 << rng.randrange(8)]) + packet[at + 1 :]
    if kind == 3:
        return bytes([packet[0], 255, *packet[2:]]) + rng.randbytes(rng.randrange(300))
    return packet[:10] + rng.randbytes(len(packet) - 10)


@pytest.mark.parametrize("seed", range(3))
def test_a_decoder_survives_anything_and_finds_nothing_in_it(seed: int) -> None:
    """A checksum of 16 bits lets one in 65536 random frames pass, so one in 4500 of these; cuts and bits never."""
    rng, encoder = random.Random(seed), Encoder(1)  # noqa: S311 - a fixed seed
    decoder, found = Decoder(), [0] * 5
    packets = [encoder.bytes(message) for message in HARMLESS]
    for i in range(1500):
        data = spoiled(rng.choice(packets), rng, i % 5)
        found[i % 5] += len(Decoder().messages(data))
        decoder.messages(data)
    assert (found[1], found[2]) == (0, 0)
    assert sum(found) <= 2
    # The stream's decoder may have to read past the longest message that the garbage promised.
    after = [x for _ in range(12) for x in decoder.messages(packets[0])]
    assert after[-1].get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    assert decoder.bad > 0


@BOTH
@pytest.mark.parametrize("gps", [True, False], ids=["gps", "no gps"])
def test_nothing_moves_a_disarmed_vehicle_but_arming(personality: Personality, gps: bool) -> None:
    """Whatever arrives, replayed and from anyone: it stands where it stood, and still answers."""
    rng = random.Random(7)  # noqa: S311 - a fixed seed
    rig = Rig(personality, Pose(0.0, 1.0, 2.0, 3.0, 0.4), gps=gps)
    for _ in range(3000):
        source = (rng.randrange(256), rng.randrange(256)) if rng.random() < 0.5 else None
        rig.send(rng.choice(HARMLESS), source)
        if rng.random() < 0.05:
            rig.run(0.05)
    rig.run(1.0)
    assert (rig.pose.x_m, rig.pose.y_m, rig.pose.z_m, rig.pose.yaw_rad) == (1.0, 2.0, 3.0, 0.4)
    assert not rig.armed
    assert rig.newest("HEARTBEAT") is not None
    assert len(rig.vehicle.state.counts) < 20
    finite_only(rig)


@BOTH
def test_fields_at_random_neither_crash_nor_blow_up_a_flying_vehicle(personality: Personality) -> None:
    """Valid checksums with senseless content; addressed to this vehicle, but no command that may end the flight."""
    rng = random.Random(11)  # noqa: S311 - a fixed seed
    rig = Rig(personality)
    rig.run(2.0)
    rig.fly()
    kinds = ["SET_POSITION_TARGET_LOCAL_NED", "ODOMETRY", "VISION_POSITION_ESTIMATE", "OBSTACLE_DISTANCE", "PARAM_SET"]
    kinds += [
        "TIMESYNC",
        "PARAM_REQUEST_READ",
        "SET_GPS_GLOBAL_ORIGIN",
        "VISION_SPEED_ESTIMATE",
        "MISSION_REQUEST_LIST",
    ]
    before = rig.pose
    for _ in range(2000):
        for message in Decoder().messages(random_message(rng.choice(kinds), rng)):
            rig.vehicle.receive(message, rig.t_s)
        rig.run(0.01)
    assert rig.armed
    finite_only(rig)
    assert math.dist((rig.pose.x_m, rig.pose.y_m), (before.x_m, before.y_m)) < 0.5


@BOTH
def test_messages_of_other_systems_do_not_steer(personality: Personality) -> None:
    """A second vehicle's setpoints on the same port range."""
    rig = Rig(personality)
    rig.run(2.0)
    rig.fly()
    rig.offboard()
    target = rig.vehicle.state.target
    rig.streaming = None
    for _ in range(20):
        rig.send(setpoint(1.0, system=2))
        rig.send(command_long(m.MAV_CMD_NAV_LAND, system=3))
    assert rig.vehicle.state.target is target
    assert rig.mode == personality.setpoint_mode


def random_message(name: str, rng: random.Random) -> bytes:
    """A message with random bytes as its payload, addressed to this vehicle where it has an address."""
    number = next(n for n, kind in m.mavlink_map.items() if kind.msgname == name)
    kind = m.mavlink_map[number]
    payload = bytearray(rng.randbytes(kind.unpacker.size))
    at = dict(offsets(kind))
    for field in ("target_system", "target_component"):
        if field in at:
            payload[at[field]] = 1
    return packed(number, kind.crc_extra, bytes(payload))


def offsets(kind: type[Message]) -> list[tuple[str, int]]:
    """Where each field begins in the payload."""
    codes = kind.native_format.decode().lstrip("<")
    found, offset = [], 0
    for i, (field, code) in enumerate(zip(kind.ordered_fieldnames, codes, strict=True)):
        found.append((field, offset))
        length = kind.lengths[i] if code != "c" else kind.array_lengths[i]
        offset += struct.calcsize(code) * max(1, length)
    return found


def packed(number: int, crc_extra: int, payload: bytes) -> bytes:
    """A MAVLink 2 packet of system 1, component 191."""
    head = struct.pack("<BBBBBBBHB", 253, len(payload), 0, 0, 0, 1, 191, number & 0xFFFF, number >> 16)
    crc = m.x25crc(head[1:] + payload + bytes([crc_extra])).crc
    return head + payload + struct.pack("<H", crc)


def finite_only(rig: Rig) -> None:
    """No NaN came out in any field that is one number, covariances apart."""
    for _, message in rig.received:
        for name in message.get_fieldnames():
            value = getattr(message, name)
            if isinstance(value, float) and name not in ("approach_x", "approach_y", "approach_z", "param_value"):
                assert math.isfinite(value), (message.get_type(), name)
