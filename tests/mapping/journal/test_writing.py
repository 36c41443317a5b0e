"""Writing a journal: what is newest, who may write, a disk that is full or broken, and room that is won back."""

from __future__ import annotations

import errno
import os
import resource
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.mapping.journal import Journal, JournalError
from companion.mapping.voxels.piece import MapPiece
from tests.mapping.journal.journals import HEADER, Chunk, Contents, alike, held, piece, surface, written


def test_the_newest_record_counts_and_survives(tmp_path: Path) -> None:
    """Protects the map's state: what was appended last is read, before and after closing, also within one piece."""
    folder = tmp_path / "deep" / "map.journal"
    old, new, other = surface(1), surface(2), surface(3)
    with Journal.open(folder, HEADER) as journal:
        journal.append(piece({(0, 0, 0): old, (-5, 6, 7): other}))
        journal.append(MapPiece(np.zeros((2, 3), np.int32), np.array([old, new])))
        wanted = {(0, 0, 0): new.tobytes(), (-5, 6, 7): other.tobytes()}
        assert held(journal) == wanted
        assert journal.live_bytes < journal.bytes_on_disk
        asked = journal.read(np.array([[9, 9, 9], [0, 0, 0]], np.int32))
        assert asked.chunks.tolist() == [[0, 0, 0]]
    with Journal.open(folder) as journal:
        assert held(journal) == wanted
        assert journal.header == HEADER
        assert (journal.voxel_m, journal.threshold) == (0.1, 847)
        assert journal.losses == ()


def test_arrays_of_any_layout_are_taken(tmp_path: Path) -> None:
    """Protects callers that hand over views, read-only or strided arrays, or nothing at all."""
    values = np.array([surface(1), surface(2), surface(3), surface(4)])
    strided = MapPiece(np.arange(12, dtype=np.int32).reshape(4, 3)[::2], values[::2])
    frozen = MapPiece(np.full((1, 3), 7, np.int32), values[1:2])
    frozen.chunks.flags.writeable = frozen.values.flags.writeable = False
    with Journal.open(tmp_path, HEADER) as journal:
        for one in (strided, frozen, piece({})):
            journal.append(one)
        assert held(journal) == {
            (0, 1, 2): values[0].tobytes(),
            (6, 7, 8): values[2].tobytes(),
            (7, 7, 7): values[1].tobytes(),
        }


def test_one_writer_and_any_number_of_readers(tmp_path: Path) -> None:
    """Protects a journal from two writers; a reader neither waits nor disturbs, and sees the moment of its opening."""
    with Journal.open(tmp_path, HEADER) as journal:
        journal.append(piece({(0, 0, 0): alike(1)}))
        with pytest.raises(JournalError, match=f"process {os.getpid()} is writing it"):
            Journal.open(tmp_path, HEADER)
        with Journal.read_only(tmp_path) as first, Journal.read_only(tmp_path) as second:
            journal.append(piece({(0, 0, 0): alike(2)}))
            assert held(first) == held(second) == {(0, 0, 0): alike(1).tobytes()}
            with pytest.raises(ValueError, match="reading only"):
                first.append(piece({(0, 0, 0): alike(3)}))
            with pytest.raises(ValueError, match="reading only"):
                first.commit()
        assert held(journal) == {(0, 0, 0): alike(2).tobytes()}
    Journal.open(tmp_path, HEADER).close()


def test_a_reader_writes_nothing(tmp_path: Path) -> None:
    """Protects archived missions: looking at one changes no byte of it, even when its end is torn."""
    written(tmp_path, [{(0, 0, 0): surface(1)}])
    with next(tmp_path.glob("*.segment")).open("ab") as file:
        file.write(b"\xc3\x5e")
    before = {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in tmp_path.iterdir()}
    with Journal.read_only(tmp_path) as journal:
        assert len(held(journal)) == 1
    assert {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in tmp_path.iterdir()} == before


