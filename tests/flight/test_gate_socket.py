"""The application's end of its talk with the gate never waits and never raises."""

from __future__ import annotations

import math
import os
import socket

import pytest

from companion.errors import InputError
from companion.flight.gate_socket import NOTICES_AT_ONCE, GateLink
from companion.gate.protocol import BEAT_FD, GATE_URL, Beat, Goodbye, Phase
from tests.flight.fake_gate import FakeGate

BEAT = Beat(10.0, 0.1, 0.1, 0.02, 3.0, 0.5, Phase.EXPLORING)


def test_beats_and_the_last_word_arrive_in_order() -> None:
    with FakeGate() as gate:
        gate.link.beat(BEAT)
        gate.link.goodbye(130)
        assert gate.heard() == [BEAT, Goodbye(130)]


def test_notices_come_in_order_and_cannot_steer_a_terminal() -> None:
    with FakeGate() as gate:
        gate.say("brake: depth_stale")
        gate.say("a\x1b[2Jb")
        assert gate.link.notices() == ["brake: depth_stale", "a [2Jb"]
        assert gate.link.notices() == []
        assert not gate.link.gone


def test_a_gate_that_floods_costs_a_tick_no_more_than_so_many() -> None:
    with FakeGate() as gate:
        for number in range(NOTICES_AT_ONCE + 3):
            gate.say(str(number))
        assert len(gate.link.notices()) == NOTICES_AT_ONCE
        assert gate.link.notices() == [str(NOTICES_AT_ONCE + i) for i in range(3)]


def test_a_gate_that_does_not_read_holds_up_nobody() -> None:
    """Protects the tick: the gate that hangs is for the autopilot's failsafe to deal with, not for us to wait for."""
    with FakeGate() as gate:
        for _ in range(5000):
            gate.link.beat(BEAT)
        assert gate.link.unsent > 0
        sent = len(gate.heard())
        assert sent + gate.link.unsent == 5000
        gate.link.beat(BEAT)
        assert gate.heard() == [BEAT]


@pytest.mark.parametrize("unread", [False, True])
def test_the_death_of_the_gate_is_noticed_and_its_last_words_are_heard(unread: bool) -> None:
    """With beats that it has not read, the kernel reports a reset before it hands out the last words."""
    with FakeGate() as gate:
        if unread:
            gate.link.beat(BEAT)
        gate.say("land: estimator")
        gate.die()
        assert gate.link.notices() == ["land: estimator"]
        assert gate.link.gone
        gate.link.beat(BEAT)
        gate.link.goodbye(0)
        assert gate.link.notices() == []


def test_a_beat_to_a_dead_gate_tells_that_it_is_dead() -> None:
    with FakeGate() as gate:
        gate.die()
        gate.link.beat(BEAT)
        assert gate.link.gone


def test_without_a_gate_there_is_no_link(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(BEAT_FD, raising=False)
    monkeypatch.delenv(GATE_URL, raising=False)
    assert GateLink.from_environment() is None
    monkeypatch.setenv(BEAT_FD, "3")
    assert GateLink.from_environment() is None, "half a gate is none"


def test_the_link_is_the_inherited_socket_and_goes_no_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """Held by the process of the map as well, it would hide from the gate that the application is gone."""
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    number = os.dup(its.fileno())
    os.set_inheritable(number, True)
    monkeypatch.setenv(BEAT_FD, str(number))
    monkeypatch.setenv(GATE_URL, "udpout://127.0.0.1:5")
    with ours, its:
        link = GateLink.from_environment()
        assert link is not None
        assert link.url == "udpout://127.0.0.1:5"
        assert not os.get_inheritable(number)
        link.beat(BEAT)
        assert ours.recv(100) == BEAT.packed()
        link._beats.close()


@pytest.mark.parametrize("number", ["none", "-1", "99999"])
def test_an_environment_that_names_no_socket_is_refused(number: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(BEAT_FD, number)
    monkeypatch.setenv(GATE_URL, "udpout://127.0.0.1:5")
    with pytest.raises(InputError, match="companion run"):
        GateLink.from_environment()


def test_what_is_not_known_survives_the_way() -> None:
    with FakeGate() as gate:
        gate.link.beat(Beat(1.0, math.inf, math.inf, math.inf, math.nan, math.inf, Phase.GROUND))
        (beat,) = gate.beats()
        assert (beat.depth_age_s, beat.phase) == (math.inf, Phase.GROUND)
        assert math.isnan(beat.ahead_m)
