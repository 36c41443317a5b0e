"""The journal of the map: what has been mapped, on the disk, whatever happens to the process or the power.

It is a log: chunks are appended to segment files, and the newest record of a chunk is the one that counts. Nothing is
ever overwritten, so a crash can only tear the end of the log, and opening cuts that off. `Journal` is one writer's, or
a reader's view of the moment when it was opened. A journal that is damaged gives back all that is not.
"""

from __future__ import annotations

from companion.mapping.journal.following import JournalFollower
from companion.mapping.journal.header import Header, JournalError
from companion.mapping.journal.segment import Loss
from companion.mapping.journal.store import Journal

JOURNAL_SUFFIX = ".journal"
JOURNAL_NAME = f"map{JOURNAL_SUFFIX}"
"""Where a mission's folder keeps its map."""

__all__ = ["JOURNAL_NAME", "JOURNAL_SUFFIX", "Header", "Journal", "JournalError", "JournalFollower", "Loss"]
