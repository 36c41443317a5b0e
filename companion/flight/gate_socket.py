"""The application's end of its talk with the gate: beats and the last word go out, notices come in."""

from __future__ import annotations

import os
import socket

from companion.errors import InputError
from companion.gate.protocol import BEAT_FD, GATE_URL, Beat, Goodbye
from companion.mavlink.text import printable

LARGEST_NOTICE = 1024
"""Bytes; a longer one arrives cut off."""
NOTICES_AT_ONCE = 64
"""More than this are left for the next look: a gate that floods must not take the tick's time."""


class GateLink:
    """Never waits, never raises: who flies must not be held up by who watches.

    Args:
        beats: one end of an AF_UNIX SOCK_SEQPACKET pair.
        url: where the gate stands in for the autopilot.

    Attributes:
        gone: whether the gate has closed its end, which it does only by dying: nothing that is sent arrives any more.
        unsent: beats for which there was no room.
    """

    def __init__(self, beats: socket.socket, url: str) -> None:
        self.url = url
        self.gone = False
        self.unsent = 0
        self._beats = beats
        self._beats.setblocking(False)

    @classmethod
    def from_environment(cls) -> GateLink | None:
        """What the gate gave its child; None when it was not the gate that started this process.

        Raises:
            InputError: the environment names no socket.
        """
        number, url = os.environ.get(BEAT_FD), os.environ.get(GATE_URL)
        if number is None or url is None:
            return None
        try:
            beats = socket.socket(fileno=int(number))
            # Held by a process of ours that outlives us, it would hide from the gate that we are gone.
            beats.set_inheritable(False)
            return cls(beats, url)
        except (ValueError, OSError) as error:
            raise InputError(
                f"{BEAT_FD} = {number} in the environment is not the socket of a gate ({error}): start with "
                "`companion run`"
            ) from None

    def beat(self, beat: Beat) -> None:
        """A tick was completed."""
        self._send(beat.packed())

    def goodbye(self, exit_code: int) -> None:
        """The application ends in good order; whatever dies without this word is taken for dead."""
        self._send(Goodbye(exit_code).packed())

    def notices(self) -> list[str]:
        """What the gate has said since the last call, oldest first."""
        found: list[str] = []
        for _ in range(NOTICES_AT_ONCE):
            try:
                data = self._beats.recv(LARGEST_NOTICE)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:
                # That it was reset comes before its last words.
                self.gone = True
                continue
            if not data:
                self.gone = True
                break
            found.append(printable(data.decode("utf-8", errors="replace")))
        return found

    def _send(self, data: bytes) -> None:
        try:
            self._beats.send(data, socket.MSG_NOSIGNAL)
        except (BlockingIOError, InterruptedError):
            self.unsent += 1
        except OSError:
            self.gone = True
