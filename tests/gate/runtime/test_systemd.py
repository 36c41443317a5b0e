"""What the service manager hears: it must be able to trust that silence means a gate that does not turn."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

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
    [
        {},
        {"WATCHDOG_USEC": "soon"},
        {"WATCHDOG_USEC": "0"},
        {"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"},
    ],
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
