"""A folder of its own for each flight, also where its name is taken."""

from __future__ import annotations

import itertools
from pathlib import Path


def free_names(wanted: Path) -> itertools.chain[Path]:
    """The name that is wanted, and what to try where it is taken: with -2, -3 and so on behind it."""
    return itertools.chain([wanted], (wanted.with_name(f"{wanted.name}-{number}") for number in itertools.count(2)))


def make_folder(wanted: Path) -> Path:
    """Make a new folder, and those above it; where one of that name is there already, one with a number behind it.

    A computer without a battery for its clock, or with one that was set back, names two flights by the same second.

    Raises:
        OSError: it cannot be made.
    """
    wanted.parent.mkdir(parents=True, exist_ok=True)
    for folder in free_names(wanted):
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise AssertionError("numbers do not end")
