"""Links in flight: one that loses packets, one that dies and comes back, one that is signed."""

from __future__ import annotations

import math
import subprocess
import time
from pathlib import Path

import pytest

from sitl.launch.processes import command, environment, free_udp_ports
from tests.integration.relay import LOOPBACK
from tests.integration.rig import BOOT_S, HEIGHT_M, SILENCE, Stage, aboard, both, fly_all, process, wait_for_words
from tests.integration.witness import apart_m, speed_mps
from tests.shared.beside import until

LOST_SHARE = 0.05
DEAD_S = 10.0


@pytest.mark.flight
@pytest.mark.timeout(120)
async def test_five_percent_of_lost_packets_do_not_end_a_flight(tmp_path: Path) -> None:
    """Protects a flight over a radio: questions are asked again, and lost setpoints are few."""
    with both(tmp_path, LOST_SHARE) as stages:
        await fly_all(stages, _fly_lossy)


async def _fly_lossy(ours: Stage) -> None:
    relay, witness = ours.relay, ours.witness
    async with aboard(ours.port) as flight, flight.vehicle as vehicle:
        await flight.fly()
        assert await flight.stream(4.0, 0.4) > 50
        assert witness.speed_at(time.monotonic() - 0.2) > 0.25, "it follows"
        residual_s = flight.telemetry.clock_residual_s
        assert residual_s is not None
        assert residual_s < 0.03, "what pre-flight demands"
        assert await vehicle.land(), "landed and disarmed, and the application knows it"
        assert not vehicle.taken_over
    assert not witness.armed
    for lost, passed in zip(relay.lost, relay.passed, strict=True):
        sent = lost + passed
        # Four standard deviations: some hundred datagrams are few.
        assert abs(lost - LOST_SHARE * sent) < 4.0 * math.sqrt(LOST_SHARE * (1.0 - LOST_SHARE) * sent), (
            "the link did lose"
        )
        assert lost > 0


@pytest.mark.flight
@pytest.mark.timeout(120)
async def test_a_link_that_dies_stops_the_vehicle_and_gives_back_only_what_is_still_ours(tmp_path: Path) -> None:
    """Protects the ten seconds in which nothing passes either way, and the moment after.

    The autopilot stops by itself. When the link is back PX4 says that its failsafe has the vehicle, and it stays there;
    ArduPilot is still in guided, so the flight may go on.
    """
    with both(tmp_path) as stages:
        await fly_all(stages, _fly_through_an_outage)


async def _fly_through_an_outage(ours: Stage) -> None:
    personality, relay, witness = ours.personality, ours.relay, ours.witness
    async with aboard(ours.port) as flight, flight.vehicle as vehicle:
        await flight.fly()
        assert await flight.stream(2.0, 0.5) > 25
        relay.dead = True
        died_s = time.monotonic()
        assert witness.speed_at(died_s) > 0.3
        await flight.stream(DEAD_S, 0.5)

        assert vehicle._offboard.silent_because is not None
        assert "no heartbeat" in vehicle._offboard.silent_because
        assert relay.seen.setpoints(died_s + 4.5) == [], "no setpoints into a dead link"
        dead = [pose for pose in tuple(witness.poses) if pose.t_s > died_s + 3.0]
        assert max(map(speed_mps, dead)) < 0.15
        assert apart_m(witness.pose_at(died_s), witness.pose()) < 0.9
        assert abs(witness.pose().z_m - HEIGHT_M) < 0.5
        assert flight.telemetry.state(flight.clock.now_s()).pose_age_s > 9.0, "and nothing old is taken for new"

        relay.dead = False
        back_s = time.monotonic()
        await until(lambda: flight.telemetry.state(flight.clock.now_s()).pose_age_s < 0.2, "poses again", 3.0)
        sent = await flight.stream(3.0, 0.5)
        if personality == "px4":
            assert vehicle.taken_over == "hold"
            assert (sent, relay.seen.setpoints(back_s)) == (0, [])
            assert (witness.mode, witness.armed) == ("hold", True)
        else:
            assert not vehicle.taken_over
            assert sent > 15
            assert witness.speed_at(time.monotonic() - 0.2) > 0.2
            assert flight.telemetry.restarts == 0, "it was silent, not rebooted"


# A signed link from end to end: an autopilot that drops everything unsigned, and the gate that signs and checks.


def key_file(file: Path, key: str) -> Path:
    file.write_text(key * 32)
    file.chmod(0o600)
    return file


@pytest.mark.flight
@pytest.mark.parametrize(("gates_key", "found", "patience_s"), [("7c", True, 8.0), ("11", False, 3.0)])
def test_only_who_has_the_key_is_accepted(gates_key: str, found: bool, patience_s: float, tmp_path: Path) -> None:
    """Protects both directions: the autopilot obeys only the key, and what it says is believed only with it."""
    (port,) = free_udp_ports(1)
    log = tmp_path / "autopilot.log"
    stub = [
        *command("sitl", "autopilot", "--personality", "px4", "--boot-s", str(BOOT_S), "--to", f"{LOOPBACK}:{port}"),
        *(part for parameter in SILENCE["px4"] for part in ("--param", parameter)),
        *("--signing-key", str(key_file(tmp_path / "autopilot.key", "7c"))),
    ]
    config = tmp_path / "vehicle.yaml"
    config.write_text(
        f"autopilot:\n  url: udpin://{LOOPBACK}:{port}\n  connect_timeout_s: {patience_s}\n  ready_timeout_s: 5.0\n"
        f"record:\n  folder: {tmp_path}\n"
        f"safety:\n  signing:\n    key_file: {key_file(tmp_path / 'gate.key', gates_key)}\n"
    )
    with process(log, stub) as running:
        wait_for_words(log, running, "standing at", 60.0)
        checked = subprocess.run(
            command("check", "--config", str(config)), env=environment(), check=False, capture_output=True, text=True
        )
    said = checked.stdout + checked.stderr
    assert checked.returncode == 1, "there are no sensors"
    assert ("autopilot         px4 " in said) == found, said
    assert ("no autopilot of system 1" in said) != found, said
    if found:
        # A parameter that is read shows that questions arrive as well as answers.
        assert "COM_OF_LOSS_T" in said
