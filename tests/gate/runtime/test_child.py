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

from companion.gate.faults import Fault, Stage
from companion.gate.protocol import Notice
from companion.gate.runtime import processes
from companion.gate.runtime.child import BUFFER_BYTES, MOST_PACKETS, Child
from companion.mavlink.codec import Frame
from tests.gate.built import frame
from tests.shared.beside import wait_until

T = TypeVar("T")

HEARTBEAT = frame("HEARTBEAT")
PREPARE = f"""
import os, socket, sys, time
gate = socket.socket(fileno=int(os.environ["COMPANION_GATE_FD"]))
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
        processes.kill(child.pid)
        with contextlib.suppress(ChildProcessError):
            os.waitpid(child.pid, 0)


def gathered(more: Callable[[], list[T]], count: int = 1) -> list[T]:
    """What comes until there are so many."""
    found: list[T] = []

    def enough() -> bool:
        found.extend(more())
        return len(found) >= count

    wait_until(enough)
    return found


def said(child: Child, count: int) -> list[bytes]:
    """So many words of the child, of which none is MAVLink."""
    found = gathered(child.receive, count)
    return [word for word in found if isinstance(word, bytes)]


def test_the_child_speaks_and_is_spoken_to_in_one_order() -> None:
    script = """
gate.send(b"beat"); gate.send(heartbeat); gate.send(b"bye!")
gate.send(b"heard: " + gate.recv(2000))
gate.send(b"heard: " + gate.recv(2000)[6:])
"""
    with started(script) as child:
        assert gathered(child.receive, 3) == [b"beat", HEARTBEAT, b"bye!"]
        child.send(b"attitude")
        child.notify(Notice(Stage.BRAKE, Fault.DEPTH_STALE, "brake: depth_stale"))
        assert said(child, 2) == [b"heard: attitude", b"heard: brake: depth_stale"]
        wait_until(lambda: not child.receive() and child.silent)
        assert child.fileno() is None
        assert child.receive() == []
        assert child.unsent == 0
        child.send(b"to nobody")
        assert child.unsent == 1


def test_it_has_its_socket_and_what_it_inherits_and_nothing_else_of_the_gate() -> None:
    """The link to the autopilot must not be open in the application: it could send past the gate."""
    settings = os.memfd_create("settings")
    os.write(settings, b"speed: 1")
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.set_inheritable(True)
    script = f"""
    # Without the one that lists them.
    open_fds = [int(name) for name in os.listdir("/proc/self/fd") if os.path.lexists("/proc/self/fd/" + name)]
    expected = [0, 1, 2, gate.fileno(), {settings}]
    gate.send(repr(sorted(open_fds) == sorted(expected)).encode() + os.read({settings}, 100))
    gate.send(repr("NOTIFY_SOCKET" in os.environ).encode())
    """.replace("\n    ", "\n")
    with link, pytest.MonkeyPatch.context() as patch:
        patch.setenv("NOTIFY_SOCKET", "/run/x")
        # Twice: the second reads it from its beginning too.
        for _ in range(2):
            with started(script, settings) as child:
                assert said(child, 2) == [b"Truespeed: 1", b"False"]
    os.close(settings)


def test_a_flood_of_the_child_is_taken_in_parts_and_the_rest_is_lost_and_not_late() -> None:
    script = """
gate.setblocking(False)
for _ in range(5000):
    try: gate.send(heartbeat * 3)
    except BlockingIOError: pass
while True:
    try: gate.send(b'done')
    except BlockingIOError: time.sleep(0.01)
    else: break