class BadDisk:
    """Stands in for calls of the operating system that write: ``left_bytes`` fit, then each fails with ``error``."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.left_bytes: int | None = None
        self.error = errno.ENOSPC
        self.syncs_fail = self.cuts_fail = False
        self._real = os.pwrite, os.fsync, os.ftruncate
        for name in ("pwrite", "fsync", "ftruncate"):
            monkeypatch.setattr(os, name, getattr(self, f"_{name}"))

    def _pwrite(self, descriptor: int, data: bytes, offset: int) -> int:
        if self.left_bytes is None:
            return self._real[0](descriptor, data, offset)
        if self.left_bytes == 0:
            raise OSError(self.error, os.strerror(self.error))
        written = self._real[0](descriptor, data[: self.left_bytes], offset)
        self.left_bytes -= written
        return written

    def _fsync(self, descriptor: int) -> None:
        if self.syncs_fail:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        self._real[1](descriptor)

    def _ftruncate(self, descriptor: int, size: int) -> None:
        if self.cuts_fail:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        self._real[2](descriptor, size)


def test_a_commit_in_the_thread_does_not_wait_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the images from an SD card that takes a second: the journal is used meanwhile; its error is kept."""
    disk_is_done = threading.Event()
    real, errors = os.fsync, [errno.ENOSPC, 0]

    def fsync(descriptor: int) -> None:
        assert disk_is_done.wait(10.0)
        if errors and (error := errors.pop(0)):
            raise OSError(error, os.strerror(error))
        real(descriptor)

    with Journal.open(tmp_path, HEADER) as journal:
        monkeypatch.setattr(os, "fsync", fsync)
        journal.append(piece({(0, 0, 0): surface(1)}))
        syncing = [journal.is_syncing]
        journal.begin_commit()
        journal.append(piece({(1, 0, 0): surface(2)}))
        syncing.append(journal.is_syncing)
        disk_is_done.set()
        with pytest.raises(OSError, match="No space left"):
            journal.commit()
        assert [*syncing, journal.is_syncing] == [False, True, False]
        journal.begin_commit()
        journal.commit()
        assert errors == []
        assert all(segment.safe_end == segment.end for segment in journal._contents.segments.values())
    with Journal.read_only(tmp_path) as read:
        assert set(held(read)) == {(0, 0, 0), (1, 0, 0)}


@pytest.mark.parametrize("cuts_fail", [False, True])
@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EDQUOT, errno.EIO])
@pytest.mark.parametrize("left_bytes", [0, 1, 23, 24, 500, 1500])
def test_a_full_disk_costs_nothing_that_was_committed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, left_bytes: int, error: int, cuts_fail: bool
) -> None:
    """Protects the flight: the caller hears of it, all that was taken stays, and it goes on when there is room."""
    disk = BadDisk(monkeypatch)
    old = {(n, 0, 0): surface(n) for n in range(3)}
    new = {(n, 0, 0): surface(10 + n) for n in range(1, 5)}
    journal = Journal.open(tmp_path, HEADER)
    journal.append(piece(old))
    journal.commit()
    wanted = {chunk: values.tobytes() for chunk, values in old.items()}

    disk.left_bytes, disk.error, disk.cuts_fail = left_bytes, error, cuts_fail
    for _ in range(2):
        with pytest.raises(OSError, match=os.strerror(error)):
            journal.append(piece(new))
        assert held(journal) == wanted
    # As it would be found if the process were killed now: with whole records of the attempt at the most.
    ever = {chunk: {values.tobytes(), old.get(chunk, values).tobytes()} for chunk, values in {**old, **new}.items()}
    with Journal.read_only(tmp_path) as reader:
        found = held(reader)
        assert found.keys() >= wanted.keys()
        assert all(values in ever[chunk] for chunk, values in found.items())
        assert all(loss.torn for loss in reader.losses)

    disk.left_bytes, disk.cuts_fail = None, False
    journal.append(piece({(0, 0, 0): alike(1)}))
    journal.append(piece(new))
    journal.commit()
    wanted.update({chunk: values.tobytes() for chunk, values in {(0, 0, 0): alike(1), **new}.items()})
    assert held(journal) == wanted
    journal.close()
    with Journal.open(tmp_path) as journal:
        assert held(journal) == wanted


