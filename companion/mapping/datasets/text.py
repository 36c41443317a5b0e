"""Text files of data sets: reading them, and saying which line is wrong."""

from __future__ import annotations

from pathlib import Path

from companion.errors import InputError

_MOST_SHOWN = 80


def text_of(path: Path, wanted: str) -> str:
    """What a file holds.

    Args:
        path: the file.
        wanted: what such a data set has, for whoever gave a folder of something else.

    Raises:
        InputError: it is missing or cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8-sig", errors="replace")
    except FileNotFoundError:
        raise InputError(f"{path}: is not there; {wanted}. Is --from its folder, and --format right?") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def refused(path: Path, number: int, line: str, expected: str) -> InputError:
    """The error for a line that cannot be."""
    shown = line.strip()[:_MOST_SHOWN]
    return InputError(f"{path}:{number}: {shown!r}, expected {expected}; correct the line, or get the data set again")
