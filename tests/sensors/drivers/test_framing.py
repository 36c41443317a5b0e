"""The wire format: what goes in comes out, however it is cut; garbage never crashes and never becomes a message."""

from __future__ import annotations

import itertools
import json
import math
import struct
import zlib
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.model import Beam, Camera, RangeReading
from companion.sensors.drivers.framing import (
    LARGEST_PAYLOAD_BYTES,
    MAGIC,
    PREFIX_BYTES,
    VERSION,
    Decoder,
    FramingError,
    encode_camera,
    encode_depth,
    encode_ping,
    encode_planar,
    encode_pong,
    encode_ranges,
)
from companion.sensors.drivers.messages import MOST_READINGS, DepthImage, Kind, Message, Ping, Pong, Ranges
from companion.sensors.sink import RawPlanar

CAMERA = Camera(5, 3, 2.5, 2.25, 2.0, 1.0, 0.25, 10.0, 0.1, mount_pitch_rad=0.2)
DEPTH = np.linspace(0.5, 9.0, 15, dtype=np.float32).reshape(3, 5)
READINGS = (RangeReading(Beam.DOWN, 1.25, 1.5, 8.0), RangeReading(Beam.UP, 1.25, None, 8.0))
BEARINGS, RANGES = np.linspace(-3.0, 3.0, 7), np.array([1.0, 2.0, np.nan, 4.0, np.inf, 6.0, 7.0])
STREAM = b"".join(
    (
        encode_camera(CAMERA),
        encode_depth(1.5, DEPTH),
        encode_ranges(READINGS),
        encode_ping(Ping(3.25)),
        encode_planar(1.75, BEARINGS, RANGES, 12.0),
        encode_pong(Pong(3.25, -7.5)),
    )
)


