"""The wire between autopilot and gate, with a stopwatch on the setpoints that pass."""

from __future__ import annotations

import contextlib
import select
import threading
from typing import Self

from bench.gate.child import received, timed_socket
from companion.mavlink.codec import Framer

SETPOINT = 84
"""SET_POSITION_TARGET_LOCAL_NED."""


class Wire:
    """Between autopilot and gate: passes everything on, and stamps the setpoints.

    Attributes:
        port: where the autopilot sends.
        setpoints: ns of arrival, and the MAVLink component that it is from.
    """

    def __init__(self, gate_port: int) -> None:
        self.setpoints: list[tuple[int, int]] = []
        self._near, self._far = timed_socket(), timed_socket()
        self.port: int = self._near.getsockname()[1]
        self._gate = ("127.0.0.1", gate_port)
        self._framer = Framer(datagram=True)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="wire")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._near.close()
        self._far.close()

    def _run(self) -> None:
        autopilot: tuple[str, int] | None = None
        while not self._stop.is_set():
            select.select([self._near, self._far], [], [], 0.1)
            while (found := received(self._near)) is not None:
                data, _, autopilot = found
                with contextlib.suppress(OSError):
                    self._far.sendto(data, self._gate)
            while (found := received(self._far)) is not None:
                data, arrived_ns, _ = found
                for frame in self._framer.frames(data):
                    if frame.message_id == SETPOINT:
                        self.setpoints.append((arrived_ns, frame.component_id))
                if autopilot is not None:
                    with contextlib.suppress(OSError):
                        self._near.sendto(data, autopilot)
