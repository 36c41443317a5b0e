"""Bytes to frames and back, against pymavlink, which is generated from the definitions."""

from __future__ import annotations

import math
import struct
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega

from companion.mavlink.codec import LONGEST_FRAME, Encoder, Frame, Framer, checksum, decode
from companion.mavlink.messages import LAYOUTS, NAMES

m: Any = ardupilotmega
HEARTBEAT = Encoder(1, 1).pack("HEARTBEAT", custom_mode=7, type=2, autopilot=12)
UNKNOWN = 9999

NUMBERS = {
    "b": st.integers(-(2**7), 2**7 - 1),
    "B": st.integers(0, 2**8 - 1),
    "h": st.integers(-(2**15), 2**15 - 1),
    "H": st.integers(0, 2**16 - 1),
    "i": st.integers(-(2**31), 2**31 - 1),
    "I": st.integers(0, 2**32 - 1),
    "q": st.integers(-(2**63), 2**63 - 1),
    "Q": st.integers(0, 2**64 - 1),
    "f": st.floats(width=32, allow_nan=False),
}
NEWER = {412}
"""REQUEST_EVENT is in MAVLink's common set, but not in the pymavlink that is installed; MAVSDK sends it."""
EVERY = pytest.mark.parametrize("number", sorted(set(LAYOUTS) - NEWER))


def framed(message_id: int, payload: bytes, crc_extra: int, *, system_id: int = 1, mavlink: int = 2) -> bytes:
    """A frame built by hand."""
    if mavlink == 1:
        raw = struct.pack("<BBBBBB", 0xFE, len(payload), 0, system_id, 1, message_id)
    else:
        raw = struct.pack(
            "<BBBBBBBHB", 0xFD, len(payload), 0, 0, 0, system_id, 1, message_id & 0xFFFF, message_id >> 16
        )
    raw += payload
    return raw + struct.pack("<H", checksum(raw[1:] + bytes([crc_extra])))


def parsed(raw: bytes) -> Any:
    """By pymavlink, which raises for whatever is wrong."""
    (message,) = m.MAVLink(None).parse_buffer(raw)
    return message


def only(raw: bytes) -> Frame:
    framer = Framer(datagram=True)
    (frame,) = framer.frames(raw)
    assert framer.bad == 0
    return frame


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    places = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[begin:end] for begin, end in pairwise(places)]


@EVERY
def test_the_table_is_that_of_the_definitions(number: int) -> None:
    """A wrong CRC_EXTRA makes a message unheard, a wrong layout makes it misread."""
    layout, theirs = LAYOUTS[number], m.mavlink_map[number]
    lists = {name for name in theirs.fieldnames if theirs.array_lengths[theirs.ordered_fieldnames.index(name)]}
    texts = {name for name, kind in zip(theirs.fieldnames, theirs.fieldtypes, strict=True) if kind == "char"}
    assert (layout.name, layout.crc_extra) == (theirs.msgname, theirs.crc_extra)
    assert layout.packing.size == theirs.unpacker.size
    assert layout.fields == tuple(name for name in theirs.ordered_fieldnames if name not in lists - texts)
    assert set(layout.texts) == texts
    assert NAMES[number] == layout.name


@EVERY
@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_what_we_pack_is_what_pymavlink_reads_and_what_we_decode(number: int, data: st.DataObject) -> None:
    """Both ways through the independent implementation, zeros at the end left out as MAVLink 2 does."""
    layout = LAYOUTS[number]
    fields: dict[str, Any] = {}
    for name in layout.fields:
        fields[name] = data.draw(
            st.one_of(st.just(0), number_of(layout.packing.format, layout.fields.index(name)))
            if name not in layout.texts
            else st.text("abc XYZ_09", max_size=10)
        )
    raw = Encoder(3, 192).pack(layout.name, **fields)
    message = parsed(raw)
    assert message.get_type() == layout.name
    assert (message.get_srcSystem(), message.get_srcComponent()) == (3, 192)
    assert {name: getattr(message, name) for name in layout.fields} == fields
    frame = only(raw)
    assert (frame.raw, frame.message_id, frame.system_id, frame.component_id) == (raw, number, 3, 192)
    assert decode(frame) == fields


def number_of(packing: str, index: int) -> st.SearchStrategy[Any]:
    """Values for one field."""
    codes = [code for code in packing.lstrip("<") if code.isalpha() and code != "x"]
    return NUMBERS[codes[index]]


