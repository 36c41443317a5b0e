"""A bad link: passes UDP on between an autopilot and the application, loses a share of it, goes dead, comes back."""

from __future__ import annotations

import random
import selectors
import socket
import threading
import time
from collections import deque
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from sitl.autopilot.wire import Decoder

LOOPBACK = "127.0.0.1"
LARGEST = 65536
REMEMBERED = 20_000


@dataclass(frozen=True, slots=True)
class Sent:
    """One message that the application sent, whether or not it was passed on."""

    t_s: float
    message: Any


class Relay:
    """Lives in a thread of its own while the block lasts.

    Args:
        to_application: the UDP port on which the application listens.
        lost_share: of the packets, each way.
        seed: draws which.

    Attributes:
        port: where the autopilot sends to.
        dead: set it and nothing passes any more, either way.
        lost: packets that were not passed on: to the application, to the autopilot.
        passed: packets that were: to the application, to the autopilot.
    """

    def __init__(self, to_application: int, lost_share: float = 0.0, seed: int = 1) -> None:
        self.dead = False
        self.lost, self.passed = [0, 0], [0, 0]
        self._lost_share = lost_share
        self._random = random.Random(seed)  # noqa: S311 - packet loss, no secret
        self._application = (LOOPBACK, to_application)
        self._autopilot: Any = None
        self._near, self._far = _socket(), _socket()
        self.port: int = self._near.getsockname()[1]
        self._sent: deque[Sent] = deque(maxlen=REMEMBERED)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="relay")

    def __enter__(self) -> Relay:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._near.close()
        self._far.close()

    def sent(self, name: str, since_s: float = 0.0) -> list[Any]:
        """The messages of a name that the application has sent since a moment of `time.monotonic`."""
        return [sent.message for sent in tuple(self._sent) if sent.t_s >= since_s and sent.message.get_type() == name]

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._near, selectors.EVENT_READ)
            selector.register(self._far, selectors.EVENT_READ)
            while not self._stop.is_set():
                for key, _ in selector.select(0.05):
                    self._pass_on(key.fileobj is self._far)

    def _pass_on(self, to_autopilot: bool) -> None:
        try:
            data, sender = (self._far if to_autopilot else self._near).recvfrom(LARGEST)
        except OSError:
            # Nobody listens yet at the other end.
            return
        if to_autopilot:
            now_s = time.monotonic()
            self._sent.extend(Sent(now_s, message) for message in Decoder().messages(data))
        else:
            self._autopilot = sender
        target = self._autopilot if to_autopilot else self._application
        if self.dead or self._random.random() < self._lost_share or target is None:
            self.lost[to_autopilot] += 1
            return
        self.passed[to_autopilot] += 1
        (self._near if to_autopilot else self._far).sendto(data, target)


def _socket() -> socket.socket:
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.bind((LOOPBACK, 0))
    found.setblocking(False)
    return found
