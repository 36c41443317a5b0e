"""Opening what is there: one writer at a time, every record of every segment read, and what a crash left cut off."""

from __future__ import annotations

import errno
import fcntl
import os
import re
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from companion.mapping.journal.contents import Contents, place_of_record
from companion.mapping.journal.header import Header, JournalError, is_unfinished, read_prologue
from companion.mapping.journal.segment import SUFFIX, Loss, Record, Segment, records
from companion.mapping.voxels.chunks import keys_of
from companion.mapping.voxels.piece import Progress, silent

LOCK_NAME = "lock"

_ATTEMPTS = 100
_SEGMENT_NAME = re.compile(r"[0-9]*[1-9][0-9]*" + re.escape(SUFFIX))


def lock(folder: Path) -> int:
    """Be the only writer of a folder until the returned descriptor is closed, or the process ends however it does.

    Raises:
        JournalError: another process is.
        OSError: the file cannot be made or locked.
    """
    path = folder / LOCK_NAME
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        owner = os.pread(descriptor, 20, 0).decode("ascii", "replace").strip()
        os.close(descriptor)
        if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
            raise JournalError(
                f"{folder}: process {owner or '?'} is writing it; end that one, or give another folder"
            ) from None
        raise
    # The number is only for the message above: a full disk must not keep anyone from the map.
    with suppress(OSError):
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
    return descriptor


@dataclass(slots=True)
class Found:
    """What a folder holds.

    Attributes:
        header: of the newest segment that has a readable one; None: there is no segment.
        contents: segments and chunks.
        losses: what could not be read.
    """

    header: Header | None = None
    contents: Contents = field(default_factory=Contents)
    losses: list[Loss] = field(default_factory=list)


def segment_paths(folder: Path) -> list[Path]:
    """The segments in a folder, oldest first."""
    paths = [path for path in folder.iterdir() if _SEGMENT_NAME.fullmatch(path.name)]
    return sorted(paths, key=lambda path: int(path.stem))


def refuse_foreign(folder: Path) -> None:
    """Raise when a folder without segments holds anything else.

    Raises:
        JournalError: it does; one of them is named.
    """
    others = sorted(path.name for path in folder.iterdir() if path.name != LOCK_NAME)
    if others:
        raise JournalError(f"{folder}: no map journal, but it holds {others[0]!r}; give an empty or a new folder")


def recover(folder: Path, *, writes: bool, progress: Progress = silent) -> Found:
    """Read all segments of a folder.

    Args:
        folder: of the journal.
        writes: cut torn ends off; the caller holds the lock.
        progress: takes the share of the work that is done, from 0 to 1.

    Raises:
        JournalError: the segments are of different maps, of a newer version, or no header can be read.
        OSError: the folder or a file cannot be opened.
    """
    found = Found()
    opened = _open_all(folder, os.O_RDWR if writes else os.O_RDONLY)
    try:
        for number, segment in enumerate(opened):
            progress(number / len(opened))
            _read_segment(segment, found, writes=writes)
        if found.contents.segments and found.header is None:
            raise JournalError(f"{folder}: no file has a readable header, so nobody knows the size of its voxels")
    except BaseException:
        _close_all(opened)
        raise
    progress(1.0)
    return found


def _open_all(folder: Path, flags: int) -> list[Segment]:
    """All segments as they stood together at one moment: a writer may be removing files just now."""
    for _ in range(_ATTEMPTS):
        opened: list[Segment] = []
        try:
            paths = segment_paths(folder)
            for path in paths:
                descriptor = os.open(path, flags | os.O_CLOEXEC)
                opened.append(Segment(path, descriptor, 0, os.fstat(descriptor).st_size))
            if segment_paths(folder) == paths:
                return opened
        except FileNotFoundError:
            pass
        except BaseException:
            _close_all(opened)
            raise
        _close_all(opened)
    raise JournalError(f"{folder}: its files change faster than they can be opened; try again")


def _close_all(opened: list[Segment]) -> None:
    for segment in opened:
        segment.close()


def _read_segment(segment: Segment, found: Found, *, writes: bool) -> None:
    data = segment.read_all()
    header, segment.begin = read_prologue(data, segment.path)
    losses: list[Loss] = []
    whole = list(records(data, segment.begin, segment.path, losses.append))
    if not whole and is_unfinished(data, segment.begin):
        # It was being made when the process or the power went.
        found.losses.append(Loss(segment.path, 0, len(data), torn=True))
        segment.close()
        if writes:
            segment.path.unlink()
        return
    if header is not None:
        if found.header is not None and (wrong := found.header.differences(header)):
            raise JournalError(f"{segment.path}: of another map than the files before it: {', '.join(wrong)}")
        found.header = header
    found.contents.segments[segment.number] = segment
    _point(segment, whole, found.contents)
    for loss in losses:
        if loss.torn and writes:
            segment.cut(loss)
        segment.full |= not loss.torn
        segment.damaged |= not loss.torn
        segment.end = loss.offset if loss.torn else segment.end
    found.losses += losses


def _point(segment: Segment, whole: list[Record], contents: Contents) -> None:
    keys = keys_of(np.array([record.chunk for record in whole], np.int32).reshape(-1, 3))
    offsets = np.array([record.offset for record in whole], np.int64)
    sizes = np.array([record.size_bytes for record in whole], np.int64)
    contents.point(keys, place_of_record(segment, 0) | offsets, sizes)
