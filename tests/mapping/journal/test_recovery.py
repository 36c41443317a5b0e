"""Opening a journal that a crash, a killed process, a power cut or a bad disk left behind."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import pytest

from companion.config.mapping import MapSettings
from companion.mapping.journal import Header, Journal, JournalError
from companion.mapping.journal.header import MAGIC, prologue
from companion.mapping.journal.segment import packed
from tests.mapping.journal.journals import HEADER, Chunk, Contents, alike, held, piece, surface, written

SHORT = Header(0.1, 847, -1992, 3476, "enu")

STEPS: list[tuple[Chunk, int]] = [
    *(((0, 0, 0), 1), ((-1, 2, -3), 2), ((0, 0, 0), 3)),
    *(((-1, 2, -3), 5), ((1048575, -1048576, 0), 6), ((9, 9, 9), 8)),
]


@pytest.fixture(autouse=True)
def fast_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """These tests open thousands of journals; no power is cut."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


def short_log() -> tuple[bytes, list[int], list[Contents]]:
    """One segment of short records; where each ends, and what the journal holds with the first 0, 1, 2 .. of them."""
    log, ends, states = prologue(SHORT), [len(prologue(SHORT))], [Contents()]
    for chunk, value in STEPS:
        log += packed(np.array([chunk], np.int32), alike(value)[np.newaxis])[0]
        ends.append(len(log))
        states.append({**states[-1], chunk: alike(value).tobytes()})
    return log, ends, states


def placed(folder: Path, *segments: bytes) -> Path:
    """A folder with these segments and nothing else."""
    folder.mkdir(exist_ok=True)
    for path in folder.iterdir():
        path.unlink()
    for number, data in enumerate(segments, 1):
        (folder / f"{number:08d}.segment").write_bytes(data)
    return folder


def test_a_log_cut_at_any_byte_loses_only_what_was_not_finished(tmp_path: Path) -> None:
    """Protects the map from a crash at any moment: all records before the cut are there, and the journal goes on."""
    log, ends, states = short_log()
    more = {(7, 7, 7): alike(70), (0, 0, 0): alike(71)}
    for cut in range(len(log) + 1):
        folder = placed(tmp_path / "map.journal", log[:cut])
        whole = sum(end <= cut for end in ends)
        wanted = states[max(whole - 1, 0)]
        if whole:
            with Journal.read_only(folder) as journal:
                assert held(journal) == wanted
                assert bool(journal.losses) == (cut not in ends)
        with Journal.open(folder, SHORT) as journal:
            assert held(journal) == wanted
            assert [loss.torn for loss in journal.losses] == [True] * (cut not in ends)
            journal.append(piece(more))
            journal.commit()
        with Journal.open(folder) as journal:
            assert held(journal) == {**wanted, **{chunk: values.tobytes() for chunk, values in more.items()}}
            assert journal.losses == ()


def test_zeros_behind_the_cut_are_cut_off_too(tmp_path: Path) -> None:
    """Protects from file systems which after a power cut show the length that a file should have had, filled up."""
    log, ends, states = short_log()
    for cut in range(ends[3], ends[5]):
        filled = log[:cut] + bytes(3000)
        folder = placed(tmp_path / "map.journal", filled)
        # A record may itself end with zeros: then those behind the cut complete it.
        wanted = states[sum(log[:end] == filled[:end] for end in ends) - 1]
        with Journal.open(folder, SHORT) as journal:
            assert held(journal) == wanted
            assert [loss.torn for loss in journal.losses] == [True]
        with Journal.open(folder, SHORT) as journal:
            assert held(journal) == wanted
            assert journal.losses == ()


def test_a_flipped_bit_costs_one_record_and_is_reported(tmp_path: Path) -> None:
    """Protects from bad memory cards: no exception, no value that was never written, and the user learns of it."""
    log, ends, states = short_log()
    ever = {chunk: {alike(value).tobytes() for other, value in STEPS if other == chunk} for chunk, _ in STEPS}
    newest = states[-1]
    for at in range(len(log)):
        damaged = bytearray(log)
        damaged[at] ^= 1 << at % 8
        folder = placed(tmp_path / "map.journal", bytes(damaged))
        with Journal.read_only(folder) as journal:
            found = held(journal)
            assert all(values in ever[chunk] for chunk, values in found.items())
            assert sum(found.get(chunk) != values for chunk, values in newest.items()) <= 1
            assert bool(journal.losses) == (at >= ends[0])
        with Journal.open(folder, SHORT) as journal:
            assert held(journal) == found
            journal.append(piece({(0, 0, 0): alike(99)}))
        with Journal.open(folder, SHORT) as journal:
            assert held(journal) == {**found, (0, 0, 0): alike(99).tobytes()}


