"""The journal itself."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from companion.mapping.journal.coding import decode
from companion.mapping.journal.contents import Contents, place_of_record
from companion.mapping.journal.header import Header, JournalError, prologue
from companion.mapping.journal.recovery import lock, recover, refuse_foreign, segment_paths
from companion.mapping.journal.segment import FRONT_BYTES, Loss, Segment, packed, record_at, sync_folder
from companion.mapping.voxels.chunks import VOLUME, chunk_key, chunks_of, keys_of
from companion.mapping.voxels.piece import MOST_CHUNKS, MapPiece, MapSource, Progress, silent

SEGMENT_BYTES = 16 << 20
"""A file that has grown to this is followed by another."""

_BATCH = 256
"""Chunks that are encoded at once: 2 MiB of room at the worst."""

_COPIED_AT_ONCE = 32


class Journal:
    """A map on the disk; a `MapSource`, and a context manager. For one thread at a time. Made by `open` or `read_only`.

    `append` and `commit` raise OSError when the disk is full or broken. The journal stays usable: what was committed
    stays, what could not be appended is as if it had not been tried, and once there is room everything goes on.

    Args:
        folder: where it is.
        header: what the map is.
        contents: what it holds.
        losses: what could not be read.
        lock_descriptor: of the writer's lock; None: only reads.
        segment_bytes: a file that has grown to this is followed by another.
    """

    def __init__(
        self,
        folder: Path,
        header: Header,
        contents: Contents,
        losses: list[Loss],
        lock_descriptor: int | None,
        segment_bytes: int = SEGMENT_BYTES,
    ) -> None:
        self.folder = folder
        self.header = header
        self._contents = contents
        self._losses = losses
        self._lock = lock_descriptor
        self._segment_bytes = segment_bytes
        self._front = prologue(header)
        self._new_files = True
        self._thread = ThreadPoolExecutor(1, "journal")
        self._sync: Future[None] | None = None
        self._closed = False

    @classmethod
    def open(
        cls,
        folder: Path,
        header: Header | None = None,
        *,
        progress: Progress = silent,
        segment_bytes: int = SEGMENT_BYTES,
    ) -> Self:
        """Make a journal, or continue the one that is there.

        Args:
            folder: of the journal; made when it is missing.
            header: what the map is; None: whatever is there.
            progress: takes the share of the reading that is done, from 0 to 1.
            segment_bytes: a file that has grown to this is followed by another.

        Raises:
            JournalError: it is of another map or written by a newer version; no journal, though the folder is not
                empty; another process writes it; the disk is full or refuses.
        """
        try:
            if header is not None:
                folder.mkdir(parents=True, exist_ok=True)
            elif not folder.is_dir() or not segment_paths(folder):
                raise _no_journal(folder)
            held = lock(folder)
        except OSError as error:
            raise _refused(folder, error) from error
        try:
            found = recover(folder, writes=True, progress=progress)
            if not found.contents.segments:
                refuse_foreign(folder)
            elif header is not None and found.header is not None and (wrong := header.differences(found.header)):
                raise JournalError(
                    f"{folder}: holds another map: {', '.join(wrong)}; give another folder, or settings like its own"
                )
            made = header or found.header
            if made is None:
                raise _no_journal(folder)
            journal = cls(folder, made, found.contents, found.losses, held, segment_bytes)
            if not found.contents.segments:
                journal._active()
                journal.commit()
        except OSError as error:
            os.close(held)
            raise _refused(folder, error) from error
        except BaseException:
            os.close(held)
            raise
        return journal

    @classmethod
    def read_only(cls, folder: Path, *, progress: Progress = silent) -> Self:
        """What a journal holds now. Writes nothing and waits for nobody, though another process may be writing.

        Raises:
            JournalError: no journal, written by a newer version, or it cannot be opened.
        """
        try:
            if not folder.is_dir() or not segment_paths(folder):
                raise _no_journal(folder)
            found = recover(folder, writes=False, progress=progress)
        except OSError as error:
            raise _refused(folder, error) from error
        if found.header is None:
            raise _no_journal(folder)
        return cls(folder, found.header, found.contents, found.losses, None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    @property
    def voxel_m(self) -> float:
        """Edge of a voxel."""
        return self.header.voxel_m

    @property
    def threshold(self) -> int:
        """A voxel is occupied from this value on, in thousandths of log-odds."""
        return self.header.threshold

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What could not be read, so far."""
        return tuple(self._losses)

    @property
    def chunks(self) -> NDArray[np.int32]:
        """(n, 3) all chunks that it holds."""
        return chunks_of(self._contents.keys())

    @property
    def bytes_on_disk(self) -> int:
        """Size of its files."""
        return sum(segment.end for segment in self._contents.segments.values())

    @property
    def live_bytes(self) -> int:
        """Size of the newest records, without which nothing would be lost."""
        return self._contents.live_bytes

    @property
    def memory_bytes(self) -> int:
        """What the index takes."""
        return self._contents.memory_bytes

    def append(self, piece: MapPiece) -> None:
        """Take chunks as they are, in place of what it had of them. They survive the end of this process from now on.

        Raises:
            OSError: the disk is full or broken. Those chunks that were not taken are as before.
        """
        for first in range(0, len(piece.chunks), _BATCH):
            chunks = piece.chunks[first : first + _BATCH]
            data, sizes = packed(chunks, piece.values[first : first + _BATCH])
            self._write(keys_of(chunks), data, sizes)

    def append_records(self, records: Sequence[bytes]) -> NDArray[np.int64]:
        """Take chunks as records of another journal, byte for byte: (n,) their keys. They survive as of `append`.

        Args:
            records: as `JournalFollower.records` gives them; of a chunk that occurs twice the last one counts.

        Raises:
            ValueError: one of them is no whole record of a chunk; nothing was taken.
            OSError: the disk is full or broken; nothing was taken.
        """
        keys = np.empty(len(records), np.int64)
        for number, data in enumerate(records):
            record = record_at(data, 0)
            if record is None or record.size_bytes != len(data):
                raise ValueError("what came is no whole record of a journal")
            keys[number] = chunk_key.py_func(*record.chunk)
        if len(records):
            self._write(keys, b"".join(records), np.array([len(data) for data in records], np.int64))
        return keys

    def append_all(self, source: MapSource, taken: Callable[[int], None] = lambda _: None) -> None:
        """Take a whole map, piece by piece, so that it need not fit into memory.

        Args:
            source: the map; what it has of a chunk stands in place of what the journal had.
            taken: is given how many chunks were taken so far.

        Raises:
            OSError: the disk is full or broken, or the source cannot be read. What was taken before stays.
        """
        chunks = 0
        for piece in source.pieces(_BATCH):
            self.append(piece)
            chunks += len(piece.chunks)
            taken(chunks)

    def commit(self) -> None:
        """Make everything that was appended survive a power cut.

        Raises:
            OSError: the disk is full or broken. What was appended since the last commit is not safe yet; it is still
                there, and the next commit tries again.
        """
        if self._lock is None:
            raise _reads_only(self.folder)
        self._wait_for_sync()
        self._rewrite_doubtful()
        segments = self._contents.segments
        self._sync_files(list(segments.values()))
        newest = max(segments, default=0)
        for segment in [one for one in segments.values() if one.live_bytes == 0 and not one.damaged]:
            if segment.number != newest:
                del segments[segment.number]
                segment.remove()

    def begin_commit(self) -> None:
        """Have a thread give the disk what was appended so far: however long an SD card takes, images do not wait.

        The journal may be used meanwhile. The `commit` that has to follow finds little left to do once `is_syncing` is
        false, and raises what the disk had against it.

        Raises:
            OSError: of the last one that nobody asked for; or the disk takes nothing.
        """
        self._wait_for_sync()
        self._rewrite_doubtful()
        self._sync = self._thread.submit(self._sync_files, list(self._contents.segments.values()))

    @property
    def is_syncing(self) -> bool:
        """Whether the thread of `begin_commit` is still at work."""
        return self._sync is not None and not self._sync.done()

    def read(self, chunks: NDArray[np.int32]) -> MapPiece:
        """Those among ``chunks`` (n, 3) that it has, in any order. One that is damaged is a loss, and not given."""
        keys, places, sizes = self._contents.find(keys_of(chunks))
        parts: list[bytes] = []
        for key, place, size in zip(keys.tolist(), places.tolist(), sizes.tolist(), strict=True):
            parts.append((self._record(key, place, size) or b"")[FRONT_BYTES:])
        starts = np.cumsum([0, *(len(part) for part in parts)], dtype=np.int64)
        values = np.empty((len(parts), VOLUME), np.int16)
        valid = decode(np.frombuffer(bytearray().join(parts), np.uint8), starts, values)
        for number in np.flatnonzero(~valid).tolist():
            self._lose(*(int(column[number]) for column in (keys, places, sizes)))
        return MapPiece(chunks_of(keys[valid]), values[valid])

    def pieces(self, most_chunks: int = MOST_CHUNKS) -> Iterator[MapPiece]:
        """Every chunk once, ``most_chunks`` at a time."""
        everything = self.chunks
        for first in range(0, len(everything), most_chunks):
            yield self.read(everything[first : first + most_chunks])

    def compact_step(self, budget_s: float) -> bool:
        """Copy what is still needed out of files that are mostly superseded; the next `commit` removes these.

        The disk then holds no more than about twice the newest records and one file, if this is called as often as
        `commit` and has time for what was appended in between.

        Args:
            budget_s: ends after this time, and the few ms that one batch takes.

        Returns:
            Whether there is more to do.

        Raises:
            OSError: the disk is full or broken; nothing is lost.
        """
        end_s = time.monotonic() + budget_s
        while (worst := self._contents.most_wasteful(self._segment_bytes)) is not None:
            if time.monotonic() >= end_s:
                return True
            self._copy(self._contents.keys_in(worst)[:_COPIED_AT_ONCE])
        return False

    def close(self) -> None:
        """Commit, if it writes, and let go of the files and the lock. Once is enough.

        Raises:
            OSError: the last commit failed; everything is closed all the same.
        """
        if self._closed:
            return
        self._closed = True
        try:
            if self._lock is not None:
                self.commit()
        finally:
            self._thread.shutdown()
            for segment in self._contents.segments.values():
                segment.close()
            if self._lock is not None:
                os.close(self._lock)

    def _active(self) -> Segment:
        """The segment to which is written."""
        if self._lock is None:
            raise _reads_only(self.folder)
        segments = self._contents.segments
        newest = max(segments, default=0)
        if newest and not segments[newest].full and segments[newest].end < self._segment_bytes:
            return segments[newest]
        made = Segment.create(self.folder, newest + 1, self._front)
        self._new_files = True
        segments[made.number] = made
        return made

    def _wait_for_sync(self) -> None:
        sync, self._sync = self._sync, None
        if sync is not None:
            sync.result()

    def _rewrite_doubtful(self) -> None:
        """Write once more what a failed sync left in doubt: the system may have thrown it away."""
        for segment in [one for one in self._contents.segments.values() if one.in_doubt]:
            self._copy(self._contents.keys_in(segment, segment.safe_end))
            segment.in_doubt = False

    def _sync_files(self, segments: list[Segment]) -> None:
        """Give what was written to the disk; also in the thread, while more is appended."""
        for segment in segments:
            segment.sync()
        # Files that are made from here on ask for it again.
        if self._new_files:
            self._new_files = False
            try:
                sync_folder(self.folder)
            except OSError:
                self._new_files = True
                raise

    def _write(self, keys: NDArray[np.int64], data: bytes, sizes: NDArray[np.int64]) -> None:
        segment = self._active()
        places = place_of_record(segment, segment.end) + np.cumsum(sizes) - sizes
        segment.write(data)
        self._contents.point(keys, places, sizes)

    def _copy(self, keys: NDArray[np.int64]) -> None:
        """Write the newest records of some chunks once more."""
        for first in range(0, len(keys), _COPIED_AT_ONCE):
            found, places, sizes = self._contents.find(keys[first : first + _COPIED_AT_ONCE])
            copied: list[tuple[int, bytes]] = []
            for key, place, size in zip(found.tolist(), places.tolist(), sizes.tolist(), strict=True):
                data = self._record(key, place, size)
                if data is None:
                    self._lose(key, place, size)
                else:
                    copied.append((key, data))
            kept = np.array([key for key, _ in copied], np.int64)
            lengths = np.array([len(data) for _, data in copied], np.int64)
            self._write(kept, b"".join(data for _, data in copied), lengths)

    def _record(self, key: int, place: int, size: int) -> bytes | None:
        """The bytes of a record, None when it is damaged: then the caller loses it."""
        segment, offset = self._contents.segment_of(place)
        data = segment.read(offset, size)
        record = record_at(data, 0)
        if record is not None and record.size_bytes == size and chunk_key.py_func(*record.chunk) == key:
            return data
        return None

    def _lose(self, key: int, place: int, size: int) -> None:
        """There is no newest record of a chunk any more, as it cannot be read."""
        segment, offset = self._contents.segment_of(place)
        segment.damaged = True
        self._losses.append(Loss(segment.path, offset, size, torn=False))
        self._contents.forget(key)


def _reads_only(folder: Path) -> ValueError:
    return ValueError(f"{folder}: the journal was opened for reading only")


def _no_journal(folder: Path) -> JournalError:
    return JournalError(f"{folder}: no map journal is here; check the path")


def _refused(folder: Path, error: OSError) -> JournalError:
    return JournalError(
        f"{folder}: cannot open the map journal: {error.strerror or error}; make room or check the path"
    )
