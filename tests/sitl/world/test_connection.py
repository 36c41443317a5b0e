"""The world's link to the autopilot: bytes to messages, and what is asked of it."""

from __future__ import annotations

import logging
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.clock import MonotonicClock
from companion.errors import InputError
from sitl.world.connection import Connection, ConnectionCounts, Decoder, PeerUrl, frames
from sitl.world.handshake import ORIGIN_TRIES, Handshake, told_an_origin, wanted_ids
from sitl.world.mavlink_out import LocalFrame
from sitl.world.truth_messages import TruthKind, TruthReader
from tests.sitl.world.messages import LAT_DEG, Tap, heartbeat, hil

WANTED = wanted_ids(TruthKind.AUTO)


def packed(message: Any, system: int = 1, component: int = 1, version1: bool = False) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, system, component), force_mavlink1=version1))


def decoded(data: bytes, counts: ConnectionCounts | None = None) -> list[str]:
    decoder = Decoder(1, WANTED, counts or ConnectionCounts())
    messages = [decoder.decode(frame) for frame in frames(bytearray(data))]
    return [message.get_type() for message in messages if message is not None]


def test_both_versions_are_read() -> None:
    """ArduPilot starts in version 1 on some ports."""
    data = packed(heartbeat(12), version1=True) + packed(hil((0, 0, 0)))
    assert decoded(data) == ["HEARTBEAT", "HIL_STATE_QUATERNION"]


@given(cuts=st.lists(st.integers(0, 200), max_size=8))
def test_a_stream_may_be_cut_anywhere(cuts: list[int]) -> None:
    """TCP delivers bytes, not messages."""
    data = packed(heartbeat(12)) + packed(hil((0, 0, 0))) + packed(heartbeat(12))
    buffer, found, begin = bytearray(), [], 0
    for end in [*sorted(cut for cut in cuts if cut < len(data)), len(data)]:
        buffer += data[begin:end]
        begin = end
        found += [bytes(frame) for frame in frames(buffer)]
    assert b"".join(found) == data
    assert not buffer


def test_a_signed_message_is_as_long_as_it_is() -> None:
    """Thirteen bytes more; the one behind it must still be found."""
    sender = mavlink.MAVLink(None, 1, 1)
    sender.signing.secret_key = bytes(32)
    sender.signing.sign_outgoing = True
    signed = bytes(heartbeat(12).pack(sender))
    assert len(signed) == len(packed(heartbeat(12))) + 13
    assert decoded(signed + packed(hil((0, 0, 0)))) == ["HEARTBEAT", "HIL_STATE_QUATERNION"]


def test_other_vehicles_and_other_parts_are_not_ours() -> None:
    """A second vehicle on the same port must not move ours; a gimbal knows no truth."""
    counts = ConnectionCounts()
    data = packed(hil((0, 0, 0)), system=2) + packed(heartbeat(12), component=154)
    assert decoded(data, counts) == []
    assert counts.other_systems == {2: 1}


def test_a_broken_checksum_is_counted() -> None:
    """One flipped bit of a position is a jump through a wall."""
    data = bytearray(packed(hil((0, 0, 0))))
    data[20] ^= 4
    counts = ConnectionCounts()
    assert decoded(bytes(data), counts) == []
    assert counts.malformed == 1


def test_garbage_is_survived() -> None:
    """Random bytes, mutilated messages and good ones: no exception, and a good one alone is still read."""
    draw = random.Random(5)  # noqa: S311 - not a secret
    received: list[str] = []
    connection = Connection(
        PeerUrl.of_truth("udp://127.0.0.1:14560"),
        1,
        WANTED,
        MonotonicClock(),
        lambda message, _: received.append(message.get_type()),
    )
    good = packed(hil((0, 0, 0)))
    for _ in range(3000):
        data = bytearray(draw.randbytes(draw.randrange(300)) if draw.random() < 0.5 else good)
        for _ in range(draw.randrange(1, 4)):
            if data:
                data[draw.randrange(len(data))] = draw.choice((0xFD, 0xFE, draw.randrange(256)))
        connection.on_datagram(bytes(data), ("127.0.0.1", 1))
    received.clear()
    connection.on_datagram(good, ("127.0.0.1", 1))
    assert received == ["HIL_STATE_QUATERNION"]
    assert connection.counts.malformed > 100


def test_without_anybody_there_sending_is_counted() -> None:
    """Nothing waits for an autopilot that may come in an hour."""
    url = PeerUrl.of_truth("udp://127.0.0.1:14560")
    connection = Connection(url, 1, WANTED, MonotonicClock(), lambda _, __: None)
    connection.mavlink.heartbeat_send(18, 8, 0, 0, 4)
    assert connection.counts.unsent == 1


