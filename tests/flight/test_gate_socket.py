"""The application's end of the socket to the gate never waits and never raises."""

from __future__ import annotations

import math
import os
import socket
import threading

import pytest

from companion.errors import InputError
from companion.flight.gate_socket import NOTICES, GateSocket
from companion.gate.faults import Fault, Stage
from companion.gate.protocol import GATE_FD, Beat, Goodbye, Notice, Phase
from tests.flight.fake_gate import MARK, FakeGate, end

BEAT = Beat(10.0, 0.1, 0.1, 0.02, 3.0, 0.5, Phase.EXPLORING)


def test_beats_and_the_last_word_arrive_in_order() -> None:
    with FakeGate() as gate:
        gate.link.beat(BEAT)
        gate.link.goodbye(130)
        assert gate.heard() == [BEAT, Goodbye(130)]


def test_notices_come_in_order_and_cannot_steer_a_terminal() -> None:
    with FakeGate() as gate:
        brake = Notice(Stage.BRAKE, Fault.DEPTH_STALE, "brake: depth_stale")
        gate.notify(brake, Notice(Stage.BRAKE, None, "a\x1b[2Jb"))
        assert gate.link.notices() == [brake, Notice(Stage.BRAKE, None, "a [2Jb")]
        assert gate.link.notices() == []
        assert not gate.link.gone


def test_the_stage_is_known_without_its_text() -> None:
    """Protects from a lost notice: a take-off would go on under a gate that lands the vehicle."""
    with FakeGate() as gate:
        assert gate.link.stage is None
        gate.notify(Notice(Stage.LAND, Fault.ESTIMATOR))
        assert gate.link.notices() == []
        assert gate.link.stage == Notice(Stage.LAND, Fault.ESTIMATOR)


def test_mavlink_and_words_go_both_ways_in_their_order() -> None:
    """A beat has to be there before the setpoint that rests on it."""
    with FakeGate() as gate:
        came: list[bytes] = []
        marked = gate.link._on_frames

        def on_frames(frames: bytes) -> None:
            came.append(frames)
            marked(frames)

        gate.link.open(on_frames)
        gate._ours.send(b"\xfd up")
        gate.say("between")
        gate.link.beat(BEAT)
        gate.link.send(b"\xfd down")
        assert came == [b"\xfd up", MARK]
        assert [gate._ours.recv(4096) for _ in range(2)] == [BEAT.packed(), b"\xfd down"]


def test_closing_waits_for_the_call_that_has_begun() -> None:
    """Protects MAVSDK from bytes that come while it is destroyed."""
    with FakeGate() as gate:
        begun, may_end, ended = threading.Event(), threading.Event(), threading.Event()

        def slow(_frames: bytes) -> None:
            begun.set()
            may_end.wait(10.0)
            ended.set()

        gate.link.open(slow)
        gate._ours.send(MARK)
        assert begun.wait(10.0)
        threading.Timer(0.05, may_end.set).start()
        gate.link.close()
        assert ended.is_set()


def test_a_gate_that_floods_costs_a_tick_no_more_than_so_many() -> None:
    with FakeGate() as gate:
        gate.say(*map(str, range(NOTICES + 3)))
        assert [notice.text for notice in gate.link.notices()] == [str(number) for number in range(3, NOTICES + 3)]


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
        gate._ours.send(Notice(Stage.LAND, Fault.ESTIMATOR, "land: estimator").packed())
        gate.die()
        assert [notice.text for notice in gate.link.notices()] == ["land: estimator"]
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
    monkeypatch.delenv(GATE_FD, raising=False)
    with pytest.raises(InputError, match="no gate"):
        GateSocket.from_environment()


def test_the_link_is_the_inherited_socket_and_goes_no_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """Held by the process of the map as well, it would hide from the gate that the application is gone."""
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    number = os.dup(its.fileno())
    os.set_inheritable(number, True)
    monkeypatch.setenv(GATE_FD, str(number))
    with ours, its:
        link = GateSocket.from_environment()
        assert not os.get_inheritable(number)
        link.beat(BEAT)
        assert ours.recv(100) == BEAT.packed()
        end(link)


@pytest.mark.parametrize("number", ["none", "-1", "99999"])
def test_an_environment_that_names_no_socket_is_refused(number: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(GATE_FD, number)
    with pytest.raises(InputError, match="companion run"):
        GateSocket.from_environment()


def test_what_is_not_known_survives_the_way() -> None:
    with FakeGate() as gate:
        gate.link.beat(Beat(1.0, math.inf, math.inf, math.inf, math.nan, math.inf, Phase.GROUND))
        (beat,) = gate.beats()
        assert (beat.depth_age_s, beat.phase) == (math.inf, Phase.GROUND)
        assert math.isnan(beat.ahead_m)