def test_damage_that_comes_while_it_is_open_is_found_when_it_is_read(tmp_path: Path) -> None:
    """Protects what is delivered long after opening: each record is checked again whenever it is read."""
    log, ends, states = short_log()
    folder = placed(tmp_path / "map.journal", log)
    with Journal.read_only(folder) as journal:
        with (folder / "00000001.segment").open("r+b") as file:
            file.seek(ends[-1] - 1)
            file.write(b"\xff")
        assert held(journal) == states[-2]
        assert [loss.torn for loss in journal.losses] == [False]
        assert (9, 9, 9) not in set(map(tuple, journal.chunks.tolist()))


def test_records_inside_of_a_record_are_not_taken_for_records(tmp_path: Path) -> None:
    """Protects from resurrected values: while no record is damaged, nothing inside one is ever looked at."""
    inner, _ = packed(np.array([[1, 1, 1]], np.int32), alike(5)[np.newaxis])
    values = np.resize(np.frombuffer(inner + bytes(len(inner) % 2), np.int16), 4096).copy()
    wanted = written(tmp_path / "map.journal", [{(2, 2, 2): values}])
    with Journal.open(tmp_path / "map.journal") as journal:
        assert held(journal) == wanted


def test_a_damaged_file_is_kept(tmp_path: Path) -> None:
    """Protects evidence: no compaction throws away a file in which there may be more than this program can read."""
    folder = tmp_path / "map.journal"
    written(folder, [{(n, 0, 0): surface(n)} for n in range(4)], segment_bytes=3000)
    first = folder / "00000001.segment"
    data = bytearray(first.read_bytes())
    data[len(prologue(HEADER)) + 200] ^= 1
    first.write_bytes(data)
    with Journal.open(folder, HEADER, segment_bytes=3000) as journal:
        assert [(loss.path, loss.torn) for loss in journal.losses] == [(first, False)]
        for turn in range(10):
            journal.append(piece({(n, 0, 0): surface(100 + turn) for n in range(4)}))
            journal.compact_step(10.0)
            journal.commit()
    assert first.read_bytes() == bytes(data)


def test_a_map_of_another_kind_is_refused_by_name(tmp_path: Path) -> None:
    """Protects from maps in which voxels of two sizes or sensor models are mixed: the message has both values."""
    written(tmp_path, [])
    for other, words in (
        (Header.of(MapSettings(voxel_m=0.05)), "voxel_m is 0.05, not 0.1"),
        (Header.of(MapSettings(clamp_max_probability=0.9)), "highest is 2197, not 3476"),
        (Header.of(MapSettings(), "north-east-down"), "frame is north-east-down, not east-north-up"),
    ):
        with pytest.raises(JournalError, match=words):
            Journal.open(tmp_path, other)
    with Journal.open(tmp_path, Header.of(MapSettings(max_range_m=9.0))) as journal:
        assert held(journal) == {}


def test_a_newer_version_is_refused_and_untouched(tmp_path: Path) -> None:
    """Protects a map that a newer program wrote: this one does not know what it would destroy."""
    text = b'{"anything": 1}'
    front = struct.pack("<8sII", MAGIC, 2, len(text))
    crc = zlib.crc32(text, zlib.crc32(front + bytes(4)))
    data = 2 * (front + struct.pack("<I", crc) + text) + b"new kinds of records"
    folder = placed(tmp_path / "map.journal", data)
    for opened in (Journal.open, Journal.read_only):
        with pytest.raises(JournalError, match="newer version"):
            opened(folder)
    with pytest.raises(JournalError, match="newer version"):
        Journal.open(folder, HEADER)
    assert (folder / "00000001.segment").read_bytes() == data


@pytest.mark.parametrize("text", [b"[]", b"{}", b"\xff", b'{"voxel_m": "wide"}', b"nan"])
def test_a_header_of_something_else_is_refused(tmp_path: Path, text: bytes) -> None:
    """Protects from other programs' files that by chance look like ours: one clear error, no traceback."""
    front = struct.pack("<8sII", MAGIC, 1, len(text))
    crc = zlib.crc32(text, zlib.crc32(front + bytes(4)))
    folder = placed(tmp_path / "map.journal", 2 * (front + struct.pack("<I", crc) + text))
    with pytest.raises(JournalError, match="another program wrote it"):
        Journal.open(folder, HEADER)


