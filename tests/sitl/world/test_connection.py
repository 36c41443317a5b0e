"""Bytes to messages: everything that is not a good message of our vehicle's autopilot is counted or ignored."""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from companion.clock import MonotonicClock
from companion.errors import InputError
from sitl.world.connection import Connection, ConnectionCounts, Decoder, TruthUrl, frames
from sitl.world.handshake import wanted_ids
from sitl.world.truth_messages import TruthKind
from tests.sitl.world.messages import heartbeat, hil

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
        TruthUrl.parse("udp://127.0.0.1:14560"),
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
    url = TruthUrl.parse("udp://127.0.0.1:14560")
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
    assert TruthUrl.parse(url).kind == kind


@pytest.mark.parametrize(
    "url", ["", "14560", "udp://:14560", "udp://h", "serial:///dev/ttyS0", "udp://h:99999", "tcp://[::"]
)
def test_wrong_addresses(url: str) -> None:
    """Refused at once, not after the mine has been built."""
    with pytest.raises(InputError, match="--truth"):
        TruthUrl.parse(url)
