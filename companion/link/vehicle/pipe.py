"""What application and process of the link say to each other: packets over a socket pair, none of which ever waits."""

from __future__ import annotations

import enum
import fcntl
import socket
import struct
import termios
from contextlib import suppress

PACKET_BYTES = 200_000
"""None is larger."""


class Kind(enum.IntEnum):
    """What a packet says, in its first byte."""

    TELEMETRY = 1
    """Down: the newest."""
    DRAWING = 2
    """Down: graph and frontiers."""
    ANSWER = 3
    """Down: the number of an order, 32 letters, and what became of it."""
    END = 4
    """Down: the flight is over; what is missing at the ground may still be fetched."""
    ORDER = 5
    """Up: an order that may be obeyed."""
    REFUSED = 6
    """Up: one that was refused, in words."""
    BEAT = 7
    """Up, twice a second: how long ago the ground was heard, in s; "inf" before."""
    TROUBLE = 8
    """Up: what is wrong with the link, in words; empty: nothing any more."""
    FLEET = 9
    """Both ways: what one vehicle tells the others."""
    FLEET_GROUND = 10
    """Down: likewise, with what it has seen of the ground, which is larger and may be later."""
    FLEET_REFUSED = 11
    """Up: how many more messages of other vehicles were refused, a space, and why the last one."""


def pair() -> tuple[socket.socket, socket.socket]:
    """Both ends; what was sent before one end is closed is still read."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in (ours, theirs):
        # What the system does not grant is a drawing that does not go over, and nothing else.
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2 * PACKET_BYTES)
    ours.setblocking(False)
    return ours, theirs


def send(end: socket.socket, kind: Kind, data: bytes = b"") -> bool:
    """Send a packet now; false when there is no room for it, or nobody at the other end."""
    try:
        end.send(bytes([kind]) + data, socket.MSG_NOSIGNAL | socket.MSG_DONTWAIT)
    except OSError:
        return False
    return True


def unread_bytes(end: socket.socket) -> int:
    """What was sent and not received yet, with what the system needs to keep it."""
    (count,) = struct.unpack("i", fcntl.ioctl(end, termios.TIOCOUTQ, bytes(4)))
    return int(count)


def receive(end: socket.socket) -> tuple[Kind, bytes] | None:
    """The next packet of those that have come; None when there is none.

    Raises:
        EOFError: there is nobody at the other end any more.
    """
    with suppress(BlockingIOError):
        try:
            data = end.recv(PACKET_BYTES + 1, socket.MSG_DONTWAIT)
        except ConnectionResetError:
            # Told once, when the other end was closed with something unread; what it had sent before comes after that.
            data = end.recv(PACKET_BYTES + 1, socket.MSG_DONTWAIT)
        if not data:
            raise EOFError
        return Kind(data[0]), data[1:]
    return None
