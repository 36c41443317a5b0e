"""The application's process: it alone may command, and its end is heard of."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import pytest

from companion.gate.runtime import child as child_module
from companion.gate.runtime import processes as family
from companion.gate.runtime import udp_owner as peer
from companion.gate.runtime.child import BUFFER_BYTES, MOST_BEATS, MOST_FRAMES, MOST_REFUSED, REFUSED_S, Child
from companion.mavlink.codec import Frame
from tests.gate.built import frame

T = TypeVar("T")

HEARTBEAT = frame("HEARTBEAT")
PREPARE = f"""
import os, socket, sys, time
beats = socket.socket(fileno=int(os.environ["COMPANION_GATE_FD"]))
host, port = os.environ["COMPANION_GATE_URL"].removeprefix("udpout://").split(":")
gate = (host, int(port))
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
heartbeat = bytes.fromhex("{HEARTBEAT.raw.hex()}")
"""


@contextlib.contextmanager
def started(script: str, *inherit: int) -> Iterator[Child]:
    """A child that runs a few lines of Python; killed with the block."""
    child = Child((sys.executable, "-c", PREPARE + script), inherit, os.getpriority(os.PRIO_PROCESS, 0))
    try:
        yield child
    finally:
        child.close()
        family.kill(child.pid)
        with contextlib.suppress(ChildProcessError):
            os.waitpid(child.pid, 0)


def until(true: Callable[[], object]) -> None:
    until_s = time.monotonic() + 20.0
    while not true():
        assert time.monotonic() < until_s
        time.sleep(0.002)


def gathered(more: Callable[[], list[T]], count: int = 1) -> list[T]:
    """What comes until there are so many."""
    found: list[T] = []

    def enough() -> bool:
        found.extend(more())
        return len(found) >= count

    until(enough)
    return found


def beats(child: Child, count: int) -> list[bytes]:
    return gathered(child.beats, count)


def frames(child: Child) -> list[Frame]:
    return gathered(lambda: child.frames(0.0))


def test_the_child_speaks_and_is_spoken_to() -> None:
    script = """
link.sendto(heartbeat, gate)
beats.send(link.recv(2000))
beats.send(b"heard: " + beats.recv(2000))
"""
    with started(script) as child:
        child.send(b"before it is known")
        assert child.unsent == 1
        assert frames(child) == [HEARTBEAT]
        child.send(b"attitude")
        child.notify("brake: depth_stale")
        assert child.fileno() != child.beats_fileno()
        assert beats(child, 2) == [b"attitude", b"heard: brake: depth_stale"]
        until(lambda: not child.beats() and child.silent)
        assert child.beats_fileno() is None
        assert child.beats() == []
        child.notify("to nobody")
        # The kernel says at the next call that its socket is closed.
        for _ in range(3):
            child.send(b"to nobody")
            time.sleep(0.01)
        child.frames(0.0)
        assert child.unsent > 1


def test_it_has_its_socket_and_what_it_inherits_and_nothing_else_of_the_gate() -> None:
    """The link to the autopilot must not be open in the application: it could send past the gate."""
    settings = os.memfd_create("settings")
    os.write(settings, b"speed: 1")
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.set_inheritable(True)
    script = f"""
    # Without the one that lists them.
    open_fds = [int(name) for name in os.listdir("/proc/self/fd") if os.path.lexists("/proc/self/fd/" + name)]
    expected = [0, 1, 2, beats.fileno(), link.fileno(), {settings}]
    beats.send(repr(sorted(open_fds) == sorted(expected)).encode() + os.read({settings}, 100))
    beats.send(repr("NOTIFY_SOCKET" in os.environ).encode())
    """.replace("\n    ", "\n")
    with link, pytest.MonkeyPatch.context() as patch:
        patch.setenv("NOTIFY_SOCKET", "/run/x")
        # Twice: the second reads it from its beginning too.
        for _ in range(2):
            with started(script, settings) as child:
                assert beats(child, 2) == [b"Truespeed: 1", b"False"]
    os.close(settings)


def test_a_stranger_is_refused_before_and_after_the_child_has_spoken() -> None:
    with (
        started("sys.stdin.readline(); time.sleep(60)") as quiet,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s,
    ):
        s.sendto(HEARTBEAT.raw, ("127.0.0.1", quiet.port))
        until(lambda: not quiet.frames(0.0) and quiet.strangers == 1)
        quiet.send(b"x")
        assert quiet.unsent == 1
    script = """
