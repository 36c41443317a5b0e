"""What goes wrong inside the application: each fault has a name, sent to a port of its own process.

It reaches past every check that the application has of itself: what is sent here leaves through its own connection, as
if the code in front of it were wrong.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import math
import os
import socket
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from companion.autopilot.link import MavsdkLink
from companion.gate.protocol import GATE_FD
from companion.mavlink.codec import Encoder

LOOPBACK = "127.0.0.1"
SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"
HANG_S = 5.0
FLOOD_HZ, FLOOD_S = 10_000.0, 10.0
BURST = 100
NTP_STEP_S = 3600.0
OTHER_VEHICLE = 7
LOCAL_NED, POSITION_TOO = 1, 0x5C0
"""Velocities would be north and east; and the vehicle would fly to the origin besides."""

Fields = Mapping[str, Any]


class SabotageError(Exception):
    """Raised in the middle of a tick, as a bug would be."""


class _Faults:
    """What is wrong now.

    Attributes:
        careless: the navigator ignores distances and missing inputs.
        spoil: what is made of the fields of each setpoint before it leaves.
        go: set when the flight may begin.
    """

    def __init__(self) -> None:
        self.careless = False
        self.go = threading.Event()
        self.spoil: Callable[[Fields], Fields] | None = None
        self.raise_in_tick = False
        self.loop: asyncio.AbstractEventLoop | None = None

    def tick(self) -> None:
        """Called in each tick of the navigator."""
        with contextlib.suppress(RuntimeError):  # the warming up runs outside of any loop
            self.loop = asyncio.get_running_loop()
        if self.raise_in_tick:
            raise SabotageError("an error in the tick")


FAULTS = _Faults()
"""Of this process."""


def install(port: int) -> None:
    """Listen for words, and stand between the application and its link."""
    _spoil_what_is_sent()
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind((LOOPBACK, port))
    threading.Thread(target=_listen, args=(listener,), name="faults", daemon=True).start()


def _listen(listener: socket.socket) -> None:
    while True:
        word = listener.recv(256).decode()
        _WORDS[word](listener)


def _spoil_what_is_sent() -> None:
    send = MavsdkLink.send

    def spoiled(link: MavsdkLink, name: str, fields: Fields) -> None:
        spoil = FAULTS.spoil
        send(link, name, spoil(fields) if spoil is not None and name == SETPOINT else fields)

    setattr(MavsdkLink, "send", spoiled)  # noqa: B010 - a plain assignment is none that types allow


def _block_loop(_: socket.socket) -> None:
    assert FAULTS.loop is not None
    FAULTS.loop.call_soon_threadsafe(time.sleep, HANG_S)


def _hold_interpreter(_: socket.socket) -> None:
    # Unlike ctypes.CDLL, PyDLL keeps the interpreter's lock during the call.
    ctypes.PyDLL(None).sleep(int(HANG_S))


def _raise(_: socket.socket) -> None:
    FAULTS.raise_in_tick = True


def _careless(_: socket.socket) -> None:
    FAULTS.careless = True


def _spoiled(**changes: Any) -> Callable[[socket.socket], None]:
    def begin(_: socket.socket) -> None:
        FAULTS.spoil = lambda fields: {**fields, **changes}

    return begin


def _tenfold(_: socket.socket) -> None:
    FAULTS.spoil = lambda fields: {**fields, "vx": 10.0 * fields["vx"]}


def _flood(_: socket.socket) -> None:
    """Setpoints at full speed, past MAVSDK, which could not send so many, but over its own socket."""
    encoder = Encoder(1, 191)
    packet = encoder.pack(SETPOINT, target_system=1, target_component=1, coordinate_frame=8, type_mask=0x5C7, vx=0.5)
    with socket.socket(fileno=os.dup(int(os.environ[GATE_FD]))) as end:
        due_s = time.monotonic()
        end_s = due_s + FLOOD_S
        while due_s < end_s:
            for _number in range(BURST):
                with contextlib.suppress(OSError):
                    end.send(packet, socket.MSG_DONTWAIT)
            due_s += BURST / FLOOD_HZ
            time.sleep(max(0.0, due_s - time.monotonic()))


def _step_clock(_: socket.socket) -> None:
    """As a time server would, for everything in this process that asks Python for the time of day."""
    now_s, now_ns = time.time, time.time_ns
    time.time = lambda: now_s() + NTP_STEP_S
    time.time_ns = lambda: now_ns() + int(NTP_STEP_S * 1e9)


_WORDS: dict[str, Callable[[socket.socket], None]] = {
    "go": lambda _: FAULTS.go.set(),
    "block": _block_loop,
    "hold": _hold_interpreter,
    "raise": _raise,
    "careless": _careless,
    "nan": _spoiled(vx=math.nan),
    "tenfold": _tenfold,
    "frame": _spoiled(coordinate_frame=LOCAL_NED),
    "mask": _spoiled(type_mask=POSITION_TOO),
    "other vehicle": _spoiled(target_system=OTHER_VEHICLE),
    "flood": _flood,
    "clock": _step_clock,
}