@EVERY
@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_any_payload_reads_as_pymavlink_reads_it(number: int, data: st.DataObject) -> None:
    """Of MAVLink 1 and 2, of any length: what is missing is zero, text ends at a zero, infinities and NaN stay."""
    layout = LAYOUTS[number]
    payload = data.draw(st.binary(max_size=layout.packing.size))
    mavlink = data.draw(st.sampled_from([1, 2] if number < 256 else [2]))
    raw = framed(number, payload, layout.crc_extra, mavlink=mavlink)
    message, fields = parsed(raw), decode(only(raw))
    assert fields is not None
    for name, value in fields.items():
        expected = getattr(message, name)
        assert value == expected or (math.isnan(expected) and isinstance(value, float) and math.isnan(value))


def test_a_longer_message_than_ours_is_not_read() -> None:
    """A later definition may say something in the rest that changes the meaning of what is known."""
    layout = LAYOUTS[84]
    frame = only(framed(84, bytes(range(1, 55)), layout.crc_extra))
    assert len(frame.payload) == layout.packing.size + 1
    assert decode(frame) is None


def test_an_unknown_message_is_not_read() -> None:
    """It passes, and says nothing here."""
    assert decode(only(framed(UNKNOWN, b"abc", 0))) is None


@pytest.mark.parametrize(
    ("name", "fields", "told"),
    [
        ("NO_SUCH", {}, "^no message NO_SUCH in the table$"),
        (
            "HEARTBEAT",
            dict.fromkeys(["f", "b", "type", "e", "a", "d", "c"], 1),
            "^HEARTBEAT has no field a, b, c, d, e, f$",
        ),
        ("HEARTBEAT", {"type": 256}, "^HEARTBEAT: "),
        ("HEARTBEAT", {"type": 1.5}, "HEARTBEAT"),
        ("ATTITUDE", {"roll": 1e300}, "ATTITUDE"),
        ("STATUSTEXT", {"text": 1}, "STATUSTEXT"),
    ],
)
def test_what_cannot_be_packed_is_refused_with_its_name(name: str, fields: dict[str, Any], told: str) -> None:
    """Nothing wrong goes out in silence."""
    with pytest.raises(ValueError, match=told):
        Encoder(1, 1).pack(name, **fields)


def test_texts_are_cut_and_missing_fields_are_zero() -> None:
    """A pilot's text of 50 letters has no zero at its end."""
    message = parsed(Encoder(1, 192).pack("STATUSTEXT", severity=2, text="ä" + "x" * 80))
    assert (message.severity, message.text, message.id) == (2, "?" + "x" * 49, 0)


def test_a_message_of_zeros_keeps_one_byte() -> None:
    """The definition of MAVLink 2 asks for it."""
    raw = Encoder(1, 1).pack("TIMESYNC")
    assert raw[1] == 1
    assert decode(only(raw)) == {"tc1": 0, "ts1": 0}


def test_sequence_numbers_count_and_wrap() -> None:
    """Receivers compute the loss from them."""
    encoder = Encoder(1, 1)
    assert [encoder.pack("HEARTBEAT")[4] for _ in range(258)] == [*range(256), 0, 1]


@settings(deadline=None)
@given(data=st.binary(max_size=300))
def test_the_checksum_is_mavlinks(data: bytes) -> None:
    """The trick with mirrored bits against the definition, byte by byte."""
    assert checksum(data) == m.x25crc(data).crc


NOISE = st.one_of(
    st.binary(max_size=80),
    st.lists(st.sampled_from(b"\xfd\xfe\x00\x01\x1e"), max_size=80).map(bytes),
    st.integers(0, len(HEARTBEAT)).map(lambda length: HEARTBEAT[:length]),
    st.binary(min_size=1, max_size=9).map(lambda payload: framed(0, payload, 50)),
)


@settings(max_examples=60, deadline=None)
@given(noise=st.lists(NOISE, max_size=8), cuts=st.lists(st.integers(0, 2000), max_size=12), datagram=st.booleans())
def test_nothing_raises_and_nothing_is_kept(noise: list[bytes], cuts: list[int], datagram: bool) -> None:
    """Whatever comes in whatever pieces: what is kept is less than a frame, and no byte is in two frames."""
    data = b"".join(noise)
    framer = Framer(datagram=datagram)
    taken = 0
    for piece in pieces(data, cuts):
        for frame in framer.frames(piece):
            taken += len(frame.raw)
            assert data.count(frame.raw)
            decode(frame)
        assert len(framer._rest) < (1 if datagram else LONGEST_FRAME)
    assert taken + len(framer._rest) <= len(data)


