"""The process from its plan to its exit code, what it says when it cannot begin, and who asks it to end."""

from __future__ import annotations

import math
import os
import runpy
import signal
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from companion.errors import CompanionError, InputError
from companion.gate import __main__ as main_module
from companion.gate.faults import Stage
from companion.gate.gate import Gate
from companion.gate.plan import Attached, Plan, Signing
from companion.gate.protocol import Goodbye
from companion.gate.runtime import main as process
from companion.gate.runtime import processes as precedence
from companion.gate.runtime.signals import Signals
from companion.gate.runtime.supervisor import GONE_S, LOOK_S, REST_S, WAITED_S, WRITES_S
from tests.gate.built import PLAN
from tests.gate.runtime.rig import ATTITUDE, HOST, Rig, bound, rigged


def whole(**changes: Any) -> Plan:
    with bound() as free:
        url = f"udpin://{HOST}:{free.getsockname()[1]}"
    says_goodbye = (
        sys.executable,
        "-c",
        "import os, socket; "
        "gate = socket.socket(fileno=int(os.environ['COMPANION_GATE_FD'])); "
        f"gate.send(bytes.fromhex('{Goodbye(5).packed().hex()}'))",
    )
    return replace(PLAN, autopilot_url=url, command=says_goodbye, **changes)


def test_the_process_ends_with_the_applications_last_word(capfd: pytest.CaptureFixture[str]) -> None:
    """Protects the way from a plan to the exit code, with nothing of it replaced."""
    plan = whole(attached=(Attached("udpout://127.0.0.1:9", "read"),))
    assert process.run(plan) == 5
    said = capfd.readouterr().err
    assert "not real time" in said
    assert "gate: " in said.splitlines()[-1]


