"""What goes wrong with the tracker while it runs: it is what a fault flight rests on."""

from __future__ import annotations

import asyncio
import math
import socket
from dataclasses import replace

import numpy as np
import pytest

from companion.errors import InputError
from companion.model import Pose
from sitl.launch.processes import free_udp_ports
from sitl.world.odometry import Estimate, Odometry, OdometrySettings
from sitl.world.trouble import Trouble, commanded
from tests.shared.beside import until

PERFECT = OdometrySettings(position_noise_m=0.0, attitude_noise_rad=0.0, velocity_noise_mps=0.0, drift_share=0.0)
START = Pose(10.0, 3.0, 4.0, 1.0, 0.7)
SPEED_MPS = 0.5


def _flown(trouble: Trouble, then: Trouble | None = None) -> list[Estimate]:
    """Straight ahead for 4 s at 50 Hz: good for a second, in trouble for two, and then once more something else."""
    tracker = Odometry(PERFECT, np.random.default_rng(1))
    out = []
    for i in range(200):
        if i == 50:
            tracker.begin(trouble)
        if i == 150 and then is not None:
            tracker.begin(then)
        way_m = SPEED_MPS * i / 50.0
        forward = math.cos(START.yaw_rad), math.sin(START.yaw_rad)
        true = replace(
            START,
            t_s=START.t_s + i / 50.0,
            x_m=START.x_m + way_m * forward[0],
            y_m=START.y_m + way_m * forward[1],
            vx_mps=SPEED_MPS * forward[0],
            vy_mps=SPEED_MPS * forward[1],
        )
        tracker.observe(true, 0.0)
        out += tracker.due(true.t_s)
    return out


def _after(estimates: list[Estimate], since_s: float) -> list[Estimate]:
    return [one for one in estimates if one.pose.t_s >= START.t_s + since_s]


def test_what_is_lost_stays_away_and_comes_back_in_a_new_frame() -> None:
    """Protects the fault "odometry lost": silence, and no estimate of the old frame afterwards."""
    flown = _flown(Trouble(lost=True), Trouble())

    assert not [one for one in _after(flown, 1.0) if one.pose.t_s < START.t_s + 2.99]
    (back, *_) = _after(flown, 2.99)
    assert (back.pose.x_m, back.pose.y_m, back.resets) == (0.0, 0.0, 1)


def test_what_is_frozen_repeats_itself_with_new_stamps() -> None:
    """Protects the fault "odometry frozen": the same to the last bit, with stamps that go on."""
    frozen = _after(_flown(Trouble(frozen=True)), 1.0)

    assert len({one.pose.t_s for one in frozen}) == len(frozen) > 80
    assert len({replace(one.pose, t_s=0.0) for one in frozen}) == 1
    assert frozen[0].pose.y_m == pytest.approx(SPEED_MPS, abs=0.02)


def test_what_diverges_falls_behind_in_place_and_velocity_alike() -> None:
    """Protects the fault "odometry diverging": consistent with itself, or an estimator would find it at once."""
    last = _flown(Trouble(diverging_mps=0.2))[-1].pose

    assert last.vy_mps == pytest.approx(SPEED_MPS - 0.2)
    since_s = last.t_s - START.t_s
    assert last.y_m == pytest.approx(SPEED_MPS * since_s - 0.2 * (since_s - 1.0), abs=0.01)
    assert last.x_m == pytest.approx(0.0, abs=1e-9)


def test_what_jumps_is_beside_itself_and_counts_no_reset() -> None:
    """Protects the fault "odometry jumping": a correction that nobody announces."""
    flown = _flown(Trouble(jump_m=1.0))

    before = [one.pose.x_m for one in flown if one.pose.t_s < START.t_s + 0.99]
    after = [one.pose.x_m for one in _after(flown, 1.0)]
    assert before == pytest.approx([0.0] * len(before), abs=1e-9)
    assert after == pytest.approx([-1.0] * len(after))
    assert {one.resets for one in flown} == {0}


@pytest.mark.parametrize("text", ["", "odometry", "odometry jump", "odometry jump x", "odometry jump nan", "gps off"])
def test_what_is_no_command_is_refused_with_what_there_is(text: str) -> None:
    """Protects the hand of a test: a fault that was misspelt must not pass for a fault without effect."""
    with pytest.raises(InputError, match=r"odometry good \| lost"):
        Trouble.parse(text)


async def test_commands_come_in_over_udp(caplog: pytest.LogCaptureFixture) -> None:
    """Protects the way from the command line, and the world from nonsense on its port."""
    (port,) = free_udp_ports(1)
    begun: list[Trouble] = []
    async with commanded(None, begun.append), commanded(port, begun.append):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hand:
            for words in (b"\xff\xff", b"odometry diverging 0.2"):
                hand.sendto(words, ("127.0.0.1", port))
        await until(lambda: begun)
        with pytest.raises(InputError, match=f"--control {port}"):
            async with commanded(port, begun.append):
                await asyncio.sleep(0.0)
    assert begun == [Trouble(diverging_mps=0.2)]
    assert "the world knows odometry" in caplog.text
