"""Life and death of the application: its last word, its end without one, and when it is started again."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import pytest

from companion.gate.faults import Stage
from companion.gate.gate import Gate
from companion.gate.protocol import Goodbye
from companion.gate.runtime import processes, supervisor
from companion.gate.runtime.supervisor import LEAVE_S, LOOK_S, REST_S
from tests.gate.built import PLAN, frame
from tests.gate.runtime.rig import ATTITUDE, HEARTBEAT, rigged
from tests.shared.beside import wait_until

ARMED = frame("HEARTBEAT", component=1, autopilot=12, base_mode=128)


def test_its_last_word_is_the_exit_code() -> None:
    """Protects who started the flight: they hear how it ended, and not how the process did."""
    with rigged() as rig:
        rig.up()
        rig.do(f"say('{Goodbye(7).packed().hex()}'); sys.exit(3)")
        assert rig.loop.run() == 7
        rig.supervisor.cycle(rig.now_s(), 0.0)


def test_one_that_is_left_sees_the_end_of_its_socket() -> None:
    """Protects against an application that flies on in the belief that there is a gate."""
    with rigged() as rig:
        rig.up()
        child = rig.supervisor.child
        assert child is not None
        rig.supervisor.close()
        wait_until(lambda: child.pid in dict(processes.deaths()), "its loop ends with the socket")
        rig.supervisor.child = None
        rig.supervisor.close()


def test_after_its_last_word_it_is_not_waited_for_for_ever() -> None:
    """Protects the end of a flight from an application that hangs after it."""
    with rigged() as rig:
        rig.up()
        rig.do(f"say('{Goodbye(0).packed().hex()}'); time.sleep(60)")
        rig.turn_until(lambda: rig.gate.goodbye)
        rig.turn_for(0.05)
        assert rig.supervisor.exit_code is None
        rig.offset_s += LEAVE_S + 0.1
        assert rig.loop.run() == 0
        assert f"did not end within {LEAVE_S:g} s of its last word; it is killed" in rig.words()


@pytest.mark.parametrize(("script", "code"), [("sys.exit(2)", 2), ("sys.exit(0)", 1), ("os.kill(os.getpid(),9)", 1)])
def test_one_that_never_spoke_is_not_started_again(script: str, code: int) -> None:
    """A broken installation does not get better by being started."""
    with rigged(replace(PLAN, command=(sys.executable, "-c", f"import os, sys; {script}"))) as rig:
        assert rig.loop.run() == code
        assert "before its first word" in rig.words()


def test_one_that_died_is_told_and_started_again_when_the_vehicle_is_disarmed() -> None:
    """Nothing that starts in the air knows where it is; and what the dead one had started must be gone."""
    with rigged() as rig:
        rig.up()
        rig.say(ARMED)
        rig.do("import subprocess; subprocess.Popen(['sleep', '60']); os.kill(os.getpid(), 9)")
        dead = rig.supervisor.child
        rig.has_died()
        rig.turn_until(lambda: rig.gate.armed)
        rig.offset_s += REST_S + 0.1
        rig.turn_for(0.05)
        rig.offset_s += LOOK_S + 0.1
        rig.turn_for(0.05)
        assert rig.supervisor.child is None
        rig.say(HEARTBEAT, ATTITUDE)
        rig.turn_until(lambda: not rig.gate.armed)
        rig.offset_s += LOOK_S + 0.1
        rig.turn_until(lambda: rig.supervisor.child)
        assert rig.supervisor.child is not dead
        words = rig.words()
        assert "was ended by signal 9 (Killed)" in words
        assert words.count("the gate stays, since the vehicle is armed: until somebody disarms it") == 1
        # It has another socket, and is heard and spoken to over it.
        rig.beats.clear()
        rig.up()


def test_its_children_are_killed_before_another_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the new application from what the dead one left: two may not fly one vehicle."""
    with rigged() as rig:
        rig.up()
        killed: list[int] = []
        rig.do("sys.exit(1)")
        rig.has_died()
        monkeypatch.setattr(supervisor, "children", lambda: [] if killed else [4_194_999])
        monkeypatch.setattr(supervisor, "kill", killed.append)
        rig.offset_s += REST_S + 0.1
        rig.turn_until(lambda: killed)
        assert rig.supervisor.child is None
        rig.offset_s += LOOK_S + 0.1
        rig.turn_until(lambda: rig.supervisor.child)


def test_the_end_of_another_process_is_no_end_of_the_application() -> None:
    """Orphans that were adopted end here too."""
    with rigged() as rig:
        rig.up()
        subprocess.run([sys.executable, "-c", "pass"], check=True)
        rig.supervisor.on_child_signal(rig.now_s())
        assert rig.supervisor.child is not None
        assert rig.supervisor.exit_code is None


