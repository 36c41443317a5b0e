"""Whose socket a UDP port of this computer is, by the word of the kernel."""

from __future__ import annotations

import contextlib
from pathlib import Path

_PROC = Path("/proc")
_LOOPBACK = frozenset(
    {
        "0100007F",  # 127.0.0.1
        "00000000",  # any
        "0" * 32,  # any, of a socket for both protocols
        "0000000000000000FFFF00000100007F",  # ::ffff:127.0.0.1
    }
)
"""Local addresses from which a datagram can come to us over 127.0.0.1; little-endian words, as on every machine that
this runs on."""


def holds(pid: int, port: int) -> bool:
    """Whether the process has this port of 127.0.0.1, and nobody else has it too."""
    sockets = _sockets(port)
    return bool(sockets) and sockets <= _open_sockets(pid)


def _sockets(port: int) -> set[str]:
    """Numbers (inodes) of all sockets that can send from this port to 127.0.0.1."""
    found: set[str] = set()
    for table in ("net/udp", "net/udp6"):
        try:
            lines = _PROC.joinpath(table).read_text(encoding="ascii").splitlines()[1:]
        except OSError:
            continue  # no IPv6 here
        for line in lines:
            words = line.split()
            address, _, its_port = words[1].partition(":")
            if int(its_port, 16) == port and address in _LOOPBACK:
                found.add(words[9])
    return found


def _open_sockets(pid: int) -> set[str]:
    found: set[str] = set()
    # It may end, or close something, while it is looked at.
    with contextlib.suppress(OSError):
        for entry in _PROC.joinpath(str(pid), "fd").iterdir():
            with contextlib.suppress(OSError):
                what = str(entry.readlink())
                if what.startswith("socket:["):
                    found.add(what[8:-1])
    return found
