"""What the world asks of the autopilot, and that it stops asking once it has it."""

from __future__ import annotations

import logging

import pytest
from pymavlink.dialects.v20 import common as mavlink

from sitl.world.handshake import ORIGIN_TRIES, Handshake
from sitl.world.truth_messages import TruthKind, TruthReader
from tests.sitl.world.messages import ALT_M, LAT_DEG, Tap, heartbeat, hil

HIL, SIM = 115, 108


class Talk:
    """A conversation and what it says, second by second."""

    def __init__(self, kind: TruthKind = TruthKind.AUTO, set_origin: bool = False) -> None:
        self.tap = Tap()
        self.reader = TruthReader(kind)
        self.handshake = Handshake(self.tap.sender, 1, self.reader, 50.0, set_origin)
        self.now_s = 100.0

    def go_on(self, seconds: int, truth_hz: int = 0, beats: bool = True, autopilot: int = 12) -> None:
        for _ in range(seconds):
            if beats:
                self.handshake.on_message(heartbeat(autopilot), self.now_s)
            for i in range(truth_hz):
                self.handshake.on_truth(self.now_s + i / truth_hz - 1.0)
            self.handshake.send_due(self.now_s)
            self.now_s += 1.0

    def asked(self) -> list[tuple[float, float]]:
        commands = self.tap.named("COMMAND_LONG")
        assert {c.command for c in commands} <= {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL}
        return [(c.param1, c.param2) for c in commands]


def test_it_says_that_it_is_there() -> None:
    """Once a second, as part of the vehicle and not as an autopilot: else ground stations see a second vehicle."""
    talk = Talk()
    talk.go_on(3)
    beats = talk.tap.named("HEARTBEAT")
    assert len(beats) == 3
    assert {(b.get_srcSystem(), b.get_srcComponent(), b.autopilot) for b in beats} == {(1, 197, 8)}


def test_it_asks_for_both_truths_until_it_knows_the_autopilot() -> None:
    """50 Hz are 20 ms; each simulator has one of the two."""
    talk = Talk()
    talk.go_on(1, beats=False)
    assert talk.asked() == [(HIL, 20_000.0), (SIM, 20_000.0)]


@pytest.mark.parametrize(("autopilot", "message"), [(12, HIL), (3, SIM)])
def test_it_asks_each_autopilot_for_its_own(autopilot: int, message: int) -> None:
    """The other would be refused, with a line in the autopilot's log each time."""
    talk = Talk()
    talk.go_on(1, autopilot=autopilot)
    assert talk.asked() == [(message, 20_000.0)]


def test_local_positions_are_two_messages() -> None:
    """Position and attitude."""
    talk = Talk(TruthKind.LOCAL)
    talk.go_on(1)
    assert talk.asked() == [(32, 20_000.0), (30, 20_000.0)]


def test_it_does_not_ask_for_what_comes() -> None:
    """At 50 Hz it is content; at PX4's own 25 Hz it is not."""
    content, asking = Talk(), Talk()
    content.go_on(10, truth_hz=50)
    asking.go_on(10, truth_hz=25)
    assert len(content.asked()) <= 1  # in the first second there was nothing yet
    assert len(asking.asked()) == 5


def test_it_asks_seldom_after_a_while() -> None:
    """Some simulators cannot do more."""
    talk = Talk()
    talk.go_on(120, truth_hz=25)
    assert len(talk.asked()) == pytest.approx(20, abs=1)


def test_an_origin_is_told_until_it_is_answered() -> None:
    """Where the truth says that it booted; a datagram may be lost, so more than once."""
    talk = Talk(set_origin=True)
    talk.reader.on_message(hil((0.0, 0.0, 0.0)), 100.0)
    talk.go_on(7)
    origins = talk.tap.named("SET_GPS_GLOBAL_ORIGIN")
    assert len(origins) >= 2
    assert origins[0].latitude == pytest.approx(LAT_DEG * 1e7, abs=2)
    assert origins[0].altitude == pytest.approx(ALT_M * 1e3, abs=2)
    assert origins[0].target_system == 1
    talk.handshake.on_message(mavlink.MAVLink_gps_global_origin_message(1, 2, 3, 0), talk.now_s)
    talk.go_on(10)
    assert len(talk.tap.named("SET_GPS_GLOBAL_ORIGIN")) == len(origins)


def test_an_autopilot_that_never_answers_is_not_told_for_ever(caplog: pytest.LogCaptureFixture) -> None:
    """A line says so, once."""
    talk = Talk(set_origin=True)
    with caplog.at_level(logging.WARNING):
        talk.go_on(90, truth_hz=50)
    assert len(talk.tap.named("SET_GPS_GLOBAL_ORIGIN")) == ORIGIN_TRIES
    assert sum("SET_GPS_GLOBAL_ORIGIN" in record.message for record in caplog.records) == 1


def test_an_autopilot_that_was_started_anew_is_told_again() -> None:
    """It has forgotten: its heartbeats were away for longer than three seconds."""
    talk = Talk(set_origin=True)
    talk.go_on(4)
    talk.handshake.on_message(mavlink.MAVLink_gps_global_origin_message(1, 2, 3, 0), talk.now_s)
    before = len(talk.tap.named("SET_GPS_GLOBAL_ORIGIN"))
    talk.go_on(5, beats=False)
    talk.go_on(5)
    assert len(talk.tap.named("SET_GPS_GLOBAL_ORIGIN")) > before


def test_with_gps_it_keeps_its_origin() -> None:
    """An origin from outside would move the vehicle."""
    talk = Talk()
    talk.go_on(10)
    assert talk.tap.named("SET_GPS_GLOBAL_ORIGIN") == []


@pytest.mark.parametrize(("beats", "said"), [(False, "nothing received"), (True, "HIL_STATE_QUATERNION")])
def test_it_says_once_what_is_missing(beats: bool, said: str, caplog: pytest.LogCaptureFixture) -> None:
    """No autopilot at all, or one that is real and knows no truth: waiting in silence helps nobody."""
    talk = Talk()
    with caplog.at_level(logging.WARNING):
        talk.go_on(60, beats=beats)
    assert [said in record.message for record in caplog.records] == [True]
