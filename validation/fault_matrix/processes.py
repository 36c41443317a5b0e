"""What the kernel tells of the processes of a flight: who is whose child, and who listens where."""

from __future__ import annotations

import contextlib
import socket
from pathlib import Path

import psutil

_PROC = Path("/proc")


def children(pid: int) -> list[int]:
    """Of a process, oldest first; none when it is gone."""
    found: list[int] = []
    with contextlib.suppress(OSError):
        for thread in sorted((_PROC / str(pid) / "task").iterdir()):
            found += [int(child) for child in (thread / "children").read_text().split()]
    return found


def map_process(application: int) -> int | None:
    """The child that holds the map; multiprocessing keeps another one for itself."""
    for child in children(application):
        with contextlib.suppress(OSError):
            if b"spawn_main" in (_PROC / str(child) / "cmdline").read_bytes():
                return child
    return None


def family(pid: int) -> list[int]:
    """A process and all that it has started, and they."""
    found = [pid]
    for member in found:
        found += children(member)
    return found


def open_sockets(pid: int) -> set[tuple[str, int]]:
    """Where a process and all that it has started can be spoken to: ("udp" or "tcp", port), TCP where it listens."""
    found = set()
    for member in family(pid):
        with contextlib.suppress(psutil.Error):
            for one in psutil.Process(member).net_connections("inet"):
                if one.type == socket.SOCK_DGRAM:
                    found.add(("udp", one.laddr.port))
                elif one.status == psutil.CONN_LISTEN:
                    found.add(("tcp", one.laddr.port))
    return found
