"""The missions that a campaign has flown, on the disk: one line each, written before anybody is told of it.

A command that is killed leaves at most one line that is cut off; whoever opens the file next takes it away. What is
there is whole, and no two commands write it at once.
"""

from __future__ import annotations

import fcntl
import json
import os
from pathlib import Path
from typing import IO, Self

from companion.errors import CompanionError, InputError
from companion.mapping.journal.segment import sync_folder
from sitl.campaign.mission import Row

NAME = "missions.jsonl"


class LedgerError(CompanionError):
    """The missions that were flown could not be written."""


class Ledger:
    """Rows by the number of their mission. A context manager.

    Args:
        folder: the campaign's; the file is made in it where it is missing.
        name: of the file.

    Raises:
        InputError: another command has it open, it cannot be opened, or it is damaged.
    """

    def __init__(self, folder: Path, name: str = NAME) -> None:
        self.rows: dict[int, Row] = {}
        self.path = folder / name
        try:
            self._file = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise InputError(f"{self.path}: {error.strerror}; give a folder that you may write") from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._end = self._read()
            os.ftruncate(self._file, self._end)
            sync_folder(folder)
        except BlockingIOError:
            os.close(self._file)
            raise InputError(f"{folder}: another command is flying this campaign; wait for it, or end it") from None
        except BaseException:
            os.close(self._file)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._file)

    def append(self, row: Row) -> None:
        """Keep the row of a mission; when this returns it is on the disk. A row of the same mission is replaced.

        Raises:
            LedgerError: the disk is full, or gone; what was there before still is.
        """
        line = json.dumps(row, allow_nan=False).encode() + b"\n"
        try:
            written = 0
            while written < len(line):
                written += os.pwrite(self._file, line[written:], self._end + written)
            os.fsync(self._file)
        except OSError as error:
            os.ftruncate(self._file, self._end)
            raise LedgerError(
                f"{self.path}: {error.strerror}; make room, and start the same command again: it goes on from here"
            ) from None
        self._end += len(line)
        self.rows[int(str(row["mission"]))] = row

    def _read(self) -> int:
        """Read what is there; return where the last whole line ends."""
        with os.fdopen(os.dup(self._file), "rb") as file:
            self.rows, end = _whole_rows(file, self.path)
        return end


def read(folder: Path, name: str) -> dict[int, Row]:
    """The rows of a file that nobody has open, by the number of their mission; none where it is missing.

    Raises:
        InputError: it is damaged.
    """
    try:
        with (folder / name).open("rb") as file:
            return _whole_rows(file, folder / name)[0]
    except FileNotFoundError:
        return {}


def _whole_rows(file: IO[bytes], path: Path) -> tuple[dict[int, Row], int]:
    """The rows of all whole lines, and where the last of these ends."""
    rows: dict[int, Row] = {}
    end = 0
    for number, line in enumerate(file, start=1):
        if not line.endswith(b"\n"):
            break  # its writer was killed; the mission is flown again
        try:
            row = json.loads(line)
            rows[int(row["mission"])] = row
        except (ValueError, KeyError, TypeError):
            raise InputError(f"{path}:{number}: damaged; delete this line, and its mission is flown again") from None
        end += len(line)
    return rows, end
