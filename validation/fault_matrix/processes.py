"""The processes of a flight: who is whose child, and which ports they have bound."""

from __future__ import annotations

import contextlib
import socket

import psutil


def children(pid: int) -> list[int]:
    """The children of a process, oldest first; none when it is gone."""
    return [child.pid for child in _children(pid)]


def map_process(application: int) -> int | None:
    """The child that holds the map; multiprocessing keeps another one for itself."""
    for child in _children(application):
        with contextlib.suppress(psutil.Error):
            if any("spawn_main" in word for word in child.cmdline()):
                return child.pid
    return None


def open_sockets(pid: int) -> set[tuple[str, int]]:
    """Where a process and all that it has started can be spoken to: ("udp" or "tcp", port), TCP where it listens."""
    found = set()
    for process in _family(pid):
        with contextlib.suppress(psutil.Error):
            for one in process.net_connections("inet"):
                if one.type == socket.SOCK_DGRAM:
                    found.add(("udp", one.laddr.port))
                elif one.status == psutil.CONN_LISTEN:
                    found.add(("tcp", one.laddr.port))
    return found


def _family(pid: int) -> list[psutil.Process]:
    try:
        own = psutil.Process(pid)
        return [own, *own.children(recursive=True)]
    except psutil.NoSuchProcess:
        return []


def _children(pid: int) -> list[psutil.Process]:
    try:
        return sorted(psutil.Process(pid).children(), key=psutil.Process.create_time)
    except psutil.NoSuchProcess:
        return []
