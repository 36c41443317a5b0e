"""The application's end of what it has of the gate: the socket never waits, what was said is kept."""

from __future__ import annotations

import asyncio
import logging
import math
import os
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import cast

import pytest

from companion.errors import InputError
from companion.flight.events import EventEmitter, console, recording
from companion.flight.gate_client import KINDS_OF_NOTICES, OTHERS, GateClient, GateLostError
from companion.flight.gate_socket import NOTICES, GateSocket
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.gate.faults import Fault, Stage
from companion.gate.protocol import GATE_FD, Beat, Goodbye, Notice, Phase
from companion.model import Pose
from companion.recording import Recorder
from tests.control.stages import beside
from tests.flight.fake_gate import MARK, FakeGate, end
from tests.flight.test_reporting import Notes
from tests.shared.clocks import HandClock

POSE = Pose(99.98, 0.0, 0.0, 1.5, 0.0)


class Stand:
    """A talk with a fake gate."""

    def __init__(self, gate: FakeGate) -> None:
        self.gate = gate
        self.clock = HandClock(100.0)
        self.said: list[str] = []
        self.notes = Notes()
        self.flight = PhaseMachine()
        events = EventEmitter(console(self.said.append), recording(cast("Recorder", self.notes)))
        self.talk = GateClient(gate.link, self.clock, events, self.flight)


@pytest.fixture
def stand() -> Iterator[Stand]:
    with FakeGate() as gate:
        yield Stand(gate)


def test_a_beat_carries_the_ages_of_what_the_tick_rested_on(stand: Stand) -> None:
    stand.flight.phase = FlightPhase.EXPLORING
    stand.talk.has_map(lambda: 0.7)
    told = replace(beside(1), scan_age_s=0.2, ranges_age_s=0.1, ahead_m=2.5)
    stand.talk.ticked(100.0, POSE, told)
    (beat,) = stand.gate.beats()
    assert (beat.t_s, beat.depth_age_s, beat.ranges_age_s, beat.ahead_m) == (100.0, 0.2, 0.1, 2.5)
    assert beat.pose_age_s == pytest.approx(0.02)
    assert (beat.map_age_s, beat.phase) == (0.7, Phase.EXPLORING)


def test_before_the_first_pose_nothing_is_known(stand: Stand) -> None:
    stand.talk.ticked(100.0, None, None)
    (beat,) = stand.gate.beats()
    assert beat.pose_age_s == beat.depth_age_s == beat.ranges_age_s == beat.map_age_s == math.inf
    assert math.isnan(beat.ahead_m)
    assert beat.phase is Phase.GROUND


def test_a_stamp_from_the_future_is_no_age(stand: Stand) -> None:
    """The gate refuses a beat with an age below zero; silence would say that the tick failed, which it did not."""
    told = replace(beside(1), scan_age_s=-0.2, ranges_age_s=math.nan)
    stand.talk.ticked(100.0, replace(POSE, t_s=100.01), told)
    (beat,) = stand.gate.beats()
    assert beat.pose_age_s == beat.depth_age_s == beat.ranges_age_s == math.inf


def test_notices_are_shown_recorded_and_counted(stand: Stand) -> None:
    for text in ("brake: depth_stale", "pass: all is well", "brake: depth_stale"):
        stand.gate.say(text)
    stand.talk.look()
    assert stand.said == ["gate: brake: depth_stale", "gate: pass: all is well", "gate: brake: depth_stale"]
    assert ("gate", "brake: depth_stale", logging.WARNING) in stand.notes.events
    assert stand.talk.counted == {"brake: depth_stale": 2, "pass: all is well": 1}


def test_a_gate_with_ever_new_words_does_not_fill_the_memory(stand: Stand) -> None:
    for number in range(KINDS_OF_NOTICES + 10):
        stand.gate.say(f"notice {number}")
        stand.talk.look()
    assert len(stand.talk.counted) == KINDS_OF_NOTICES + 1
    assert stand.talk.counted[OTHERS] == 10


@pytest.mark.parametrize(
    ("stages", "took_over"),
    [
        ((), None),
        ((Stage.BRAKE,), None),
        ((Stage.BRAKE, Stage.HOLD), "hold: beat_late"),
        ((Stage.HOLD, Stage.LAND), "land: beat_late"),
        ((Stage.HOLD, Stage.PASS), None),
    ],
)
def test_it_is_known_whether_the_gate_has_taken_the_mode(
    stand: Stand, stages: tuple[Stage, ...], took_over: str | None
) -> None:
    """Else an operator would look for a pilot, or for a failsafe of the autopilot, that there was not."""
    stand.gate.notify(*(Notice(stage, Fault.BEAT_LATE) for stage in stages))
    stand.talk.look()
    assert stand.talk.took_over == took_over
    assert stand.talk.taken.is_set() == (took_over is not None)


def test_the_loss_of_the_gate_is_told_once(stand: Stand) -> None:
    stand.gate.die()
    stand.talk.look()
    stand.talk.look()
    assert stand.talk.lost.is_set()
    assert len(stand.said) == 1
    assert "failsafe" in stand.said[0]


async def test_on_the_ground_the_loss_of_the_gate_is_the_end(stand: Stand) -> None:
    stand.gate.die()
    with pytest.raises(GateLostError, match="nothing was armed"):
        await stand.talk.run()


@pytest.mark.parametrize("phase", [FlightPhase.TAKING_OFF, FlightPhase.EXPLORING, FlightPhase.LEAVING])
async def test_in_the_air_the_loss_is_for_the_flight_to_deal_with(stand: Stand, phase: FlightPhase) -> None:
    """What was flown for is to be saved; an error from here would take the map away."""
    stand.flight.phase = phase
    stand.gate.die()
    listening = asyncio.create_task(stand.talk.run())
    await stand.talk.lost.wait()
    await asyncio.sleep(0)
    assert not listening.done()
    listening.cancel()


async def test_the_end_is_said_again_while_the_map_is_written(stand: Stand) -> None:
    """An end that was missed would look like a hang, for which an application is killed."""
    stand.flight.phase = FlightPhase.ENDED
    stand.talk.ended()
    listening = asyncio.create_task(stand.talk.run())
    await stand.clock.sleep(0.25)
    listening.cancel()
    beats = stand.gate.beats()
    assert len(beats) >= 3
    assert {beat.phase for beat in beats} == {Phase.ENDED}


async def test_on_the_ground_only_ticks_are_told(stand: Stand) -> None:
    """A beat says that a tick was completed: nothing else may look like one."""
    listening = asyncio.create_task(stand.talk.run())
    await stand.clock.sleep(0.25)
    listening.cancel()
    assert stand.gate.beats() == []


# The application's end of the socket to the gate never waits and never raises.


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
        assert ours.recv(1000) == BEAT.packed()
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


def test_what_the_gate_says_of_the_link_is_known_until_it_is_over(stand: Stand) -> None:
    """Protects the pre-flight check: two senders of one number are seen by the gate alone."""
    stand.gate.say("link: two senders")
    stand.talk.look()
    assert stand.talk.link_problem == "two senders"
    stand.gate.say("link: ")
    stand.talk.look()
    assert stand.talk.link_problem == ""
    assert stand.said == ["gate: link: two senders"]
