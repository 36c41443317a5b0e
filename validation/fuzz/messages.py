"""MAVLink messages without sense, from strangers, old or extreme, into everything that listens in flight."""

from __future__ import annotations

import asyncio
import random
from typing import Any

from companion.mavlink.firmware import AutopilotKind
from companion.perception.extract import POSE_STALE_S
from validation.fuzz.flying import SETTINGS, Flying, flying
from validation.fuzz.hostile import extreme, no_number, without_sense

NEEDED: dict[str, tuple[str, ...]] = {
    "HEARTBEAT": ("base_mode", "custom_mode"),
    "ATTITUDE": ("time_boot_ms", "roll", "pitch", "yaw", "yawspeed"),
    "LOCAL_POSITION_NED": ("time_boot_ms", "x", "y", "z", "vx", "vy", "vz"),
    "TIMESYNC": ("tc1", "ts1"),
    "STATUSTEXT": ("severity", "text"),
    "COMMAND_ACK": ("command", "result"),
    "PARAM_VALUE": ("param_id", "param_value"),
    "SYS_STATUS": ("battery_remaining",),
    "BATTERY_STATUS": ("battery_remaining",),
    "EXTENDED_SYS_STATE": ("landed_state",),
    "ESTIMATOR_STATUS": ("flags",),
    "EKF_STATUS_REPORT": ("flags",),
    "AUTOPILOT_VERSION": ("flight_sw_version",),
    "DISTANCE_SENSOR": ("current_distance", "min_distance", "max_distance", "orientation"),
    "OBSTACLE_DISTANCE": ("max_distance", "frame"),
    "COMMAND_LONG": ("command", "target_system", "target_component"),
    "COMMAND_INT": ("command", "target_system", "target_component"),
}
"""Every message that the application reads, and the fields without which it means nothing."""

GIVEN_UP_S = 0.15
"""Two ticks and the delay of the last image, on top of each age at which an input counts as stale."""


def true_fields(bench: Flying, name: str) -> dict[str, Any]:
    """What our autopilot would say now."""
    match name:
        case "HEARTBEAT":
            return bench.heartbeat()
        case "ATTITUDE":
            return bench.attitude()
        case "LOCAL_POSITION_NED":
            return bench.position()
        case "DISTANCE_SENSOR":
            return bench.distance()
        case "TIMESYNC":
            return {"tc1": 123456789, "ts1": 987654321}
        case "STATUSTEXT":
            return {"severity": 6, "text": "all is well", "id": 0, "chunk_seq": 0}
        case "COMMAND_ACK":
            return {"command": 400, "result": 0, "target_system": 1, "target_component": 191}
        case "PARAM_VALUE":
            return {
                "param_id": "COM_OF_LOSS_T",
                "param_value": 0.5,
                "param_type": 9,
                "param_count": 3,
                "param_index": 1,
            }
        case "OBSTACLE_DISTANCE":
            return {"time_usec": 0, "distances": [500] * 72, "increment": 5, "increment_f": 5.0} | {
                "min_distance": 20,
                "max_distance": 1200,
                "angle_offset": 0.0,
                "frame": 12,
            }
        case "COMMAND_LONG" | "COMMAND_INT":
            return {"command": 300, "target_system": 1, "target_component": 191, "param1": 1.0}
        case "AUTOPILOT_VERSION":
            return {"flight_sw_version": 0x010F00FF}
        case _:
            (needed,) = NEEDED[name]
            return {needed: 50}


def harmless(rng: random.Random, bench: Flying, repeats: bool = True) -> None:
    """One message that must change nothing: without sense, from a stranger, or the true heartbeat once more."""
    name = rng.choice(list(NEEDED))
    fields = true_fields(bench, name)
    if name.startswith("COMMAND_") and name != "COMMAND_ACK":
        _harmless_command(rng, bench, name, fields)
        return
    stranger = rng.random() < 0.4
    system_id, component_id = 1, 1
    if stranger:
        fields = {key: extreme(rng, value) for key, value in fields.items()}
        system_id, component_id = rng.choice(((2, 1), (255, 190), (0, 0), (7, 191), (1, 191), (1, 0), (1, 100)))
        if name in ("DISTANCE_SENSOR", "OBSTACLE_DISTANCE"):
            system_id = 2  # of our system any component may measure
    elif name != "HEARTBEAT" or not repeats or rng.random() < 0.5:
        # Not a whole number of another size: that is a mode, and another one.
        fields = without_sense(rng, fields, NEEDED[name])
        if name == "HEARTBEAT" and all(type(fields.get(key)) is int for key in NEEDED[name]):
            return
        if name == "TIMESYNC" or (name == "OBSTACLE_DISTANCE" and rng.random() < 0.3):
            fields["frame"] = 0
    bench.link.deliver(name, fields, system_id, component_id)


def _harmless_command(rng: random.Random, bench: Flying, name: str, fields: dict[str, Any]) -> None:
    what = rng.randrange(3)
    if what == 0:
        fields["target_system"], fields["target_component"] = rng.choice(((0, 0), (1, 1), (2, 191), (1, 0), (255, 191)))
    elif what == 1:
        fields["command"] = rng.choice((0, 22, 176, 400, 246, 65535, 193, no_number(rng), 300.0, "300"))
        fields["param1"] = rng.choice((1.0, -1.0, no_number(rng)))
    else:
        fields = without_sense(rng, fields, NEEDED[name])
    bench.link.deliver(name, fields, rng.choice((1, 2, 255, 0)), rng.choice((1, 190, 0)))


