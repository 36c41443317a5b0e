"""Links over UDP. A datagram that cannot be sent now is lost, as on any radio; nothing waits."""

from __future__ import annotations

import math
import os
import socket

from companion.gate.runtime.framing import Accept, FrameReader, Reconnect
from companion.mavlink.codec import Frame
from companion.mavlink.ids import MavComponent

Address = tuple[str, int]

RECEIVE_BYTES = 2048
MOST_FRAMES = 64
"""Taken from one wire in one call; the others have their turn before the next."""
BUFFER_BYTES = 65536
"""Asked of the kernel, which takes twice that and counts about 0.8 kB for a small datagram: 0.15 s of 1,000 messages a
second can wait, and no more: the rest is lost, not late."""
PEER_SILENT_S = 3.0
"""One who was silent for this long may be followed by another at another address."""
RIVAL_SILENT_S = 10.0
"""One who called itself the autopilot too, and was silent for this long, is gone."""
HEARTBEAT = 0


class UdpOut:
    """Sends to one address, and hears only that: the kernel drops everybody else's datagrams.

    Args:
        remote: host and port.
        accept: see `FrameReader`.
    """

    def __init__(self, remote: Address, accept: Accept | None) -> None:
        self.unsent = self.strangers = 0
        self.problem = ""
        self.reader = FrameReader(accept, datagram=True)
        self._remote = remote
        self._socket: socket.socket | None = None
        self._broken = False
        self._reconnect = Reconnect()

    def fileno(self) -> int | None:
        """See `Transport`."""
        return None if self._socket is None else self._socket.fileno()

    def receive(self, _now_s: float) -> list[Frame]:
        """See `Transport`."""
        found: list[Frame] = []
        for _ in range(MOST_FRAMES):
            if self._socket is None or len(found) >= MOST_FRAMES:
                break
            try:
                data = self._socket.recv(RECEIVE_BYTES)
            except OSError:
                # Nothing there. Or nobody listens there yet: the answer to an earlier datagram.
                break
            found += self.reader.frames(data)
        return found

    def send(self, raw: bytes) -> None:
        """See `Transport`."""
        try:
            if self._socket is None:
                raise BlockingIOError
            self._socket.send(raw)
        except (BlockingIOError, ConnectionRefusedError):
            self.unsent += 1
        except OSError:
            # The network is gone, or our own address in it has changed.
            self.unsent += 1
            self._broken = True

    def tick(self, now_s: float) -> None:
        """See `Transport`."""
        if self._broken:
            # The next is opened a second later, so that it cannot be taken for this one.
            self.close()
            self._reconnect.failed(now_s)
        elif self._socket is None and self._reconnect.due(now_s):
            try:
                self._socket = _connected(self._remote)
                self.problem = ""
            except OSError as error:
                self.problem = str(error.strerror)
                self._reconnect.failed(now_s)

    def close(self) -> None:
        """See `Transport`."""
        self._broken = False
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class UdpIn:
    """Listens, and answers the address that first sent a heartbeat of ours; another only when that has fallen silent.

    While nobody is answered, everybody is heard, so that it can be told who is there instead of ours.

    Args:
        local: host and port.
        system_id: whose autopilot's heartbeat is wanted; None: any message of anybody will do.
        accept: see `FrameReader`.

    Raises:
        OSError: the port is taken, or is not ours to take.
    """

    def __init__(self, local: Address, system_id: int | None, accept: Accept | None) -> None:
        self.unsent = self.strangers = 0
        self.problem = ""
        self.reader = FrameReader(accept, datagram=True)
        self._system_id = system_id
        self._peer: Address | None = None
        self._heard_s = self._rival_s = -math.inf
        self._strange = FrameReader(accept, datagram=True)
        self._socket = datagram_socket(BUFFER_BYTES)
        try:
            self._socket.bind(local)
        except OSError:
            self._socket.close()
            raise

    def fileno(self) -> int | None:
        """See `Transport`."""
        return self._socket.fileno()

    def receive(self, now_s: float) -> list[Frame]:
        """See `Transport`."""
        found: list[Frame] = []
        for _ in range(MOST_FRAMES):
            if len(found) >= MOST_FRAMES:
                break
            try:
                data, sender = self._socket.recvfrom(RECEIVE_BYTES)
            except OSError:
                break
            if sender == self._peer or now_s - self._heard_s > PEER_SILENT_S:
                found += self._heard(data, sender, now_s)
            else:
                self.strangers += 1
                self._look_for_a_rival(data, sender, now_s)
        return found

    def send(self, raw: bytes) -> None:
        """See `Transport`."""
        try:
            if self._peer is None:
                raise BlockingIOError
            self._socket.sendto(raw, self._peer)
        except OSError:
            self.unsent += 1

    def tick(self, now_s: float) -> None:
        """See `Transport`."""
        if self.problem and now_s - self._rival_s > RIVAL_SILENT_S:
            self.problem = ""

    def close(self) -> None:
        """See `Transport`."""
        self._socket.close()

    def _heard(self, data: bytes, sender: Address, now_s: float) -> list[Frame]:
        frames = self.reader.frames(data)
        if sender != self._peer:
            if not any(map(self._is_wanted, frames)):
                if self._peer is None:
                    return frames
                self.strangers += 1
                return []
            self._peer = sender
        if frames:
            self._heard_s = now_s
        return frames

    def _look_for_a_rival(self, data: bytes, sender: Address, now_s: float) -> None:
        """Whether a stranger says that it is the autopilot too: which of the two was heard first is chance."""
        if self._system_id is not None and any(map(self._is_wanted, self._strange.frames(data))):
            self._rival_s = now_s
            # One that goes through many addresses, such as a restarted program, is told once.
            self.problem = self.problem or (
                f"two senders call themselves system {self._system_id} component 1: {_text(self._peer)} is heard, "
                f"{_text(sender)} is not. Give each vehicle an id of its own, or end the second way to the same one"
            )

    def _is_wanted(self, frame: Frame) -> bool:
        return self._system_id is None or (frame.message_id, frame.system_id, frame.component_id) == (
            HEARTBEAT,
            self._system_id,
            MavComponent.AUTOPILOT1,
        )


def _text(address: Address | None) -> str:
    return "nobody" if address is None else f"{address[0]}:{address[1]}"


def datagram_socket(buffer_bytes: int) -> socket.socket:
    """One that never waits, with a receive buffer of (twice) this size."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
    return made


def _connected(remote: Address) -> socket.socket:
    made = datagram_socket(BUFFER_BYTES)
    refused = made.connect_ex(remote)
    if refused:
        made.close()
        raise OSError(refused, os.strerror(refused))
    return made
