"""The whole gate with real sockets, and an application that is a real process: turned by hand."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

from companion.gate.gate import Gate
from companion.gate.plan import Attached, Plan
from companion.gate.protocol import Beat, Phase
from companion.gate.runtime import main as process
from companion.gate.runtime.log import Log
from companion.gate.runtime.loop import Loop
from companion.gate.runtime.signals import Signals
from companion.gate.runtime.supervisor import Supervisor
from companion.gate.runtime.systemd import ServiceManager
from companion.gate.runtime.transports import open_transport
from companion.mavlink.codec import Frame, Framer
from companion.mavlink.signing import Signer
from tests.gate.built import PLAN, frame

HOST = "127.0.0.1"
CHILD = """
import os, signal, socket, sys, time
gate = socket.socket(fileno=int(os.environ["COMPANION_GATE_FD"]))
waiting, to_do = [], []
def say(words):
    gate.send(bytes.fromhex(words))
def hear():
    words = b""
    while words[:1] not in (b"\\xfd", b"\\xfe"):
        words = waiting.pop(0) if waiting else gate.recv(4096)
        if words.startswith(b"do "):
            to_do.append(words)
    gate.send(b"heard " + words)
signal.signal(signal.SIGTERM, lambda *_: gate.send(b"SIGTERM"))
signal.signal(signal.SIGINT, lambda *_: gate.send(b"SIGINT"))
gate.send(b"up")
while words := to_do.pop(0) if to_do else gate.recv(4096):
    if words.startswith(b"do "):
        exec(words[3:].decode())
    else:
        waiting.append(words)
"""
"""Does what it is told, so that a test reads from one side."""

PROGRAM = (sys.executable, "-c", CHILD)
GROUND_BEAT = Beat(0.0, 0.0, 0.0, 0.0, 5.0, 0.0, Phase.GROUND)
HEARTBEAT = frame("HEARTBEAT", component=1, autopilot=12, base_mode=0)
ATTITUDE = frame("ATTITUDE", component=1, yaw=1.0)


class Rig:
    """The gate between an autopilot that is a socket here, and a child that does what it is told.

    Args:
        plan: of the gate; addresses and commands are filled in.
        signer: of the link to the autopilot.
        attached: what each of them may.
    """

    def __init__(self, plan: Plan = PLAN, signer: Signer | None = None, attached: tuple[str, ...] = ()) -> None:
        self.offset_s = 0.0
        self.beats: list[bytes] = []
        self.autopilot = bound()
        self.grounds = [bound() for _ in attached]
        others = tuple(
            Attached(f"udpout://{HOST}:{ground.getsockname()[1]}", may)
            for ground, may in zip(self.grounds, attached, strict=True)
        )
        with bound() as free:
            self.port: int = free.getsockname()[1]
        self.plan = replace(
            plan,
            autopilot_url=f"udpin://{HOST}:{self.port}",
            command=PROGRAM if plan.command == PLAN.command else plan.command,
            restart_command=PROGRAM if plan.restart_command == PLAN.restart_command else plan.restart_command,
            attached=others,
        )
        self.gate = Gate(self.plan, self.now_s())
        self.gate_on_word = self.gate.on_word
        self.gate.on_word = self._beat  # type: ignore[method-assign]
        self.signals = Signals()
        self._said, words = os.pipe()
        self.log = Log(words)
        self.log_fd = words
        self.service = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.service.bind("")
        self.service.setblocking(False)
        name = self.service.getsockname().replace(b"\0", b"@").decode()
        self.notifier = ServiceManager({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "400000"})
        accept = None if signer is None else process._accepting(signer)
        self.transport = open_transport(self.plan.autopilot_url, 1, accept)
        self.attached = [(one, open_transport(one.url)) for one in others]
        self.supervisor = Supervisor(self.plan, self.gate, self.log)
        self.supervisor.start()
        self.loop = Loop(
            self.plan,
            self.gate,
            self.supervisor,
            self.transport,
            signer,
            self.attached,
            self.signals,
            self.notifier,
            self.log,
            self.now_s,
        )

    def now_s(self) -> float:
        return time.monotonic() + self.offset_s

    def _beat(self, data: bytes, now_s: float) -> None:
        self.beats.append(data)
        self.gate_on_word(data, now_s)

    def turn_until(self, true: Callable[[], object]) -> None:
        give_up_s = time.monotonic() + 20.0
        while not true():
            assert time.monotonic() < give_up_s, self.words()
            self.loop.turn()

    def turn_for(self, duration_s: float) -> None:
        until_s = time.monotonic() + duration_s
        self.turn_until(lambda: time.monotonic() > until_s)

    def up(self) -> None:
        """The child runs and is known, the autopilot has its address, and a first beat was heard."""
        self.turn_until(lambda: b"up" in self.beats)
        self.say(HEARTBEAT)
        self.turn_until(lambda: self.loop._heard_s > 0.0)
        self.do(f"say('{GROUND_BEAT.packed().hex()}')")
        self.do(f"say('{frame('HEARTBEAT').raw.hex()}')")
        self.turn_until(lambda: frame("HEARTBEAT").raw in self.down())
        self.turn_until(lambda: GROUND_BEAT.packed() in self.beats)
        self.do("waiting.clear()")

    def do(self, script: str) -> None:
        assert self.supervisor.child is not None
        assert self.supervisor.child._socket.send(f"do {script}".encode())

    def say(self, *frames: Frame) -> None:
        """The autopilot says something, in one datagram."""
        self.autopilot.sendto(b"".join(one.raw for one in frames), (HOST, self.port))

    def down(self) -> list[bytes]:
        """What the autopilot has got."""
        return received(self.autopilot)

    def down_until(self, wanted: Callable[[Frame], bool]) -> Frame:
        """The first message to the autopilot that is like this."""
        found: list[Frame] = []

        def came() -> bool:
            for raw in self.down():
                found.extend(one for one in Framer().frames(raw) if wanted(one))
            return bool(found)

        self.turn_until(came)
        return found[0]

    def has_died(self) -> None:
        """Turn the loop until the gate has noticed."""
        self.turn_until(lambda: self.supervisor.child is None)

    def service_heard(self) -> list[bytes]:
        """What the service manager was told since it was last asked."""
        return received(self.service)

    def words(self) -> str:
        """The log."""
        self.log.say("end")
        words = ""
        while not words.endswith("end\n"):
            words += os.read(self._said, 1 << 16).decode()
        return words

    def close(self) -> None:
        """Everything, whatever state it is in."""
        self.loop.close()
        self.transport.close()
        for _, transport in self.attached:
            transport.close()
        if self.supervisor.child is not None:
            self.supervisor.child.close()
        self.signals.close()
        self.notifier.close()
        self.log.close(5.0)
        os.close(self.log_fd)
        os.close(self._said)
        for one in (self.autopilot, self.service, *self.grounds):
            one.close()


@contextlib.contextmanager
def rigged(plan: Plan = PLAN, signer: Signer | None = None, attached: tuple[str, ...] = ()) -> Iterator[Rig]:
    """A rig for the length of a block."""
    rig = Rig(plan, signer, attached)
    try:
        yield rig
    finally:
        rig.close()


def bound() -> socket.socket:
    """A UDP socket with a free port."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((HOST, 0))
    made.setblocking(False)
    return made


def received(there: socket.socket) -> list[bytes]:
    """All datagrams that wait there."""
    found = []
    with contextlib.suppress(BlockingIOError):
        while True:
            found.append(there.recv(2000))
    return found