def test_a_full_disk_while_a_new_file_is_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the change from one file to the next: one that cannot be begun leaves nothing behind."""
    disk = BadDisk(monkeypatch)
    with Journal.open(tmp_path, HEADER, segment_bytes=1) as journal:
        wanted: Contents = {}
        for number in range(6):
            disk.left_bytes = 10
            with pytest.raises(OSError, match="No space"):
                journal.append(piece({(number, 0, 0): surface(number)}))
            assert held(journal) == wanted
            disk.left_bytes = None
            journal.append(piece({(number, 0, 0): surface(number)}))
            wanted[number, 0, 0] = surface(number).tobytes()
        # The first one was full with its header.
        assert len(list(tmp_path.glob("*.segment"))) == 7
        assert sum(path.stat().st_size for path in tmp_path.glob("*.segment")) == journal.bytes_on_disk
    with Journal.open(tmp_path) as journal:
        assert held(journal) == wanted
        assert journal.losses == ()


def test_opening_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects a start without room: a new journal says so, one that is there is read and can be flown with."""
    disk = BadDisk(monkeypatch)
    wanted = written(tmp_path / "old", [{(0, 0, 0): surface(1)}])
    disk.left_bytes = 0
    with pytest.raises(JournalError, match="No space left on device; make room"):
        Journal.open(tmp_path / "new", HEADER)
    with Journal.open(tmp_path / "old", HEADER) as journal:
        assert held(journal) == wanted


def test_after_a_failed_sync_everything_is_written_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from a system that forgets what it could not write: the next commit does not rely on those pages."""
    disk = BadDisk(monkeypatch)
    journal = Journal.open(tmp_path, HEADER)
    journal.append(piece({(0, 0, 0): surface(0)}))
    journal.commit()
    first = tmp_path / "00000001.segment"
    safe_bytes = first.stat().st_size
    journal.append(piece({(1, 0, 0): surface(1), (2, 0, 0): surface(2)}))
    disk.syncs_fail = True
    for _ in range(3):
        with pytest.raises(OSError, match="Input/output"):
            journal.commit()
        journal.append(piece({(2, 0, 0): surface(3)}))
    disk.syncs_fail = False
    journal.commit()
    wanted = {(0, 0, 0): surface(0), (1, 0, 0): surface(1), (2, 0, 0): surface(3)}
    assert held(journal) == {chunk: values.tobytes() for chunk, values in wanted.items()}
    journal.close()
    # The disk has nothing but zeros where the sync failed.
    for path in tmp_path.glob("*.segment"):
        if path != max(tmp_path.glob("*.segment")):
            data = path.read_bytes()
            path.write_bytes(data[:safe_bytes] + bytes(len(data) - safe_bytes))
    with Journal.open(tmp_path) as journal:
        assert held(journal) == {chunk: values.tobytes() for chunk, values in wanted.items()}


@contextmanager
def files_up_to(size_bytes: int) -> Iterator[None]:
    """The operating system itself refuses larger files, with EFBIG."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_real_limit_of_the_system(tmp_path: Path) -> None:
    """Protects from a difference between the injected errors above and what the kernel does: it writes a part first."""
    journal = Journal.open(tmp_path, HEADER)
    wanted: Contents = {}

    def fill() -> None:
        for number in range(1000):
            journal.append(piece({(number, 0, 0): surface(number)}))
            wanted[number, 0, 0] = surface(number).tobytes()

    with files_up_to(20_000), pytest.raises(OSError, match="File too large"):
        fill()
    assert len(wanted) > 3
    assert held(journal) == wanted
    journal.append(piece({(-1, 0, 0): surface(1)}))
    wanted[-1, 0, 0] = surface(1).tobytes()
    journal.close()
    with Journal.open(tmp_path) as journal:
        assert held(journal) == wanted
        assert journal.losses == ()


ROUND_AND_ON = [
    {**{(n, 0, 0): surface(100 * turn + n) for n in range(8)}, (100 + turn, 0, 0): surface(100 * turn + 50)}
    for turn in range(20)
]
"""Some chunks change all the time, and each time one is added that never changes again."""