def test_no_journal_is_told(tmp_path: Path) -> None:
    """Protects foreign folders from our files, and users from an empty map where they mistyped a path."""
    for opened in (Journal.read_only, Journal.open):
        for path in (tmp_path / "missing", tmp_path):
            with pytest.raises(JournalError, match="no map journal"):
                opened(path)
    (tmp_path / "letter.txt").write_text("dear all")
    with pytest.raises(JournalError, match=r"letter\.txt"):
        Journal.open(tmp_path, HEADER)
    with pytest.raises(JournalError, match="cannot open"):
        Journal.open(tmp_path / "letter.txt", HEADER)
    assert (tmp_path / "letter.txt").read_text() == "dear all"


def test_without_any_readable_header_nobody_guesses(tmp_path: Path) -> None:
    """Protects from a map of the wrong scale: records without a header are not given a voxel size by chance."""
    log, ends, _ = short_log()
    folder = placed(tmp_path / "map.journal", b"\x55" * ends[0] + log[ends[0] :])
    with pytest.raises(JournalError, match="readable header"):
        Journal.open(folder, SHORT)
    with pytest.raises(JournalError, match="readable header"):
        Journal.read_only(folder)
    (folder / "00000002.segment").write_bytes(prologue(SHORT))
    with Journal.read_only(folder) as journal:
        assert len(held(journal)) == len(short_log()[2][-1])


def test_segments_of_two_maps_are_refused(tmp_path: Path) -> None:
    """Protects from files that were copied together from two missions."""
    other = Header(0.2, 847, -1992, 3476, "enu")
    folder = placed(tmp_path / "map.journal", prologue(SHORT), prologue(other))
    with pytest.raises(JournalError, match=r"voxel_m is 0\.1, not 0\.2"):
        Journal.read_only(folder)


def test_an_unreadable_page_costs_only_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from bad sectors: a read that fails is a loss like any other, and not the end of the map."""
    folder = tmp_path / "map.journal"
    wanted = written(folder, [{(n, 0, 0): surface(n)} for n in range(30)])
    bad = range(8192, 12288)
    real = os.pread

    def pread(descriptor: int, size: int, offset: int) -> bytes:
        if size > 100 and offset < bad.stop and offset + size > bad.start:
            raise OSError(5, "Input/output error")
        return real(descriptor, size, offset)

    monkeypatch.setattr(os, "pread", pread)
    with Journal.read_only(folder) as journal:
        found = held(journal)
        assert journal.losses
    assert 15 < len(found) < 30
    assert found.items() <= wanted.items()


# A process that is killed while it writes.


CHUNKS = 12

CHILD = """
import sys
from pathlib import Path
from companion.mapping.journal import Journal
from tests.mapping.journal.journals import HEADER, piece, surface

step, compacts = int(sys.argv[2]), sys.argv[3] == "True"
journal = Journal.open(Path(sys.argv[1]), HEADER, segment_bytes=30_000)
while True:
    step += 1
    journal.append(piece({(n, step % 3, 0): surface(1000 * step + n) for n in range(12)}))
    if compacts:
        journal.compact_step(0.005)
    journal.commit()
    print(step, flush=True)
"""


@pytest.mark.timeout(400)
@pytest.mark.parametrize("compacts", [pytest.param(False, marks=pytest.mark.long), True])
def test_what_was_reported_as_committed_is_there(tmp_path: Path, compacts: bool) -> None:
    """Protects the last second before a crash: a real process is killed in the middle of it, again and again."""
    chance = np.random.default_rng(7)
    folder = tmp_path / "map.journal"
    last = 0
    for _ in range(3):
        arguments = [sys.executable, "-c", CHILD, str(folder), str(last), str(compacts)]
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            reported = [int(child.stdout.readline()) for _ in range(5)]
            for _ in range(5):
                # A reader while the other process writes and removes files: it sees one whole map.
                with Journal.read_only(folder) as reader:
                    assert len(held(reader)) == 3 * CHUNKS
            time.sleep(chance.uniform(0.0, 0.3))
            child.send_signal(signal.SIGKILL)
            reported += [int(line) for line in child.stdout if line.endswith("\n")]
        committed = reported[-1]
        with Journal.open(folder) as journal:
            assert all(loss.torn for loss in journal.losses)
            found = journal.read(np.array([(n, third, 0) for n in range(CHUNKS) for third in range(3)], np.int32))
            assert len(found.chunks) == 3 * CHUNKS
            for (n, third, _), values in zip(found.chunks.tolist(), found.values, strict=True):
                # What was on its way when the process died may be there too, chunk by chunk.
                steps = [step for step in range(committed - 2, committed + 2) if step % 3 == third]
                assert any(np.array_equal(values, surface(1000 * step + n)) for step in steps)
        last = committed + 1