def test_leave_of_a_dead_application_is_taken_only_when_nothing_flies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the first half second after a death: to wait for the dead can block the gate for longer than that."""
    with rigged() as rig:
        rig.up()
        rig.say(ARMED)
        rig.turn_until(lambda: rig.gate.armed)
        left: list[float] = []
        monkeypatch.setattr(supervisor, "deaths", lambda: left.append(rig.now_s()))
        rig.do("os.kill(os.getpid(), 9)")
        rig.has_died()
        rig.offset_s += REST_S + LOOK_S
        rig.turn_for(0.05)
        assert left == []
        rig.say(HEARTBEAT, ATTITUDE)
        rig.turn_until(lambda: not rig.gate.armed)
        rig.offset_s += LOOK_S + 0.1
        rig.turn_until(lambda: rig.supervisor.child)
        assert len(left) == 1


def test_one_that_dies_again_and_again_is_given_up() -> None:
    """Protects against starting what does not run for ever: the count is kept."""
    ends = (sys.executable, "-c", "pass")
    with rigged(replace(PLAN, restart_command=ends, restarts=2)) as rig:
        rig.up()
        rig.do("sys.exit(1)")
        rig.has_died()
        for _ in range(2):
            rig.offset_s += REST_S + LOOK_S
            rig.turn_until(lambda: rig.supervisor.child)
            rig.has_died()
        rig.offset_s += REST_S + LOOK_S
        assert rig.loop.run() == 1
        assert "was started 3 times; it is not started again" in rig.words()


def test_a_restart_that_fails_is_tried_again_and_given_up() -> None:
    """Protects the gate from a restart that is no program: it is told each time, counted, and does not raise."""
    with rigged(replace(PLAN, restart_command=("/no/such/program",), restarts=2)) as rig:
        rig.up()
        rig.do("sys.exit(1)")
        rig.has_died()
        while rig.supervisor.exit_code is None:
            rig.offset_s += REST_S + LOOK_S
            rig.turn_for(0.02)
        words = rig.words()
        assert rig.supervisor.exit_code == 1
        assert words.count("the application cannot be started: [Errno 2]") == 2


def test_one_that_hangs_is_killed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the log, and a process that takes its time to die."""
    with rigged() as rig:
        rig.up()
        rig.do("time.sleep(60)")
        monkeypatch.setattr(rig.gate, "hangs", lambda _now_s: True)
        killed: list[int] = []
        monkeypatch.setattr(supervisor, "kill", killed.append)
        # A process that waits for a disk does not die at once.
        rig.turn_for(0.05)
        (pid,) = killed
        processes.kill(pid)
        rig.has_died()
        words = rig.words()
        assert words.count("the application hung for 10 s; it is killed") == 1


def test_it_may_close_its_socket_and_live() -> None:
    """Protects the gate's loop from a socket at its end and from an address where nobody listens."""
    with rigged() as rig:
        rig.up()
        rig.do("gate.shutdown(socket.SHUT_WR); time.sleep(60)")
        rig.turn_until(lambda: rig.supervisor.child and rig.supervisor.child.silent)
        rig.say(ATTITUDE)
        rig.turn_for(0.05)
        assert rig.supervisor.exit_code is None


def test_the_gate_stays_while_it_stops_the_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects a landing that is due when the application has said its last word."""
    monkeypatch.setattr(Gate, "airborne", True)
    with rigged() as rig:
        rig.up()
        rig.turn_for(0.3)
        assert rig.gate.stage > 0, "no beats come"
        rig.do(f"say('{Goodbye(1).packed().hex()}'); sys.exit(1)")
        rig.has_died()
        rig.offset_s += REST_S + LOOK_S
        rig.turn_for(0.05)
        assert rig.supervisor.exit_code is None
        monkeypatch.setattr(Gate, "airborne", False)
        assert rig.loop.run() == 1


def test_a_gate_that_is_asked_to_end_says_that_it_waits_for_the_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects whoever presses Ctrl-C again and again: what is waited for, and what ends it, is said each time."""
    monkeypatch.setattr(Gate, "airborne", True)
    monkeypatch.setattr(Gate, "armed", True)
    monkeypatch.setattr(Gate, "stage", Stage.LAND)
    with rigged() as rig:
        rig.up()
        rig.do("os.kill(os.getpid(), 9)")
        rig.has_died()
        for asked in (1, 2):
            rig.supervisor.request_end(None)
            rig.offset_s += REST_S + LOOK_S
            rig.loop.turn()
            rig.say(ATTITUDE)
            rig.turn_until(lambda: rig.now_s() - rig.loop._heard_s < 1.0)
            rig.turn_for(0.05)
            assert rig.supervisor.exit_code is None
            assert rig.words().count("the gate stays, since it stops the vehicle") == 1, asked
        monkeypatch.setattr(Gate, "airborne", False)
        rig.offset_s += LOOK_S
        assert rig.loop.run() == 1
