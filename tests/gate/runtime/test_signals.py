"""Who asks the gate to end: whom it asks in turn, and when it stays all the same."""

from __future__ import annotations

import signal
import threading
from types import SimpleNamespace

import pytest

from companion.gate.gate import Gate
from companion.gate.runtime.signals import Signals
from companion.gate.runtime.supervisor import GONE_S, LOOK_S, REST_S
from tests.gate.runtime.rig import ATTITUDE, Rig, rigged


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