beats.send(b'up'); beats.recv(10)
for _ in range(3): link.sendto(heartbeat, gate)
beats.send(b'sent'); beats.recv(10)
"""
    with started(script) as child, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        # One waits in the buffer already when the child is recognised.
        beats(child, 1)
        child.notify("go")
        beats(child, 1)
        stranger.sendto(frame("HEARTBEAT", system=9).raw, ("127.0.0.1", child.port))
        assert set(frames(child)) == {HEARTBEAT}
        until(lambda: child.frames(0.0) == [] and child.strangers == 1)
        # From now on the kernel refuses.
        with contextlib.suppress(ConnectionRefusedError):
            stranger.sendto(HEARTBEAT.raw, ("127.0.0.1", child.port))
        time.sleep(0.02)
        assert child.frames(0.0) == []
        assert child.strangers == 1


def test_a_flood_of_strangers_does_not_have_the_kernel_asked_for_each(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def holds(_pid: int, port: int) -> bool:
        asked.append(port)
        return False

    monkeypatch.setattr(child_module, "holds", holds)
    with started("time.sleep(60)") as child:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for _ in range(10):
                stranger.sendto(HEARTBEAT.raw, ("127.0.0.1", child.port))
            until(lambda: not child.frames(0.0) and child.strangers == 10)
            assert len(asked) == 1
            stranger.sendto(HEARTBEAT.raw, ("127.0.0.1", child.port))
            until(lambda: not child.frames(REFUSED_S) and child.strangers == 11)
            assert len(asked) == 2
        # Nor is every port remembered for ever.
        for _ in range(2 * MOST_REFUSED):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as another:
                another.sendto(HEARTBEAT.raw, ("127.0.0.1", child.port))
            child.frames(2.0)
        until(lambda: not child.frames(2.0) and child.strangers == 11 + 2 * MOST_REFUSED)
        assert len(child._refused) <= MOST_REFUSED


def test_a_flood_of_the_child_is_taken_in_parts_and_the_rest_is_lost_and_not_late() -> None:
    script = """
link.sendto(heartbeat, gate)
for _ in range(5000): link.sendto(heartbeat * 3, gate)
beats.send(b'done'); time.sleep(60)
"""
    with started(script) as child:
        assert beats(child, 1) == [b"done"]
        counts = []
        while found := child.frames(0.0):
            counts.append(len(found))
        assert max(counts) < MOST_FRAMES + 3
        # A datagram takes at least 256 bytes of the buffer, which the kernel makes twice as large.
        assert sum(counts) / 3 < 2 * BUFFER_BYTES / 256
    script = """
