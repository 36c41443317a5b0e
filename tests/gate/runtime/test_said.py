"""What the gate tells those who run it: the service manager, and whoever reads its lines."""

from __future__ import annotations

import os
import re
import socket
import time
from pathlib import Path

import pytest

from companion.gate.runtime.log import WAITING_LINES, Log
from companion.gate.runtime.systemd import ServiceManager


@pytest.fixture
def manager(tmp_path: Path) -> socket.socket:
    made = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    made.bind(str(tmp_path / "notify"))
    made.settimeout(5.0)
    return made


def test_the_service_manager_hears_how_it_goes(manager: socket.socket) -> None:
    with manager:
        notifier = ServiceManager({"NOTIFY_SOCKET": manager.getsockname()})
        notifier.ready()
        notifier.status("brake")
        notifier.stopping()
        assert [manager.recv(100) for _ in range(3)] == [b"READY=1", b"STATUS=brake", b"STOPPING=1"]
        notifier.close()
        notifier.close()
        notifier.ready()


def test_the_watchdog_is_fed_from_cycles_and_not_more_often_than_it_needs(manager: socket.socket) -> None:
    with manager:
        notifier = ServiceManager(
            {"NOTIFY_SOCKET": manager.getsockname(), "WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())}
        )
        for now_s in (10.0, 10.1, 10.4, 10.5, 10.6):
            notifier.cycle(now_s)
        notifier.close()
        assert [manager.recv(100) for _ in range(2)] == [b"WATCHDOG=1"] * 2
        manager.setblocking(False)
        with pytest.raises(BlockingIOError):
            manager.recv(100)


@pytest.mark.parametrize(
    "watchdog",
    [{}, {"WATCHDOG_USEC": "soon"}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}],
)
def test_a_watchdog_that_is_not_for_us_is_not_fed(manager: socket.socket, watchdog: dict[str, str]) -> None:
    with manager:
        notifier = ServiceManager({"NOTIFY_SOCKET": manager.getsockname()} | watchdog)
        notifier.cycle(10.0)
        notifier.ready()
        assert manager.recv(100) == b"READY=1"
        notifier.close()


def test_without_a_service_manager_nothing_is_said() -> None:
    notifier = ServiceManager({})
    notifier.ready()
    notifier.cycle(1.0)
    notifier.close()


def test_a_service_manager_that_is_gone_or_does_not_read_is_its_own_affair(manager: socket.socket) -> None:
    notifier = ServiceManager({"NOTIFY_SOCKET": manager.getsockname()})
    with manager:
        for _ in range(10_000):
            notifier.status("x" * 100)
    notifier.ready()
    notifier.close()
    nobody = ServiceManager({"NOTIFY_SOCKET": "@companion-nobody"})
    nobody.ready()
    nobody.close()


# Lines are written whole and in order; a reader that does not read delays nothing and is told what it missed.


def test_lines_come_in_order_with_the_time_of_day() -> None:
    reading, writing = os.pipe()
    log = Log(writing, wall_clock=lambda: 1_700_000_000.0625)
    for number in range(3):
        log.say(f"line {number}")
    log.close(5.0)
    lines = os.read(reading, 4096).decode().splitlines()
    assert [line.partition(" gate: ")[2] for line in lines] == ["line 0", "line 1", "line 2"]
    assert all(re.match(r"\d\d:\d\d:20\.062 gate: ", line) for line in lines)
    os.close(reading)
    os.close(writing)


def test_a_full_pipe_delays_nobody_and_the_loss_is_told() -> None:
    reading, writing = os.pipe()
    log = Log(writing)
    # More than the pipe and the queue hold.
    began_s = time.monotonic()
    for _ in range(WAITING_LINES * 3):
        log.say("x" * 1000)
    took_s = time.monotonic() - began_s
    assert log.lost > 0
    log.close(0.05)
    # Far below what a person would need to read it: nobody waited for that.
    assert took_s < 2.0
    os.set_blocking(reading, True)
    taken = b""
    while b"lost" not in taken or not taken.endswith(b"\n"):
        taken += os.read(reading, 1 << 20)
        log.close(0.2)
    assert f"{log.lost} lines of the gate were lost".encode() in taken
    os.close(reading)
    os.close(writing)


def test_a_terminal_that_is_gone_ends_nothing() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    log = Log(writing)
    log.say("nobody")
    log.say("reads this")
    log.close(5.0)
    assert log.lost == 0
    os.close(writing)


def test_a_line_longer_than_the_pipe_is_written_in_parts() -> None:
    reading, writing = os.pipe()
    log = Log(writing)
    log.say("y" * 200_000)
    taken = b""
    while not taken.endswith(b"\n"):
        taken += os.read(reading, 1 << 20)
    assert taken.count(b"y") == 200_000
    log.close(5.0)
    os.close(reading)
    os.close(writing)