def poison(rng: random.Random, bench: Flying, received: list[tuple[str, dict[str, Any]]]) -> None:
    """One message of our own autopilot with any numbers in it, or an old one again."""
    if received and rng.random() < 0.3:
        for name, fields in rng.choices(received, k=rng.choice((1, 1, 8))):
            bench.link.deliver(name, fields)
        return
    name = rng.choice([name for name in NEEDED if not name.startswith("COMMAND_")])
    fields = true_fields(bench, name)
    if rng.random() < 0.3:
        received.append((name, fields))
        del received[:-200]
    for key in rng.sample(list(fields), rng.randint(1, len(fields))):
        fields[key] = extreme(rng, fields[key])
    bench.link.deliver(name, fields)


def nothing_changes(rng: random.Random) -> None:
    """While true inputs come the flight goes on, none is missed without them, and only a true takeover is one."""
    asyncio.run(_nothing_changes(rng))


async def _nothing_changes(rng: random.Random) -> None:
    kind = rng.choice(list(AutopilotKind))
    async with flying(kind) as bench:
        sent = moving = 0
        for _ in range(40):
            for _ in range(2):
                bench.step()
                _send(rng, bench)
            record = bench.tick()
            sent += record.sent
            moving += bench.moves(record.setpoint)
            _still_ours(bench)
            if record.observation is not None:
                _is_true(bench, record.observation.pose)
        assert sent >= 36, sent
        assert moving >= 30, moving
        lost = rng.choice(("pose", "depth", "down", "heartbeat"))
        longest_s = {
            "pose": POSE_STALE_S,
            "depth": SETTINGS.sensors.scan.stale_after_s,
            "down": SETTINGS.sensors.beams.stale_after_s,
            "heartbeat": SETTINGS.safety.stale.heartbeat_s + 1.0,
        }[lost]
        bench.good.discard(lost)
        lost_s = bench.clock.now_s()
        while (gone_s := bench.clock.now_s() - lost_s) < longest_s + 1.0:
            for _ in range(2):
                bench.step()
                if lost != "heartbeat" or rng.random() < 0.2:
                    _send(rng, bench, but=lost)
            record = bench.tick()
            if gone_s > longest_s + GIVEN_UP_S:
                assert not (record.sent and _steers(record.setpoint)), (lost, gone_s, record.setpoint, record.missing)
                if lost in ("pose", "heartbeat"):
                    assert not record.sent, (lost, gone_s)
            _still_ours(bench)
        bench.good.add(lost)
        bench.mode = bench.modes.land
        bench.link.deliver("HEARTBEAT", bench.heartbeat())
        bench.mode = bench.modes.offboard
        for _ in range(10):
            bench.step()
            _send(rng, bench)
            bench.link.deliver("HEARTBEAT", bench.heartbeat())
            assert not bench.tick().sent
        assert bench.vehicle.taken_over


def _send(rng: random.Random, bench: Flying, but: str = "") -> None:
    for _ in range(rng.randrange(6)):
        harmless(rng, bench, repeats=but != "heartbeat")


def _steers(setpoint: Any) -> bool:
    return setpoint is not None and (setpoint.speed_mps != 0.0 or setpoint.yaw_rate_radps != 0.0)


def _still_ours(bench: Flying) -> None:
    assert bench.vehicle.taken_over is None
    state = bench.telemetry.state(bench.clock.now_s())
    assert state.armed
    assert state.mode in ("offboard", "guided")
    assert not bench.operator.start.is_set()
    assert not bench.operator.stop.is_set()


def _is_true(bench: Flying, pose: Any) -> None:
    assert abs(pose.y_m - bench.north_m()) < 0.1, (pose, bench.north_m())
    assert abs(pose.x_m) < 0.01
    assert abs(pose.z_m - 1.5) < 0.01


def anything_our_autopilot_says(rng: random.Random) -> None:
    """Numbers at random from our own autopilot, and its old messages: wrong, but bounded; a takeover stays one."""
    asyncio.run(_anything(rng))


async def _anything(rng: random.Random) -> None:
    async with flying(rng.choice(list(AutopilotKind))) as bench:
        received: list[tuple[str, dict[str, Any]]] = []
        taken = False
        for _ in range(80):
            bench.step()
            for _ in range(rng.randrange(6)):
                poison(rng, bench, received)
            bench.good = {name for name in ("pose", "depth", "down", "heartbeat") if rng.random() < 0.8}
            record = bench.tick()
            assert not (taken and record.sent)
            taken = bench.vehicle.taken_over is not None


def nothing_begins(rng: random.Random) -> None:
    """On the ground: nothing that should change nothing starts a flight, and no setpoint leaves."""
    asyncio.run(_nothing_begins(rng))


async def _nothing_begins(rng: random.Random) -> None:
    async with flying(explore=False) as bench:
        received: list[tuple[str, dict[str, Any]]] = []
        for _ in range(40):
            bench.step()
            for _ in range(rng.randrange(8)):
                harmless(rng, bench)
                poison(rng, bench, received)
            record = bench.tick()
            assert record.setpoint is None
            assert not bench.operator.start.is_set()
            assert not bench.operator.stop.is_set()
        assert bench.link.commands == []