@settings(max_examples=5)
@given(st.integers(0, 2**32 - 1))
def test_room_is_won_back(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    """Protects the disk of a long flight in one place: twice what is needed and one file, however often it changes."""
    random = np.random.default_rng(seed)
    segment_bytes = 20_000
    folder = tmp_path_factory.mktemp("map.journal")
    wanted: Contents = {}
    with Journal.open(folder, HEADER, segment_bytes=segment_bytes) as journal:
        for turn in range(60):
            step: dict[Chunk, np.ndarray] = {
                (int(n), 0, 0): surface(100 * turn + int(n)) for n in random.permutation(40)[: random.integers(1, 8)]
            }
            journal.append(piece(step))
            wanted.update({chunk: values.tobytes() for chunk, values in step.items()})
            while journal.compact_step(0.01):
                pass
            journal.commit()
            on_disk = sum(path.stat().st_size for path in folder.glob("*.segment"))
            assert on_disk == journal.bytes_on_disk
            assert on_disk <= 2 * journal.live_bytes + 2 * segment_bytes
        assert held(journal) == wanted
    with Journal.open(folder) as journal:
        assert held(journal) == wanted
        assert journal.losses == ()


def test_compaction_takes_no_longer_than_it_may(tmp_path: Path) -> None:
    """Protects the frames that wait: one step with no time does nothing, and says that there is something to do."""
    written(tmp_path, ROUND_AND_ON, segment_bytes=20_000)
    with Journal.open(tmp_path, HEADER, segment_bytes=20_000) as journal:
        before = journal.bytes_on_disk
        assert journal.compact_step(0.0)
        assert journal.bytes_on_disk == before
        assert not journal.compact_step(1e6)


def test_a_crash_at_any_point_of_compaction(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from compaction itself: at each call of the system the folder on the disk holds the whole map."""
    folder = tmp_path / "map.journal"
    wanted = written(folder, ROUND_AND_ON, segment_bytes=15_000)
    journal = Journal.open(folder, HEADER, segment_bytes=15_000)
    looks = 0

    def watched(name: str) -> Callable[..., object]:
        real = getattr(os, name)

        def call(*arguments: object) -> object:
            nonlocal looks
            with monkeypatch.context() as pause:
                pause.setattr(os, name, real)
                with Journal.read_only(folder) as reader:
                    assert held(reader) == wanted
            looks += 1
            return real(*arguments)

        return call

    for name in ("pwrite", "fsync", "unlink"):
        monkeypatch.setattr(os, name, watched(name))
    before = journal.bytes_on_disk
    while journal.compact_step(0.001):
        pass
    journal.commit()
    journal.close()
    assert journal.bytes_on_disk < before
    assert looks > 5
    with Journal.open(folder) as journal:
        assert held(journal) == wanted


def test_nothing_is_removed_before_its_copy_is_safe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects from a power cut during compaction: files go only after the disk has what was copied out of them."""
    wanted = written(tmp_path, ROUND_AND_ON, segment_bytes=20_000)
    disk = BadDisk(monkeypatch)
    with Journal.open(tmp_path, HEADER, segment_bytes=20_000) as journal:
        before = {path: path.read_bytes() for path in tmp_path.glob("*.segment")}
        assert not journal.compact_step(1e6)
        disk.syncs_fail = True
        with pytest.raises(OSError, match="Input/output"):
            journal.commit()
        assert all(path.read_bytes().startswith(data) for path, data in before.items())
        disk.syncs_fail = False
        journal.commit()
        assert len(before.keys() & set(tmp_path.glob("*.segment"))) < len(before)
        assert held(journal) == wanted


def test_a_whole_map_is_taken(tmp_path: Path) -> None:
    """Protects copies of maps: every chunk arrives, in place of what was there of it, and the count of them is told."""
    wanted = written(tmp_path / "from", [{(n, 0, 0): surface(n) for n in range(300)}])
    taken: list[int] = []
    with Journal.read_only(tmp_path / "from") as source, Journal.open(tmp_path / "to", HEADER) as journal:
        journal.append(piece({(5, 0, 0): alike(1), (-1, 0, 0): alike(2)}))
        journal.append_all(source, taken.append)
        assert held(journal) == {**wanted, (-1, 0, 0): alike(2).tobytes()}
    assert taken == [256, 300]