def test_a_broken_gate_ends_at_once_and_says_why(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Never on in a state that nobody knows: silence is what the autopilot understands."""

    def broken(_self: Gate, _now_s: float) -> list[bytes]:
        raise ArithmeticError("two and two is five")

    monkeypatch.setattr(Gate, "cycle", broken)
    assert process.run(whole()) == 70
    said = capfd.readouterr().err
    assert "the gate is broken and ends" in said
    assert "two and two is five" in said


def test_precedence_is_taken_where_it_is_given(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects the start on computers that give real time, a nice value, or neither."""
    asked: list[tuple[int, int]] = []

    def refused(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(
        os, "sched_setscheduler", lambda _pid, policy, parameter: asked.append((policy, parameter.sched_priority))
    )
    assert process.run(whole(realtime=True)) == 5
    assert "real time" in capfd.readouterr().err
    assert asked == [(os.SCHED_RR, 1)]
    monkeypatch.setattr(os, "sched_setscheduler", refused)
    nice: list[int] = []
    monkeypatch.setattr(os, "setpriority", lambda _which, _who, value: nice.append(value))
    assert precedence.take_precedence() == "nice -10"
    monkeypatch.setattr(os, "setpriority", refused)
    assert precedence.take_precedence().startswith("no precedence")


def test_what_cannot_be_started_or_opened_is_one_clear_line(tmp_path: Path) -> None:
    """Protects the person with a wrong path, or with a key that others can read."""
    with pytest.raises(CompanionError, match="the application cannot be started: /no/such program: "):
        process.run(replace(whole(), command=("/no/such", "program")))
    with pytest.raises(InputError, match=r"safety.signing.key_file .*key: "):
        process.run(whole(signing=Signing(str(tmp_path / "key"), 1)))
    key = tmp_path / "key"
    key.write_text("0123456789abcdef" * 4)
    key.chmod(0o644)
    with pytest.raises(InputError, match=r"chmod 600"):
        process.run(whole(signing=Signing(str(key), 1)))
    key.chmod(0o600)
    assert process.run(whole(signing=Signing(str(key), 1))) == 5


def plan_fd(text: str) -> str:
    fd = os.memfd_create("plan")
    os.write(fd, text.encode())
    return str(fd)


def test_the_module_reads_its_plan_and_runs() -> None:
    """Protects the way in which the application's command starts the gate."""
    assert main_module.main(("--plan-fd", plan_fd(whole().dumps()))) == 5


@pytest.mark.parametrize("arguments", [(), ("--plan-fd",), ("--plan", "3"), ("--plan-fd", "x")])
def test_started_by_hand_it_says_how(arguments: tuple[str, ...], capfd: pytest.CaptureFixture[str]) -> None:
    """Protects who starts the gate without a plan: they are told which command to use."""
    assert main_module.main(arguments) == 2
    assert "companion run" in capfd.readouterr().err


def test_as_a_program_it_ends_with_its_exit_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the exit code on its way to the shell."""
    monkeypatch.setattr(sys, "argv", ["safety", "--plan-fd"])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(str(main_module.__file__), run_name="__main__")


def test_a_plan_that_is_none_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    """Protects against a gate that runs with half a plan."""
    assert main_module.main(("--plan-fd", plan_fd("{}"))) == 2
    assert main_module.main(("--plan-fd", "1000000")) == 2
    assert capfd.readouterr().err.count("the gate cannot read its plan: ") == 2


# Who asks the gate to end: whom it asks in turn, and when it stays all the same.


@pytest.mark.parametrize(
    ("sent", "heard"), [(signal.SIGTERM, b"SIGTERM"), (signal.SIGINT, b"SIGINT"), (signal.SIGHUP, b"SIGTERM")]
)
def test_who_asks_the_gate_for_the_end_asks_the_application(sent: signal.Signals, heard: bytes) -> None:
    """Protects the flight's own way to end: the application lands, and the gate stays until it has."""
    with rigged() as rig:
        rig.up()
        signal.pthread_kill(threading.get_ident(), signal.SIGQUIT)
        signal.pthread_kill(threading.get_ident(), sent)
        rig.turn_until(lambda: heard in rig.beats)
        assert rig.supervisor.exit_code is None
        assert b"STOPPING=1" in rig.service_heard()


def test_ctrl_c_reaches_the_application_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The terminal has given it to the whole group already."""
    with rigged() as rig:
        rig.up()
        came = [SimpleNamespace(si_signo=signal.SIGINT, si_code=128)]
        monkeypatch.setattr(signal, "sigtimedwait", lambda *_: came.pop() if came else None)
        rig.turn_for(0.05)
        assert not came
        assert b"SIGINT" not in rig.beats
        # No start follows when it dies now.
        rig.do("os.kill(os.getpid(), 9)")
        assert_gives_up(rig)


def assert_gives_up(rig: Rig) -> None:
    rig.has_died()
    rig.offset_s += REST_S + LOOK_S
    assert rig.loop.run() == 1


def test_in_the_air_the_gate_outlives_a_dead_application_also_when_it_is_asked_to_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It brings the vehicle down; only an autopilot that is gone is not waited for."""
    monkeypatch.setattr(Gate, "airborne", True)
    with rigged() as rig:
        rig.up()
        rig.supervisor.request_end(None)
        rig.do("os.kill(os.getpid(), 9)")
        rig.has_died()
        rig.offset_s += REST_S + LOOK_S
        rig.loop.turn()
        rig.say(ATTITUDE)
        rig.turn_until(lambda: rig.now_s() - rig.loop._heard_s < 1.0)
        rig.turn_for(0.05)
        assert rig.supervisor.exit_code is None
        signal.pthread_kill(threading.get_ident(), signal.SIGTERM)
        rig.turn_for(0.05)
        assert rig.supervisor.exit_code is None
        rig.offset_s += GONE_S
        assert rig.loop.run() == 1


@pytest.mark.parametrize("last_word", [True, False])
def test_an_autopilot_that_is_gone_is_not_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch, last_word: bool) -> None:
    """Protects whoever flew it: the autopilot had died in flight, the map was written, and the gate stayed, deaf."""
    monkeypatch.setattr(Gate, "airborne", True)
    monkeypatch.setattr(Gate, "armed", True)
    monkeypatch.setattr(Gate, "stage", Stage.LAND)
    with rigged() as rig:
        rig.up()
        rig.do(f"say('{Goodbye(7).packed().hex()}'); sys.exit(0)" if last_word else "os.kill(os.getpid(), 9)")
        rig.turn_until(lambda: rig.supervisor.child is None)
        rig.say(ATTITUDE)
        rig.turn_until(lambda: rig.now_s() - rig.loop._heard_s < 1.0)
        rig.offset_s += REST_S + LOOK_S
        rig.turn_for(0.05)
        assert rig.supervisor.exit_code is None
        assert "the gate stays, since it stops the vehicle (land)" in rig.words()
        rig.offset_s += WAITED_S
        assert rig.loop.run() == (7 if last_word else 1)
        assert "the autopilot has been silent for" in rig.words()


def test_what_flies_by_odometry_that_passes_through_keeps_the_gate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects whoever has taken over: without the gate the autopilot would lose its position; it says so."""
    carries = [True]
    monkeypatch.setattr(Gate, "carries_odometry", property(lambda _: carries[0]))
    with rigged() as rig:
        rig.up()
        rig.do(f"say('{Goodbye(4).packed().hex()}'); sys.exit(0)")
        rig.turn_until(lambda: rig.supervisor.child is None)
        rig.turn_for(0.05)
        assert rig.supervisor.exit_code is None
        assert "the gate stays, since the vehicle flies by odometry that passes through it" in rig.words()
        carries[0] = False
        assert rig.loop.run() == 4


def test_whoever_asks_need_not_wait_so_long_for_one_that_is_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from deafness: after its application's last word the gate did not look for Ctrl-C any more."""
    monkeypatch.setattr(Gate, "airborne", True)
    monkeypatch.setattr(Gate, "stage", Stage.HOLD)
    with rigged() as rig:
        rig.up()
        rig.do(f"say('{Goodbye(0).packed().hex()}'); sys.exit(0)")
        rig.turn_until(lambda: rig.supervisor.child is None)
        rig.offset_s += GONE_S + 1.0
        rig.turn_for(0.05)
        assert rig.supervisor.exit_code is None
        rig.supervisor.request_end(None)
        assert rig.loop.run() == 0


def test_whoever_writes_what_was_flown_for_is_not_taken_for_hanging(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the map: with the autopilot gone nothing flies by the beats that do not come while it is written."""
    hangs_s = math.inf
    monkeypatch.setattr(Gate, "hangs", lambda _, now_s: now_s > hangs_s)
    with rigged() as rig:
        rig.up()
        child = rig.supervisor.child
        assert child is not None
        hangs_s = rig.now_s() - 1.0
        rig.supervisor.cycle(rig.now_s(), GONE_S + 1.0)
        assert "hung" not in rig.words()
        rig.supervisor.cycle(rig.now_s() + WRITES_S, GONE_S + 1.0)
        assert "the application hung" in rig.words()


def test_signals_are_as_they_were_afterwards() -> None:
    """Protects whatever the process does after the gate."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ()), signal.getsignal(signal.SIGCHLD)
    signals = Signals()
    signals.drain()
    # A flood of them ends too.
    signals.requests()
    signals.close()
    assert (signal.pthread_sigmask(signal.SIG_BLOCK, ()), signal.getsignal(signal.SIGCHLD)) == before


def test_signals_are_taken_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the cycle from a flood of signals."""
    signals = Signals()
    monkeypatch.setattr(signal, "sigtimedwait", lambda *_: SimpleNamespace(si_signo=15, si_code=0))
    assert signals.requests() == [signal.SIGTERM] * 16
    signals.close()
