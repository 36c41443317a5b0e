"""The least application that a gate lets fly: beats and setpoints, nothing else. Started by `bench.gate`.

python -m bench.gate.child HZ SECONDS FILE

It arms, flies at a steady speed, writes how late the autopilot's messages came into the file, and then flies on until
somebody kills it.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import socket
import struct
import sys
import time
from pathlib import Path

from companion.gate.protocol import GATE_FD, Beat, Phase, is_mavlink
from companion.mavlink.codec import Encoder, Framer, decode

SYSTEM, APPLICATION, AUTOPILOT = 1, 191, 1
OFFBOARD = (1.0, 6.0)
SPEED_MPS, ACCEL_MPS2 = 0.3, 1.0
WARM_UP_S = 2.0
"""Armed and up to speed after this; what is measured before does not count."""

SO_TIMESTAMPNS = 35
"""Of Linux; the socket module does not name it. The kernel stamps a datagram when it puts it into the socket."""
_STAMP = struct.Struct("@ll")


def timed_socket() -> socket.socket:
    """A UDP socket on loopback whose datagrams carry the time of their arrival."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    made.bind(("127.0.0.1", 0))
    return timed(made)


def timed(made: socket.socket) -> socket.socket:
    """The socket, whose packets carry the time of their arrival from now on, and which never waits."""
    made.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    made.setblocking(False)
    return made


def received(wire: socket.socket) -> tuple[bytes, int, tuple[str, int]] | None:
    """The next packet, when it arrived in ns of CLOCK_MONOTONIC, and from whom; None: there is none now."""
    try:
        data, stamps, _, sender = wire.recvmsg(65536, 64)
    except OSError:
        return None
    if not stamps:  # the other end was closed
        return None
    seconds, nanoseconds = _STAMP.unpack(stamps[0][2][: _STAMP.size])
    return data, seconds * 1_000_000_000 + nanoseconds + time.monotonic_ns() - time.time_ns(), sender


class Application:
    """Flies.

    Args:
        gate: the socket to the gate, or to the autopilot itself.
    """

    def __init__(self, gate: socket.socket) -> None:
        self.delays_us: list[float] = []
        self._gate = gate
        self._encoder, self._framer = Encoder(SYSTEM, APPLICATION), Framer(datagram=True)
        self._ticks = 0

    def tick(self, period_s: float, counts: bool) -> None:
        """Listen until the next tick is due; then a beat and a setpoint."""
        now_s = time.monotonic()
        self._listen(until_s=(math.floor(now_s / period_s) + 1.0) * period_s, counts=counts)
        self._ticks += 1
        phase = Phase.EXPLORING if self._ticks * period_s > WARM_UP_S / 2.0 else Phase.GROUND
        beat = Beat(time.monotonic(), 0.1, 0.1, 0.02, math.inf, 0.5, phase)
        self._put(beat.packed())
        if phase is Phase.GROUND:
            # Arming needs a beat; and what is asked for twice is done once.
            self._command(400, 1.0)
            self._command(176, *OFFBOARD)
        self._send(
            "SET_POSITION_TARGET_LOCAL_NED",
            # Microseconds here: who measures takes the difference.
            time_boot_ms=time.monotonic_ns() // 1000 & 0xFFFFFFFF,
            target_system=SYSTEM,
            target_component=AUTOPILOT,
            coordinate_frame=8,
            type_mask=0x5C7,
            vx=min(SPEED_MPS, max(0.0, ACCEL_MPS2 * (self._ticks * period_s - WARM_UP_S / 2.0))),
        )

    def _listen(self, until_s: float, counts: bool) -> None:
        while (wait_s := until_s - time.monotonic()) > 0.0:
            if not select.select([self._gate], [], [], wait_s)[0]:
                return
            while (found := received(self._gate)) is not None:
                data, arrived_ns, _ = found
                if not is_mavlink(data):
                    continue
                for frame in self._framer.frames(data):
                    if frame.message_id == 111 and counts and (fields := decode(frame)) is not None:
                        self.delays_us.append((arrived_ns - int(fields["ts1"])) / 1e3)

    def _command(self, command: int, param1: float, param2: float = 0.0) -> None:
        to = {"target_system": SYSTEM, "target_component": AUTOPILOT}
        self._send("COMMAND_LONG", command=command, param1=param1, param2=param2, **to)

    def _send(self, name: str, **fields: int | float) -> None:
        self._put(self._encoder.pack(name, **fields))

    def _put(self, packet: bytes) -> None:
        with contextlib.suppress(BlockingIOError):
            self._gate.send(packet)


def main() -> None:
    """Fly."""
    hz, seconds, file = float(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3])
    application = Application(timed(socket.socket(fileno=int(os.environ[GATE_FD]))))
    begun_s = time.monotonic()
    while (flown_s := time.monotonic() - begun_s) < WARM_UP_S + seconds:
        application.tick(1.0 / hz, flown_s > WARM_UP_S)
    # In one piece, so that who waits for it never reads half of it.
    half = file.with_suffix(".half")
    half.write_text(json.dumps(application.delays_us), encoding="ascii")
    half.rename(file)
    while True:
        application.tick(1.0 / hz, counts=False)


if __name__ == "__main__":
    main()
