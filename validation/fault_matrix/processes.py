"""What the kernel tells of the processes of a flight: who is whose child, and who listens where."""

from __future__ import annotations

import contextlib
from pathlib import Path

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


def udp_ports(pid: int) -> set[int]:
    """The UDP ports of this computer, IPv4, that a process has bound."""
    inodes = set()
    for entry in (_PROC / str(pid) / "fd").iterdir():
        with contextlib.suppress(OSError):
            target = str(entry.readlink())
            if target.startswith("socket:["):
                inodes.add(target[8:-1])
    rows = (_PROC / "net" / "udp").read_text().splitlines()[1:]
    return {int(row.split()[1].partition(":")[2], 16) for row in rows if row.split()[9] in inodes}