time.sleep(60)
"""
    with started(script) as child:
        counts: list[int] = []
        found: list[Frame | bytes] = []

        def last() -> bool:
            more = child.receive()
            counts.append(len(more))
            found.extend(more)
            return b"done" in more

        time.sleep(0.5)
        wait_until(last)
        assert max(counts) <= 3 * MOST_PACKETS
        # A packet takes at least 256 bytes of the buffer, which the kernel makes twice as large.
        assert 0 < len(found) / 3 < 2 * BUFFER_BYTES / 256 + MOST_PACKETS


def test_what_is_no_message_is_counted() -> None:
    with started("gate.send(b'\\xfdxx'); gate.send(b'x'); time.sleep(60)") as child:
        assert said(child, 1) == [b"x"]
        assert child.reader.bad == 1


def test_a_broken_socket_is_a_silent_one() -> None:
    with started("time.sleep(60)") as child:
        child._socket.close()
        assert child.receive() == []
        assert child.silent


def test_what_cannot_be_started_leaves_nothing_open() -> None:
    before = set(os.listdir("/proc/self/fd"))  # noqa: PTH208 - names
    with pytest.raises(FileNotFoundError):
        Child(("/no/such/program",), (), 0)
    assert set(os.listdir("/proc/self/fd")) == before  # noqa: PTH208 - names


def test_signals_reach_it_while_it_lives(monkeypatch: pytest.MonkeyPatch) -> None:
    with started("gate.send(b'up'); time.sleep(60)") as child:
        said(child, 1)
        child.signal(signal.SIGTERM)
        wait = os.waitpid
        # waitpid hears of any child: of those that other tests have left nothing is wanted here.
        monkeypatch.setattr(os, "waitpid", lambda _any, flags: wait(child.pid, flags))
        assert gathered(processes.deaths) == [(child.pid, -15)]
        assert processes.deaths() == []
        child.signal(signal.SIGTERM)
        processes.kill(child.pid)


@pytest.mark.parametrize(("script", "code"), [("sys.exit(3)", 3), ("os.kill(os.getpid(), 9)", -9)])
def test_the_end_of_a_child_is_known_while_it_is_a_zombie(script: str, code: int) -> None:
    """Protects the gate from waiting for the dead, which can take the kernel half a second."""
    with started(f"import os; gate.send(b'up'); gate.recv(1); {script}") as child:
        said(child, 1)
        assert processes.exit_code_of(child.pid) is None
        assert child.pid in processes.children()
        child.send(b"end")
        wait_until(lambda: processes.exit_code_of(child.pid) is not None)
        assert processes.exit_code_of(child.pid) == code
        assert child.pid not in processes.children()
        assert os.waitpid(child.pid, os.WNOHANG)[0] == child.pid
        assert processes.exit_code_of(child.pid) is None, "nobody's child any more"


def test_what_ends_is_heard_of_in_parts_and_what_lives_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "waitpid", lambda _any, _flags: (0, 0))
    assert processes.deaths() == []
    monkeypatch.setattr(os, "waitpid", lambda _any, _flags: (7, 256))
    assert processes.deaths() == [(7, 1)] * processes.MOST_DEATHS


def test_precedence_is_not_handed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getscheduler", lambda _pid: os.SCHED_RR)
    with started("gate.send(str(os.sched_getscheduler(0)).encode()); time.sleep(60)") as child:
        assert said(child, 1) == [str(os.SCHED_OTHER).encode()]


def test_signals_that_the_gate_keeps_out_reach_the_child() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    try:
        with started("import signal; gate.send(repr(signal.pthread_sigmask(0, ())).encode()); time.sleep(60)") as child:
            assert said(child, 1) == [b"set()"]
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
    processes.adopt_orphans()
    ctypes.CDLL(None).prctl(36, 0, 0, 0, 0)
    with started("time.sleep(60)") as child:
        assert child.pid in processes.children()


def test_a_process_ends_with_its_parent_as_long_as_that_is_wanted() -> None:
    """Protects the computer from what a killed process had started, and the last second of a map."""
    script = """
import os, signal, subprocess, sys, time
child = "import signal, sys, time; from companion.gate.runtime.processes import end_with_parent as end; "
child += "end(signal.SIGTERM); {} print('up', flush=True); time.sleep(60)"
for more in ("", "end(None);"):
    one = subprocess.Popen([sys.executable, "-c", child.format(more)], stdout=subprocess.PIPE)
    one.stdout.readline()
    print(one.pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""
    said = subprocess.run([sys.executable, "-c", script], stdout=subprocess.PIPE, check=False).stdout
    tied, free = map(int, said.split())
    try:
        wait_until(lambda: not _runs(tied), "it was told that its parent has ended")
        assert _runs(free)
    finally:
        os.kill(free, signal.SIGKILL)


def test_the_kernel_has_what_it_was_told() -> None:
    told = ctypes.c_int(-1)
    for number in (signal.SIGTERM, None):
        processes.end_with_parent(number)
        ctypes.CDLL(None).prctl(2, ctypes.byref(told), 0, 0, 0)
        assert told.value == (number or 0)


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
