"""A journal that a command has written beside its place, and the place where it goes."""

from __future__ import annotations

import os
from pathlib import Path

from companion.errors import InputError
from companion.mapping.files.whole import exchange
from companion.mapping.journal import JOURNAL_SUFFIX, Journal, JournalError
from companion.mapping.journal.recovery import lock


def refuse_no_journal(out: Path) -> None:
    """Refuse to replace a folder of something else, whatever its name.

    Raises:
        InputError: it is one.
    """
    if not out.exists() or out.suffix.lower() != JOURNAL_SUFFIX:
        return
    try:
        Journal.read_only(out).close()
    except JournalError:
        raise InputError(f"{out}: is there and holds no map; --overwrite replaces maps only") from None


def put_in_place(folder: Path, out: Path) -> None:
    """Move a journal that is whole to where it goes; the one that is there is replaced at once, or stays.

    Raises:
        OSError: it cannot be moved; what was there before still is.
    """
    if not out.exists():
        folder.replace(out)
        return
    held = lock(out)
    try:
        exchange(folder, out)
    finally:
        os.close(held)