link.sendto(heartbeat, gate)
for _ in range(500): link.sendto(b'x', gate)
beats.send(b'done'); time.sleep(60)
"""
    with started(script) as child:
        assert beats(child, 1) == [b"done"]
        child.frames(0.0)
        assert child.inflow.bad == MOST_FRAMES - 1


def test_beats_are_taken_in_parts() -> None:
    with started("for _ in range(100): beats.send(b'beat')\nlink.sendto(heartbeat, gate); time.sleep(60)") as child:
        frames(child)
        assert len(child.beats()) == MOST_BEATS


def test_a_broken_socket_of_beats_is_a_silent_one() -> None:
    with started("time.sleep(60)") as child:
        child._beats.close()
        assert child.beats() == []
        assert child.silent


def test_what_cannot_be_started_leaves_nothing_open() -> None:
    before = set(os.listdir("/proc/self/fd"))  # noqa: PTH208 - names
    with pytest.raises(FileNotFoundError):
        Child(("/no/such/program",), (), 0)
    assert set(os.listdir("/proc/self/fd")) == before  # noqa: PTH208 - names


def test_signals_reach_it_while_it_lives(monkeypatch: pytest.MonkeyPatch) -> None:
    with started("beats.send(b'up'); time.sleep(60)") as child:
        beats(child, 1)
        child.signal(signal.SIGTERM)
        wait = os.waitpid
        # waitpid hears of any child: of those that other tests have left nothing is wanted here.
        monkeypatch.setattr(os, "waitpid", lambda _any, flags: wait(child.pid, flags))
        assert gathered(family.deaths) == [(child.pid, -15)]
        assert family.deaths() == []
        child.signal(signal.SIGTERM)
        family.kill(child.pid)


@pytest.mark.parametrize(("script", "code"), [("sys.exit(3)", 3), ("os.kill(os.getpid(), 9)", -9)])
def test_the_end_of_a_child_is_known_while_it_is_a_zombie(script: str, code: int) -> None:
    """Protects the gate from waiting for the dead, which can take the kernel half a second."""
    with started(f"import os; beats.send(b'up'); beats.recv(1); {script}") as child:
        beats(child, 1)
        assert family.exit_code_of(child.pid) is None
        assert child.pid in family.children()
        child.notify("end")
        deadline_s = time.monotonic() + 10.0
        while family.exit_code_of(child.pid) is None:
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        assert family.exit_code_of(child.pid) == code
        assert child.pid not in family.children()
        assert os.waitpid(child.pid, os.WNOHANG)[0] == child.pid
        assert family.exit_code_of(child.pid) is None, "nobody's child any more"


def test_what_ends_is_heard_of_in_parts_and_what_lives_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "waitpid", lambda _any, _flags: (0, 0))
    assert family.deaths() == []
    monkeypatch.setattr(os, "waitpid", lambda _any, _flags: (7, 256))
    assert family.deaths() == [(7, 1)] * family.MOST_DEATHS


def test_precedence_is_not_handed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getscheduler", lambda _pid: os.SCHED_RR)
    with started("beats.send(str(os.sched_getscheduler(0)).encode()); time.sleep(60)") as child:
        assert beats(child, 1) == [str(os.SCHED_OTHER).encode()]


def test_signals_that_the_gate_keeps_out_reach_the_child() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        with started(
            "import signal; beats.send(repr(signal.pthread_sigmask(0, ())).encode()); time.sleep(60)"
        ) as child:
            assert beats(child, 1) == [b"set()"]
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def test_the_children_of_one_who_was_killed_are_found() -> None:
    """In a process of its own, as adopting orphans cannot be undone."""
    script = """
import os, signal, subprocess, sys, time
from companion.gate.runtime.processes import adopt_orphans, children, deaths, kill
adopt_orphans()
grandchild = "import subprocess, sys, time; subprocess.Popen(['sleep', '60']); print('up', flush=True); time.sleep(60)"
child = subprocess.Popen([sys.executable, "-c", grandchild], stdout=subprocess.PIPE)
child.stdout.readline()
kill(child.pid)
found = []
while child.pid not in [pid for pid, _ in found]:
    found += deaths()
left = children()
assert len(left) == 1, left
kill(left[0])
while not (ended := deaths()):
    time.sleep(0.01)
assert ended == [(left[0], -9)], ended
assert children() == []
"""
    subprocess.run([sys.executable, "-c", script], check=True, timeout=60)


def test_children_are_found_and_orphans_adopted() -> None:
    family.adopt_orphans()
    ctypes.CDLL(None).prctl(36, 0, 0, 0, 0)
    with started("time.sleep(60)") as child:
        assert child.pid in family.children()


def test_a_port_belongs_to_who_holds_it_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        ours.bind(("127.0.0.1", 0))
        port = ours.getsockname()[1]
        assert peer.holds(os.getpid(), port)
        assert not peer.holds(1 if os.getpid() != 1 else 2, port)
        assert not peer.holds(2**22 + 1, port)
    assert not peer.holds(os.getpid(), port)
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as both:
        both.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        both.bind(("::", 0))
        assert peer.holds(os.getpid(), both.getsockname()[1])
    # Somebody else has the same port too: then it cannot be told who sends.
    own = tmp_path / "9" / "fd"
    own.mkdir(parents=True)
    (own / "3").symlink_to("socket:[111]")
    (own / "4").symlink_to("/dev/null")
    (own / "5").write_text("no link: as one that was closed meanwhile")
    (tmp_path / "net").mkdir()
    line = "  1: {}:0010 00000000:0000 07 00000000:00000000 00:00000000 00000000 0 0 {} 2 0000 0\n"
    table = tmp_path / "net" / "udp"
    monkeypatch.setattr(peer, "_PROC", tmp_path)
    table.write_text("head\n" + line.format("0100007F", 111) + line.format("0500A8C0", 222))
    assert peer.holds(9, 16)
    table.write_text("head\n" + line.format("0100007F", 111) + line.format("00000000", 222))
    assert not peer.holds(9, 16)
