"""Signed frames against pymavlink, and keys in files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega

from companion.mavlink.codec import Encoder, Framer, decode
from companion.mavlink.signing import MOST_STREAMS, RADIO_STATUS, SIGNATURE_BYTES, Signer, load_key
from tests.shared.clocks import HandClock

m: Any = ardupilotmega
KEY = bytes(range(1, 33))
NOW_S = 1_790_000_000.0
TICKS = int((NOW_S - 1_420_070_400) * 100_000)
PLAIN = Encoder(1, 192).pack("COMMAND_LONG", command=400, param1=1.0, target_system=1)


def signer(now_s: float = NOW_S, key: bytes = KEY, link_id: int = 3) -> Signer:
    return Signer(key, link_id, lambda: now_s)


def theirs(ticks: int = TICKS, *, key: bytes = KEY, system_id: int = 1) -> Any:
    """Pymavlink, as the autopilot."""
    mavlink = m.MAVLink(None, system_id, 1)
    mavlink.signing.secret_key, mavlink.signing.sign_outgoing = key, True
    mavlink.signing.timestamp, mavlink.signing.link_id = ticks, 0
    return mavlink


def heartbeat(mavlink: Any) -> bytes:
    raw: bytes = m.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(mavlink)
    return raw


def stamp(raw: bytes) -> int:
    return int.from_bytes(raw[-12:-6], "little")


@settings(max_examples=25, deadline=None)
@given(text=st.text("abc ", max_size=50), sequence=st.integers(0, 20))
def test_pymavlink_accepts_what_we_sign_and_we_find_it_whole(text: str, sequence: int) -> None:
    """Of every length: the checksum contains the flag, the signature all of it."""
    encoder = Encoder(1, 192)
    for _ in range(sequence):
        encoder.pack("HEARTBEAT")
    bare = encoder.pack("STATUSTEXT", severity=2, text=text)
    raw = signer().sign(bare)
    autopilot = theirs()
    (message,) = autopilot.parse_buffer(raw)
    assert (message.text, autopilot.signing.goodsig_count) == (text.strip("\0"), 1)
    (frame,) = Framer(datagram=True).frames(raw)
    assert frame.signed
    assert (stamp(raw), raw[-13]) == (TICKS, 3)
    assert Signer.unsigned(raw) == bare
    assert (decode(frame) or {})["text"] == text


def test_what_is_signed_anew_carries_only_our_signature() -> None:
    """The link to the autopilot has one key."""
    ours = signer()
    raw = ours.sign(signer(key=bytes(31) + b"x").sign(PLAIN))
    assert len(raw) == len(PLAIN) + SIGNATURE_BYTES
    assert len(theirs().parse_buffer(raw)) == 1
    assert signer().accepts(raw)


def test_stamps_rise_also_when_the_clock_is_stepped_back() -> None:
    """An equal or lower stamp is a repetition to the other side: we would be unheard until the clock caught up."""
    clock = HandClock(NOW_S)
    ours = Signer(KEY, 0, clock.now_s)
    stamps = []
    for now_s in (NOW_S, NOW_S, NOW_S - 3600.0, NOW_S + 1.0, -1e12, 1e12, 1e12):
        clock.time_s = now_s
        stamps.append(stamp(ours.sign(PLAIN)) - TICKS)
    assert stamps[:5] == [0, 1, 2, 100_000, 100_001]
    assert 2**48 > stamps[6] + TICKS > stamps[5] + TICKS > 2**47


def test_a_clock_before_the_beginning_still_signs() -> None:
    """A computer without a battery behind its clock starts in 1970."""
    assert stamp(signer(0.0).sign(PLAIN)) == 1


def test_what_pymavlink_signs_is_accepted_once() -> None:
    """A repetition is refused, as is what is older than the newest heard."""
    ours, autopilot = signer(), theirs()
    first, second = heartbeat(autopilot), heartbeat(autopilot)
    assert ours.accepts(second)
    assert not ours.accepts(second)
    assert not ours.accepts(first)
    assert ours.accepts(heartbeat(autopilot))


def test_senders_count_for_themselves() -> None:
    """The gimbal's stamps do not make the autopilot's old."""
    ours = signer()
    assert ours.accepts(heartbeat(theirs(TICKS + 50, system_id=2)))
    assert ours.accepts(heartbeat(theirs(TICKS + 10, system_id=1)))
    assert not ours.accepts(heartbeat(theirs(TICKS + 10, system_id=2)))


@pytest.mark.parametrize(("behind_s", "accepted"), [(59.9, True), (60.0, True), (60.1, False), (-1e6, True)])
def test_a_new_sender_must_not_be_a_minute_behind(behind_s: float, accepted: bool) -> None:
    """Else everything recorded before our start could be played to us."""
    assert signer().accepts(heartbeat(theirs(TICKS - round(behind_s * 100_000)))) is accepted


def test_a_known_sender_may_fall_behind_as_long_as_it_rises() -> None:
    """When NTP steps our clock by an hour the autopilot is not lost."""
    clock = HandClock(NOW_S)
    ours, autopilot = Signer(KEY, 0, clock.now_s), theirs()
    assert ours.accepts(heartbeat(autopilot))
    clock.advance(3600.0)
    assert ours.accepts(heartbeat(autopilot))


def test_we_follow_the_later_clock() -> None:
    """The autopilot refuses what is a minute behind it; it was told the time by a ground station, we were not."""
    ours, autopilot = signer(0.0), theirs()
    assert ours.accepts(heartbeat(autopilot))
    raw = ours.sign(PLAIN)
    assert stamp(raw) == TICKS + 1
    assert len(autopilot.parse_buffer(raw)) == 1


def test_a_stamp_at_the_end_of_time_is_refused() -> None:
    """Ours would have to rise beyond what 48 bits hold."""
    ours = signer()
    assert not ours.accepts(heartbeat(theirs(2**48 - 2)))
    assert stamp(ours.sign(PLAIN)) == TICKS


def test_a_wrong_key_is_refused_and_changes_nothing() -> None:
    """Neither the stamp of the sender it names nor ours."""
    ours = signer()
    assert ours.accepts(heartbeat(theirs(TICKS + 9_000_000, key=bytes(31) + b"x"))) is False
    assert ours.accepts(heartbeat(theirs()))
    assert stamp(ours.sign(PLAIN)) == TICKS + 1


@pytest.mark.parametrize("place", range(-SIGNATURE_BYTES - 2, 0))
def test_a_changed_bit_is_seen(place: int) -> None:
    """In the checksum, the link, the stamp and the signature; before, the checksum sees it too."""
    raw = bytearray(heartbeat(theirs()))
    raw[place] ^= 1
    assert not signer().accepts(bytes(raw))


def test_unsigned_is_refused_but_from_a_radio() -> None:
    """The radio's status is of use, and commands nothing."""
    ours = signer()
    radio = m.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7)
    assert not ours.accepts(PLAIN)
    assert not ours.accepts(m.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(m.MAVLink(None), force_mavlink1=True))
    assert ours.accepts(radio.pack(m.MAVLink(None)))
    assert ours.accepts(radio.pack(m.MAVLink(None), force_mavlink1=True))