@pytest.mark.parametrize(
    ("url", "kind"),
    [
        ("udp://127.0.0.1:14560", "udp"),
        ("udpin://0.0.0.0:14560", "udp"),
        ("udpout://h:1", "udpout"),
        ("tcp://h:5760", "tcp"),
    ],
)
def test_addresses(url: str, kind: str) -> None:
    """As other MAVLink programs write them."""
    assert PeerUrl.of_truth(url).kind == kind


@pytest.mark.parametrize(
    "url", ["", "14560", "udp://:14560", "udp://h", "serial:///dev/ttyS0", "udp://h:99999", "tcp://[::"]
)
def test_wrong_addresses(url: str) -> None:
    """Refused at once, not after the mine has been built."""
    with pytest.raises(InputError, match="--truth"):
        PeerUrl.of_truth(url)


@pytest.mark.parametrize(
    "url", ["", "14565", "udp://h:1", "udpin://h:1", "tcp://h:1", "udpout://h", "udpout://h:99999"]
)
def test_odometry_goes_to_one_address_only(url: str) -> None:
    """It is sent, not waited for: who passes it on listens."""
    assert str(PeerUrl.of_odometry("udpout://h:1")) == "udpout://h:1"
    with pytest.raises(InputError, match="--odometry-to"):
        PeerUrl.of_odometry(url)


# What the world asks of the autopilot, and that it stops asking once it has it.


HIL, SIM = 115, 108


class Talk:
    """A conversation and what it says, second by second."""

    def __init__(
        self, kind: TruthKind = TruthKind.AUTO, gps: bool = True, frame: LocalFrame = LocalFrame.LOCAL_NED
    ) -> None:
        self.tap = Tap()
        self.reader = TruthReader(kind)
        self.handshake = Handshake(self.tap.sender, 1, self.reader, 50.0, told_an_origin(gps, frame))
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
    talk = Talk(gps=False)
    talk.reader.on_message(hil((0.0, 0.0, 0.0)), 100.0)
    talk.go_on(7)
    origins = talk.tap.named("SET_GPS_GLOBAL_ORIGIN")
    assert len(origins) >= 2
    assert origins[0].latitude == pytest.approx(LAT_DEG * 1e7, abs=2)
    assert origins[0].altitude == 0, "as the application says it: another would shift the height"
    assert origins[0].target_system == 1
    talk.handshake.on_message(mavlink.MAVLink_gps_global_origin_message(1, 2, 3, 0), talk.now_s)
    talk.go_on(10)
    assert len(talk.tap.named("SET_GPS_GLOBAL_ORIGIN")) == len(origins)


def test_an_autopilot_that_never_answers_is_not_told_for_ever(caplog: pytest.LogCaptureFixture) -> None:
    """A line says so, once."""
    talk = Talk(gps=False)
    with caplog.at_level(logging.WARNING):
        talk.go_on(90, truth_hz=50)
    assert len(talk.tap.named("SET_GPS_GLOBAL_ORIGIN")) == ORIGIN_TRIES
    assert sum("SET_GPS_GLOBAL_ORIGIN" in record.message for record in caplog.records) == 1


def test_an_autopilot_that_was_started_anew_is_told_again() -> None:
    """It has forgotten: its heartbeats were away for longer than three seconds."""
    talk = Talk(gps=False)
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


@pytest.mark.parametrize(("autopilot", "told"), [(12, False), (3, True)])
def test_px4_that_is_fed_local_frd_is_told_no_origin(autopilot: int, told: bool) -> None:
    """With both every landing flew to latitude 0, longitude 0; ArduPilot needs both."""
    talk = Talk(gps=False, frame=LocalFrame.LOCAL_FRD)
    talk.go_on(10, autopilot=autopilot)
    assert bool(talk.tap.named("SET_GPS_GLOBAL_ORIGIN")) is told


@pytest.mark.parametrize(("beats", "said"), [(False, "nothing received"), (True, "HIL_STATE_QUATERNION")])
def test_it_says_once_what_is_missing(beats: bool, said: str, caplog: pytest.LogCaptureFixture) -> None:
    """No autopilot at all, or one that is real and knows no truth: waiting in silence helps nobody."""
    talk = Talk()
    with caplog.at_level(logging.WARNING):
        talk.go_on(60, beats=beats)
    assert [said in record.message for record in caplog.records] == [True]
