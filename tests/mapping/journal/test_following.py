"""A journal that is read while it is written."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.mapping.journal import Journal, JournalFollower
from companion.mapping.journal.segment import record_at
from companion.mapping.voxels.chunks import keys_of
from tests.mapping.journal.journals import HEADER, Chunk, alike, held, piece, surface


def everything(follower: JournalFollower) -> set[Chunk]:
    """The chunks that are told until there is no more."""
    found: set[Chunk] = set()
    while len((news := follower.poll()).keys):
        assert len(set(news.keys.tolist())) == len(news.keys)
        for data in follower.records(news.keys):
            record = record_at(data, 0)
            assert record is not None
            found.add(record.chunk)
    return found


def content(folder: Path, follower: JournalFollower, copy: Path) -> None:
    """What the follower reads of all chunks is the journal, to the byte."""
    with Journal.read_only(folder) as journal, Journal.open(copy, HEADER) as made:
        made.append_records(follower.records(keys_of(journal.chunks)))
        assert held(made) == held(journal)


def test_what_is_appended_is_told_once(tmp_path: Path) -> None:
    folder, follower = tmp_path / "map.journal", JournalFollower(tmp_path / "map.journal")
    assert everything(follower) == set(), "the journal need not be there yet"
    with Journal.open(folder, HEADER) as journal:
        for step in range(3):
            journal.append(piece({(step, 0, 0): surface(step), (-1, 7, step): alike(-5)}))
            assert everything(follower) == {(step, 0, 0), (-1, 7, step)}
            assert everything(follower) == set()
        journal.append(piece({(0, 0, 0): surface(9)}))
        assert everything(follower) == {(0, 0, 0)}
    assert follower.header == HEADER
    content(folder, follower, tmp_path / "copy")


def test_the_unfinished_end_waits(tmp_path: Path) -> None:
    """Protects from half a record, which the writer appends while it is read."""
    folder = tmp_path / "map.journal"
    with Journal.open(folder, HEADER) as journal:
        journal.append(piece({(0, 0, 0): surface(0)}))
    (segment,) = folder.glob("*.segment")
    before = segment.stat().st_size
    with Journal.open(folder) as journal:
        journal.append(piece({(1, 0, 0): surface(1)}))
    whole = segment.read_bytes()
    follower = JournalFollower(folder)
    for cut in (before, before + 10, before + 100, len(whole) - 1):
        segment.write_bytes(whole[:cut])
        everything(follower)
        assert len(follower.records(keys_of(np.array([[1, 0, 0]], np.int32)))) == 0
    segment.write_bytes(whole)
    assert everything(follower) == {(1, 0, 0)}
    assert follower.rewinds == 0


def test_compaction_changes_nothing_that_is_told(tmp_path: Path) -> None:
    """Protects the copy of whoever follows while files are rewritten and removed."""
    folder, random = tmp_path / "map.journal", np.random.default_rng(1)
    follower = JournalFollower(folder)
    with Journal.open(folder, HEADER, segment_bytes=60_000) as journal:
        for step in range(60):
            chunks: dict[Chunk, NDArray[np.int16]] = {
                (int(x), 0, 0): surface(1000 * step + int(x)) for x in random.integers(0, 12, 4)
            }
            journal.append(piece(chunks))
            journal.compact_step(1.0)
            journal.commit()
            if step % 7 == 0:
                everything(follower)
        everything(follower)
        files = len(list(folder.glob("*.segment")))
    content(folder, follower, tmp_path / "copy")
    opened = [link.readlink() for link in Path("/proc/self/fd").iterdir() if link.is_symlink()]
    removed = [path for path in opened if path.name.endswith(".segment (deleted)")]
    assert files < 20
    assert len(removed) <= 2, "removed files are let go of"
    follower.close()


def test_a_journal_that_was_cut_is_told_from_the_beginning(tmp_path: Path) -> None:
    """After a power failure the disk may have less than was read before."""
    folder = tmp_path / "map.journal"
    with Journal.open(folder, HEADER) as journal:
        journal.append(piece({(0, 0, 0): surface(0)}))
        (segment,) = folder.glob("*.segment")
        size = segment.stat().st_size
        journal.append(piece({(1, 0, 0): surface(1)}))
        follower = JournalFollower(folder)
        assert everything(follower) == {(0, 0, 0), (1, 0, 0)}
    os.truncate(segment, size)
    with Journal.open(folder) as journal:
        assert everything(follower) == set()
        assert follower.rewinds == 1
        journal.append(piece({(2, 0, 0): surface(2)}))
        assert everything(follower) == {(0, 0, 0), (2, 0, 0)}