def test_senders_are_bounded() -> None:
    """Even with the key nobody makes us keep more and more; those known stay heard."""
    ours = signer()
    autopilots = [theirs(system_id=number + 1) for number in range(MOST_STREAMS + 1)]
    assert [ours.accepts(heartbeat(one)) for one in autopilots] == [True] * MOST_STREAMS + [False]
    assert ours.accepts(heartbeat(autopilots[0]))


@settings(deadline=None)
@given(raw=st.one_of(st.binary(max_size=60), st.binary(max_size=30).map(lambda data: b"\xfd" + data)))
def test_garbage_is_refused_and_raises_nothing(raw: bytes) -> None:
    """Whoever calls with what the framer did not find must not be able to stop the gate."""
    # What holds no 109 is no RADIO_STATUS, which alone needs no signature.
    assert not signer().accepts(raw.replace(bytes((RADIO_STATUS,)), b""))


@pytest.mark.parametrize("raw", [b"", b"\xfd\x00", PLAIN[:-1], PLAIN + b"x", b"\x00" + PLAIN[1:], b"\xfe" + PLAIN[1:]])
def test_half_a_frame_is_neither_signed_nor_stripped(raw: bytes) -> None:
    """A signature over it would make it look whole."""
    with pytest.raises(ValueError, match=r"^not one whole MAVLink frame$"):
        signer().sign(raw)
    with pytest.raises(ValueError, match=r"^not one whole MAVLink frame$"):
        Signer.unsigned(raw)


