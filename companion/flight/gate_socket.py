"""The application's end of the one socket to the gate: MAVLink and words go out, MAVLink and notices come in.

A thread of its own reads it, so that what arrives is stamped when it arrives, however busy the event loop is.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import socket
import threading
from collections import deque
from collections.abc import Callable

from companion.errors import InputError
from companion.gate.protocol import GATE_FD, PACKET_BYTES, Beat, Goodbye, Notice, is_mavlink
from companion.text_table import printable

NOTICES = 64
"""That may wait to be looked at; the newest are kept."""


class GateSocket:
    """Never waits, never raises: who flies must not be held up by who watches.

    Implements `companion.autopilot.interface.Transport`: the gate stands in for the autopilot.

    Args:
        end: one end of an AF_UNIX SOCK_SEQPACKET pair, whose other end the gate has.

    Attributes:
        gone: whether the gate has closed its end, which it does only by dying: nothing that is sent arrives any more.
        unsent: messages and words for which there was no room.
        stage: the newest notice, whatever became of those before; None before the first.
    """

    def __init__(self, end: socket.socket) -> None:
        self.gone = False
        self.unsent = 0
        self.stage: Notice | None = None
        self._notices: deque[Notice] = deque(maxlen=NOTICES)
        self._on_frames: Callable[[bytes], None] = _nothing
        self._calling = threading.Lock()
        self._end = end
        self._end.setblocking(True)
        self._reader = threading.Thread(target=self._read, name="gate", daemon=True)
        self._reader.start()

    @classmethod
    def from_environment(cls) -> GateSocket:
        """What the gate gave its child.

        Raises:
            InputError: it was not the gate that started this process, or the environment names no socket.
        """
        number = os.environ.get(GATE_FD)
        if number is None:
            raise InputError("there is no gate, and without it nothing flies: start with `companion run`")
        try:
            end = socket.socket(fileno=int(number))
            # Held by a process of ours that outlives us, it would hide from the gate that we are gone.
            end.set_inheritable(False)
            return cls(end)
        except (ValueError, OSError) as error:
            raise InputError(
                f"{GATE_FD} = {number} in the environment is not the socket of a gate ({error}): start with "
                "`companion run`"
            ) from None

    def open(self, on_frames: Callable[[bytes], None]) -> None:
        """From now on ``on_frames`` gets the MAVLink that comes, in the reading thread."""
        self._on_frames = on_frames

    def close(self) -> None:
        """From now on MAVLink that comes is left; nobody is inside ``on_frames`` any more when this returns."""
        with self._calling:
            self._on_frames = _nothing

    def send(self, raw: bytes) -> None:
        """Whole MAVLink frames to the gate; what it does not take now is lost and counted."""
        try:
            self._end.send(raw, socket.MSG_NOSIGNAL | socket.MSG_DONTWAIT)
        except (BlockingIOError, InterruptedError):
            self.unsent += 1
        except OSError:
            self.gone = True

    def beat(self, beat: Beat) -> None:
        """A tick was completed. To be called before its setpoint is sent: they arrive in this order."""
        self.send(beat.packed())

    def goodbye(self, exit_code: int) -> None:
        """The application ends in good order; whatever dies without this word is taken for dead."""
        self.send(Goodbye(exit_code).packed())

    def notices(self) -> list[Notice]:
        """Notices with a text that have come since the last call, oldest first."""
        found: list[Notice] = []
        with contextlib.suppress(IndexError):
            while True:
                found.append(self._notices.popleft())
        return found

    def _read(self) -> None:
        while True:
            try:
                data = self._end.recv(PACKET_BYTES)
            except ConnectionResetError:
                # That it was reset comes before its last words.
                continue
            except OSError:
                data = b""
            if not data:
                self.gone = True
                return
            if is_mavlink(data):
                with self._calling:
                    self._on_frames(data)
            elif (notice := Notice.unpacked(data)) is not None:
                self.stage = notice
                if notice.text:
                    self._notices.append(dataclasses.replace(notice, text=printable(notice.text)))


def _nothing(_frames: bytes) -> None:
    """Nobody is there yet, or any more."""