@settings(max_examples=60, deadline=None)
@given(
    noise=st.lists(
        st.binary(max_size=60).map(lambda data: data.replace(b"\xfe", b"").replace(b"\xfd", b"")), max_size=9
    ),
    cuts=st.lists(st.integers(0, 2000), max_size=12),
)
def test_every_frame_between_noise_is_found_in_any_pieces(noise: list[bytes], cuts: list[int]) -> None:
    """Noise without a false beginning hides nothing."""
    data = HEARTBEAT + b"".join(one + HEARTBEAT for one in noise)
    framer = Framer()
    found = [frame.raw for piece in pieces(data, cuts) for frame in framer.frames(piece)]
    assert found == [HEARTBEAT] * (len(noise) + 1)
    assert (framer.bad > 0) == any(noise)


@settings(max_examples=60, deadline=None)
@given(noise=st.binary(max_size=40), cuts=st.lists(st.integers(0, 900), max_size=12))
def test_false_beginnings_hide_a_frame_for_280_bytes_at_most(noise: bytes, cuts: list[int]) -> None:
    """A broken message of the table ends with its checksum; behind it everything is found again."""
    begun = b"\xfd" + bytes([len(noise)]) + b"\x00\x00\x00\x01\x01\x00\x00\x00" + noise
    data = begun + HEARTBEAT * 20
    framer = Framer()
    found = [frame.raw for piece in pieces(data, cuts) for frame in framer.frames(piece)]
    hidden = 20 - found.count(HEARTBEAT)
    assert hidden * len(HEARTBEAT) <= LONGEST_FRAME
    assert found[-1] == HEARTBEAT
    assert Framer(datagram=True).frames(data)[-1].raw == HEARTBEAT


@pytest.mark.parametrize("lost", range(len(HEARTBEAT)))
def test_a_lost_byte_costs_one_frame(lost: int) -> None:
    """As on a serial line: the next frame is found although the broken one reaches into it."""
    broken = HEARTBEAT[:lost] + HEARTBEAT[lost + 1 :]
    framer = Framer()
    assert [frame.raw for frame in framer.frames(broken + HEARTBEAT * 20)][-19:] == [HEARTBEAT] * 19
    assert framer.bad == 1
    alone = Framer(datagram=True)
    assert [frame.raw for frame in alone.frames(broken + HEARTBEAT)] == [HEARTBEAT]
    assert alone.bad == 1


@pytest.mark.parametrize("at", range(1, len(HEARTBEAT)))
def test_a_changed_bit_is_seen(at: int) -> None:
    """Each byte counts; in the id it makes another message, for which this checksum is wrong or unknown."""
    changed = bytearray(HEARTBEAT)
    changed[at] ^= 0x10
    framer = Framer(datagram=True)
    found = framer.frames(bytes(changed))
    assert [frame for frame in found if frame.message_id in NAMES] == []
    assert framer.bad == 1 or found


def test_unknown_messages_pass_by_their_shape() -> None:
    """Whole, from somebody, and followed by a frame or nothing."""
    raw = framed(UNKNOWN, b"\x01\x02\x03", 77)
    old = framed(2, b"\x01\x02\x03", 77, mavlink=1)
    for one in (raw, old):
        framer = Framer()
        assert [frame.raw for frame in framer.frames(one + HEARTBEAT + one)] == [one, HEARTBEAT, one]
        assert framer.bad == 0
        assert [frame.raw for frame in framer.frames(one + b"x" + HEARTBEAT)] == [HEARTBEAT]
        assert framer.bad == 1
    assert Framer().frames(framed(UNKNOWN, b"abc", 77, system_id=0)) == []


def test_a_flag_that_nobody_knows_is_refused() -> None:
    """It says that whoever does not know it must not read the message."""
    raw = bytearray(HEARTBEAT)
    raw[2] = 0x02
    framer = Framer()
    assert framer.frames(bytes(raw)) == []
    assert framer.bad == 1


@pytest.mark.parametrize("length", range(1, len(HEARTBEAT)))
def test_a_truncated_datagram_is_dropped_and_counted(length: int) -> None:
    """It must not be completed by the next one, which may come from somebody else."""
    framer = Framer(datagram=True)
    assert framer.frames(HEARTBEAT[:length]) == []
    assert framer.bad == 1
    assert framer.frames(HEARTBEAT[length:] + HEARTBEAT)[-1].raw == HEARTBEAT
    assert framer.bad == 2