def test_mavlink_1_cannot_be_signed_and_passes_as_it_is_upwards() -> None:
    """Its header has no place for the flag."""
    old = m.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3).pack(m.MAVLink(None), force_mavlink1=True)
    with pytest.raises(ValueError, match=r"^only a frame of MAVLink 2 can be signed$"):
        signer().sign(old)
    assert Signer.unsigned(old) == old
    assert Signer.unsigned(PLAIN) == PLAIN


@pytest.mark.parametrize(("message_id", "length"), [(9999, 0), (70_000, 17), (9999, 255), (0, 9)])
def test_stripping_needs_no_definition(message_id: int, length: int) -> None:
    """The checksum is corrected by the length alone, for whatever CRC_EXTRA there is."""
    extra = b"\x32"
    header = bytes((0xFD, length, 0, 0, 7, 1, 1)) + message_id.to_bytes(3, "little")
    body = header + bytes(index % 251 for index in range(length))
    raw = body + m.x25crc(body[1:] + extra).crc.to_bytes(2, "little")
    signed = signer().sign(raw)
    assert m.x25crc(signed[1 : 10 + length] + extra).crc == int.from_bytes(signed[-15:-13], "little")
    assert Signer.unsigned(signed) == raw


def test_a_key_of_another_length_is_refused() -> None:
    """Nobody else would have it."""
    with pytest.raises(ValueError, match=r"^a key has 32 bytes, not 16$"):
        signer(key=bytes(16))


def written(path: Path, data: bytes, mode: int = 0o600) -> Path:
    path.write_bytes(data)
    path.chmod(mode)
    return path


@pytest.mark.parametrize("data", [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\n"])
def test_a_key_is_bytes_or_hexadecimal_digits(data: bytes, tmp_path: Path) -> None:
    """As tools write them."""
    assert load_key(written(tmp_path / "key", data)) == KEY
    assert load_key(str(written(tmp_path / "read-only", data, 0o400))) == KEY


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "holds no key"),
        (KEY + b"\n", "holds no key"),
        (KEY.hex().encode()[:-1] + b"g", "holds no key"),
        (KEY.hex().encode() * 100, "holds no key"),
        (bytes(32), "zeros"),
        (b"0" * 64, "zeros"),
    ],
)
def test_what_is_no_key_is_refused_with_what_to_do(data: bytes, told: str, tmp_path: Path) -> None:
    """A link that is signed with half a key is a link that is not there."""
    with pytest.raises(ValueError, match=f"key: .*{told}.*openssl"):
        load_key(written(tmp_path / "key", data))


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602, 0o610, 0o601, 0o777])
def test_a_key_that_others_may_use_is_refused(mode: int, tmp_path: Path) -> None:
    """Who can read it flies the vehicle."""
    with pytest.raises(
        ValueError, match=rf"key: others may use it \(mode {mode:04o}\); keep the key to its owner: chmod 600 .*key$"
    ):
        load_key(written(tmp_path / "key", KEY, mode))