def raw(kind: int, header: object, payload: bytes = b"", version: int = VERSION, magic: bytes = MAGIC) -> bytes:
    """A message made by hand, with a right checksum."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    prefix = struct.pack("<4sBBHI", magic, version, kind, len(text), len(payload))
    return prefix + struct.pack("<I", zlib.crc32(prefix + text)) + text + payload


def decode(data: bytes, cuts: Sequence[int] = ()) -> tuple[list[Message], bool]:
    """The messages in ``data`` fed in pieces, and whether it ended in a refusal."""
    decoder, messages = Decoder(), []
    edges = [0, *sorted(cuts), len(data)]
    try:
        for begin, end in itertools.pairwise(edges):
            for message in decoder.feed(data[begin:end]):
                messages.append(message)  # noqa: PERF402 - those before the refusal count
    except FramingError:
        return messages, True
    return messages, False


def assert_is_the_stream(messages: list[Message]) -> None:
    camera, depth, ranges, ping, planar, pong = messages
    assert camera == CAMERA
    assert isinstance(depth, DepthImage)
    assert depth.t_s == 1.5
    assert depth.depth_m.dtype == np.float32
    np.testing.assert_array_equal(depth.depth_m, DEPTH)
    assert ranges == Ranges(READINGS)
    assert ping == Ping(3.25)
    assert isinstance(planar, RawPlanar)
    assert (planar.t_s, planar.max_range_m) == (1.75, 12.0)
    np.testing.assert_array_equal(planar.bearings_rad, BEARINGS)
    np.testing.assert_array_equal(planar.ranges_m, RANGES)
    assert pong == Pong(3.25, -7.5)


@given(cuts=st.lists(st.integers(0, len(STREAM)), max_size=60))
def test_any_split_of_the_stream_decodes_alike(cuts: list[int]) -> None:
    """TCP cuts where it likes."""
    messages, refused = decode(STREAM, cuts)
    assert not refused
    assert_is_the_stream(messages)


def test_byte_by_byte() -> None:
    """The finest cut of all."""
    assert_is_the_stream(decode(STREAM, range(1, len(STREAM)))[0])


@given(garbage=st.binary(max_size=400), cuts=st.lists(st.integers(0, 400), max_size=5))
def test_garbage_is_refused_and_never_a_message(garbage: bytes, cuts: list[int]) -> None:
    """Another program on the port: no crash, no reading."""
    messages, refused = decode(garbage, [cut for cut in cuts if cut < len(garbage)])
    assert messages == []
    assert refused or len(garbage) < PREFIX_BYTES


@given(garbage=st.binary(min_size=PREFIX_BYTES, max_size=100), cuts=st.lists(st.integers(0, len(STREAM)), max_size=9))
def test_what_came_before_the_garbage_stays_and_nothing_comes_after(garbage: bytes, cuts: list[int]) -> None:
    """However it is cut, the good messages arrive, and a decoder that has refused once never trusts again."""
    messages, refused = decode(STREAM + garbage + STREAM, cuts)
    assert refused
    assert_is_the_stream(messages)


@given(place=st.integers(0, len(encode_ranges(READINGS)) - 1), bit=st.integers(0, 7))
def test_a_single_wrong_bit_is_refused(place: int, bit: int) -> None:
    """Lengths, kinds, ranges and stamps are under the checksum: a flipped bit is no nearer wall."""
    damaged = bytearray(encode_ranges(READINGS))
    damaged[place] ^= 1 << bit
    # Longer lengths wait for more bytes: give them.
    messages, refused = decode(bytes(damaged) + bytes(70_000))
    assert messages == []
    assert refused


def test_another_version_says_so() -> None:
    """A person must learn that two releases met, not that a message was damaged."""
    with pytest.raises(FramingError, match=f"speaks version 2 of the sensor stream, this one version {VERSION}"):
        list(Decoder().feed(raw(Kind.PING, {"sent_s": 1.0}, version=2)))


@pytest.mark.parametrize(
    "message",
    [
        pytest.param(raw(Kind.PING, {"sent_s": 1.0}, magic=b"HTTP"), id="another protocol"),
        pytest.param(raw(99, {"sent_s": 1.0}), id="unknown kind"),
        pytest.param(raw(Kind.PING, b""), id="no header"),
        pytest.param(raw(Kind.PING, b"{" * 5000), id="broken JSON"),
        pytest.param(raw(Kind.PING, b"[" * 16000), id="nested beyond reason"),
        pytest.param(raw(Kind.PING, b"\xff\xfe\xfd"), id="no text"),
        pytest.param(raw(Kind.PING, b" " * 16385), id="header too long"),
        pytest.param(raw(Kind.PING, [1.0]), id="a list for a header"),
        pytest.param(raw(Kind.PING, {}), id="nothing in it"),
        pytest.param(raw(Kind.PING, {"sent_s": None}), id="null stamp"),
        pytest.param(raw(Kind.PING, {"sent_s": True}), id="true for a stamp"),
        pytest.param(raw(Kind.PING, {"sent_s": math.nan}), id="NaN stamp"),
        pytest.param(raw(Kind.PING, b'{"sent_s":1e999}'), id="infinite stamp"),
        pytest.param(raw(Kind.PING, b'{"sent_s":1' + b"0" * 400 + b"}"), id="beyond every float"),
        pytest.param(raw(Kind.PING, b'{"sent_s":1' + b"0" * 9000 + b"}"), id="beyond every int"),
        pytest.param(raw(Kind.PING, {"sent_s": 1.0}, b"1234"), id="payload that does not belong"),
        pytest.param(raw(Kind.DEPTH, {"t_s": 1.0, "width_px": 2, "height_px": 2}, b"1234"), id="payload too short"),
        pytest.param(raw(Kind.DEPTH, {"t_s": 1.0, "width_px": 0, "height_px": 2}), id="no pixels"),
        pytest.param(raw(Kind.DEPTH, {"t_s": 1.0, "width_px": -2, "height_px": -2}, bytes(16)), id="negative size"),
        pytest.param(raw(Kind.DEPTH, {"t_s": 1.0, "width_px": 2.0, "height_px": 2}, bytes(16)), id="fractions"),
        pytest.param(raw(Kind.PLANAR, {"t_s": 1.0, "rays": 70000, "max_range_m": 1.0}), id="too many rays"),
        pytest.param(raw(Kind.RANGES, {"readings": 5}), id="no list of readings"),
        pytest.param(raw(Kind.RANGES, {"readings": [None] * 65}), id="too many readings"),
        pytest.param(raw(Kind.RANGES, {"readings": [7]}), id="no reading"),
        pytest.param(
            raw(Kind.RANGES, {"readings": [{"beam": "aft", "t_s": 1.0, "range_m": 1.0, "max_range_m": 8.0}]}),
            id="unknown beam",
        ),
        pytest.param(
            raw(Kind.RANGES, {"readings": [{"beam": "up", "t_s": 1.0, "range_m": "1", "max_range_m": 8.0}]}),
            id="text for a range",
        ),
    ],
)
def test_malformed_messages_are_refused(message: bytes) -> None:
    """Each of them with a right checksum: the sender is wrong, not the line."""
    messages, refused = decode(message + bytes(40))
    assert messages == []
    assert refused


@pytest.mark.parametrize("largest", [LARGEST_PAYLOAD_BYTES, 0])
def test_a_payload_beyond_the_bound_is_refused_before_it_is_reserved(largest: int) -> None:
    """Sixteen bytes must not cost the vehicle its memory."""
    prefix = struct.pack("<4sBBHI", MAGIC, VERSION, Kind.DEPTH, 20, largest + 1)
    decoder = Decoder(largest)
    with pytest.raises(FramingError, match=f"{largest + 1} of payload"):
        list(decoder.feed(prefix + bytes(4)))
    with pytest.raises(FramingError):
        decoder.received(0)


def test_a_depth_image_stays_where_the_socket_wrote_it() -> None:
    """No copy: the array is the memory that was handed out for receiving."""
    data, decoder = memoryview(encode_depth(1.0, np.ones((480, 640), np.float32))), Decoder()
    message = None
    while data.nbytes:
        buffer = decoder.get_buffer()
        count = min(buffer.nbytes, data.nbytes)
        buffer[:count] = data[:count]
        message, data = decoder.received(count), data[count:]
    assert isinstance(message, DepthImage)
    assert np.shares_memory(message.depth_m, np.frombuffer(buffer, np.uint8))


def test_each_image_has_its_own_memory() -> None:
    """The next image must not write into the one that the navigator looks at."""
    decoder = Decoder()
    first, second = (next(iter(decoder.feed(encode_depth(t, DEPTH * t)))) for t in (1.0, 2.0))
    assert isinstance(first, DepthImage)
    assert isinstance(second, DepthImage)
    assert not np.shares_memory(first.depth_m, second.depth_m)


def test_an_image_of_any_layout_is_sent_as_it_is_meant() -> None:
    """Transposed and mirrored views are what camera libraries hand out."""
    (message,) = Decoder().feed(encode_depth(1.0, DEPTH.T[::-1]))
    assert isinstance(message, DepthImage)
    np.testing.assert_array_equal(message.depth_m, DEPTH.T[::-1])


def test_ranges_that_json_has_no_word_for() -> None:
    """NaN is missing, infinity is free out to the limit."""
    said = [RangeReading(Beam.UP, 1.0, value, 8.0) for value in (math.nan, math.inf)]
    (message,) = Decoder().feed(encode_ranges(said))
    assert isinstance(message, Ranges)
    assert [r.range_m for r in message.readings] == [None, 8.0]


@pytest.mark.parametrize(
    "wrong",
    [
        pytest.param(lambda: encode_depth(1.0, np.ones((2, 2))), id="float64"),  # type: ignore[arg-type]
        pytest.param(lambda: encode_depth(1.0, np.ones(4, np.float32)), id="one-dimensional"),
        pytest.param(lambda: encode_depth(math.nan, DEPTH), id="NaN stamp"),
        pytest.param(lambda: encode_depth(1.0, np.empty((4001, 4000), np.float32)), id="beyond 64 MB"),
        pytest.param(lambda: encode_ranges(READINGS * 33), id="too many readings"),
        pytest.param(lambda: encode_ranges([RangeReading(Beam.UP, 1.0, 1.0, math.inf)]), id="infinite limit"),
        pytest.param(lambda: encode_planar(1.0, BEARINGS, RANGES[1:], 8.0), id="lengths differ"),
    ],
)
def test_the_sender_is_told_what_cannot_be_sent(wrong: object) -> None:
    """Better an error at the camera process than a stream that the vehicle refuses."""
    assert callable(wrong)
    with pytest.raises(ValueError, match=r".+"):
        wrong()


def test_the_largest_message_of_readings_fits_the_header() -> None:
    """Sixty-four of the longest numbers: the bound on the count implies the bound on the bytes."""
    longest = RangeReading(Beam.RIGHT, -1.2345678901234567e-100, 1.2345678901234567e-100, 1.2345678901234567e-100)
    assert len(list(Decoder().feed(encode_ranges([longest] * MOST_READINGS)))) == 1