@pytest.mark.parametrize("raw", [HEARTBEAT, framed(0, bytes(9), 50, mavlink=1)])
def test_a_stream_byte_by_byte_gives_the_frame_with_its_last(raw: bytes) -> None:
    """Nothing waits for what follows."""
    framer = Framer()
    found = [framer.frames(raw[at : at + 1]) for at in range(len(raw))]
    assert [len(frames) for frames in found] == [0] * (len(raw) - 1) + [1]
    assert framer.bad == 0


def test_signed_frames_are_found_whole() -> None:
    """The signature is 13 bytes behind the checksum."""
    mavlink = m.MAVLink(None, 1, 1)
    mavlink.signing.secret_key, mavlink.signing.sign_outgoing = bytes(range(32)), True
    raw = m.MAVLink_attitude_message(1, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0).pack(mavlink)
    frames = Framer().frames(raw + HEARTBEAT)
    assert [(frame.raw, frame.signed) for frame in frames] == [(raw, True), (HEARTBEAT, False)]
    fields = decode(frames[0])
    assert fields is not None
    assert fields["yaw"] == pytest.approx(0.3)


OLD = framed(0, bytes(9), 50, mavlink=1)


@pytest.mark.parametrize("whole", [HEARTBEAT, OLD])
def test_a_frame_in_two_pieces_is_found_once(whole: bytes) -> None:
    """Cut anywhere behind another one; what was given out is not given out again."""
    for cut in range(1, len(whole)):
        framer = Framer()
        found = [framer.frames(piece) for piece in (whole + whole[:cut], whole[cut:], b"", whole)]
        assert [[frame.raw for frame in frames] for frames in found] == [[whole], [whole], [], [whole]]
        assert framer.bad == 0


@pytest.mark.parametrize("magic", [b"\xfe", b"\xfd"])
def test_a_false_beginning_right_before_a_frame_hides_nothing_in_a_datagram(magic: bytes) -> None:
    """Each byte may be the beginning, also the next one."""
    framer = Framer(datagram=True)
    assert [frame.raw for frame in framer.frames(magic + HEARTBEAT)] == [HEARTBEAT]
    assert framer.bad == 1


@pytest.mark.parametrize("flags", [0x02, 0x03, 0x80])
def test_a_flag_that_nobody_knows_is_refused_although_the_checksum_is_right(flags: int) -> None:
    """Else every frame of a later protocol would be misread, or read for ever."""
    body = bytearray(HEARTBEAT[:-2])
    body[2] = flags
    raw = bytes(body) + struct.pack("<H", checksum(bytes(body[1:]) + b"\x32"))
    framer = Framer(datagram=True)
    assert framer.frames(raw) == []
    assert framer.bad == 1
    assert [frame.raw for frame in framer.frames(raw + HEARTBEAT)] == [HEARTBEAT]


def test_numbers_of_three_bytes_and_old_frames_are_read_right() -> None:
    """The number decides what is done with a message; only a new frame can be signed."""
    assert only(framed(70_000, b"abc", 9)).message_id == 70_000
    assert only(OLD).signed is False
    assert only(HEARTBEAT).signed is False


def test_what_is_left_out_is_nothing() -> None:
    """Numbers, texts and flags: receivers refuse flags that they do not know."""
    raw = Encoder(1, 192).pack("STATUSTEXT", severity=1)
    assert decode(only(raw)) == {"severity": 1, "text": "", "id": 0, "chunk_seq": 0}
    assert (raw[2:4], raw[9]) == (b"\0\0", 0)


def test_the_longest_frame_is_the_longest() -> None:
    """Who keeps room for it keeps enough, and no more."""
    mavlink = m.MAVLink(None, 1, 1)
    mavlink.signing.secret_key, mavlink.signing.sign_outgoing = bytes(range(32)), True
    longest = m.MAVLink_file_transfer_protocol_message(0, 1, 1, [255] * 251).pack(mavlink)
    assert len(longest) + 255 - longest[1] == LONGEST_FRAME
    assert [frame.raw for frame in Framer().frames(longest)] == [longest]


def test_only_what_pymavlink_does_not_know_goes_uncompared() -> None:
    """Protects every other layout from being left out of the comparison."""
    assert set(LAYOUTS) - set(m.mavlink_map) == NEWER
    assert (LAYOUTS[412].crc_extra, LAYOUTS[412].packing.size) == (33, 6)