def test_a_key_of_another_user_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They could change it; root may."""
    path = written(tmp_path / "key", KEY)
    monkeypatch.setattr(os, "geteuid", lambda: path.stat().st_uid + 1)
    if path.stat().st_uid == 0:
        assert load_key(path) == KEY
        try:
            os.chown(path, 12345, -1)
        except PermissionError:
            pytest.skip("cannot give a file away here")
    monkeypatch.setattr(os, "geteuid", lambda: 54321)
    with pytest.raises(ValueError, match=r"key: belongs to user \d+; a signing key must belong to you or to root$"):
        load_key(path)


def test_only_a_file_is_a_key(tmp_path: Path) -> None:
    """A pipe nobody writes to must not hold the start, nor a folder leave anything open."""
    os.mkfifo(tmp_path / "pipe", 0o600)
    for path in (tmp_path / "pipe", tmp_path):
        with pytest.raises(
            ValueError, match=f"{path.name}: is no file; a signing key is a file of 64 hexadecimal digits$"
        ):
            load_key(path)
    with pytest.raises(OSError, match="missing"):
        load_key(tmp_path / "missing")


def test_links_and_senders_count_for_themselves_but_messages_do_not() -> None:
    """A recorded message must not pass beside a newer one of another kind; a second radio link must."""
    ours = signer()

    def attitude(mavlink: Any) -> bytes:
        raw: bytes = m.MAVLink_attitude_message(1, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0).pack(mavlink)
        return raw

    assert ours.accepts(heartbeat(theirs(TICKS + 50)))
    assert ours.accepts(attitude(theirs(TICKS + 50))) is False, "an equal stamp is a repetition"
    second = theirs(TICKS + 10)
    second.signing.link_id = 1
    assert ours.accepts(heartbeat(second)), "another link"
    gimbal = theirs(TICKS + 10)
    gimbal.srcComponent = 154
    assert ours.accepts(heartbeat(gimbal)), "another component"
    assert ours.accepts(attitude(gimbal)), "whose next stamp is later"


def test_a_minute_is_a_minute_and_the_end_of_time_its_end() -> None:
    """To the tick of 10 us."""
    for ticks, accepted in ((TICKS - 6_000_000, True), (TICKS - 6_000_001, False)):
        raw = heartbeat(theirs(ticks))
        assert stamp(raw) == ticks
        assert signer().accepts(raw) is accepted
    last = 2**48 - 2**40
    assert signer().accepts(heartbeat(theirs(last - 1))) is True
    assert signer().accepts(heartbeat(theirs(last))) is False


def test_what_is_not_whole_is_not_accepted() -> None:
    """Not even from a radio, whose messages need no signature."""
    radio: bytes = m.MAVLink_radio_status_message(1, 2, 3, 4, 5, 6, 7).pack(m.MAVLink(None))
    for raw in (b"", radio[:-1], radio + b"x", bytes(7)):
        assert signer().accepts(raw) is False


def test_what_is_whole_by_its_length_and_flags() -> None:
    """An old frame has no flags where a new one has them, and may have no payload."""
    empty = b"\xfe\x00\x05\x01\x01\x07\x00\x00"
    first = b"\xfe\x00\x01\x01\x01\x07\x00\x00"
    compatible = PLAIN[:3] + b"\x04" + PLAIN[4:]
    for raw in (empty, first, compatible):
        assert Signer.unsigned(raw) == raw
        assert signer().accepts(raw) is False
    for flags in (2, 3):
        strange = PLAIN[:2] + bytes((flags,)) + PLAIN[3:] + bytes(SIGNATURE_BYTES * flags)
        with pytest.raises(ValueError, match="whole"):
            Signer.unsigned(strange)


def test_a_key_may_have_zeros_and_is_read_without_a_trace(tmp_path: Path) -> None:
    """One key in eight has a zero in it; an open file would be inherited."""
    path = written(tmp_path / "key", bytes(range(32)))
    before = len(list(Path("/proc/self/fd").iterdir()))
    assert load_key(path) == bytes(range(32))
    assert len(list(Path("/proc/self/fd").iterdir())) == before
