"""A journal that is given to the disk by a thread: however long an SD card takes for it, images do not wait."""

from __future__ import annotations

import os
from pathlib import Path

from companion.mapping.journal import Journal


class PatientJournal(Journal):
    """A journal whose commits can be left to another thread, which calls `sync_files`.

    What was appended survives the death of the process at once; the power may fail once it is committed.

    Attributes:
        patient: whether `commit` leaves the disk alone for now.
    """

    patient = False

    def commit(self) -> None:
        """As `Journal.commit`, unless it is patient."""
        if not self.patient:
            super().commit()


def sync_files(folder: Path, since_ns: int) -> None:
    """Give all files of a folder that changed after ``since_ns`` to the disk; for any thread.

    A commit that follows finds little left to do. It is not replaced: it is the commit that knows what is safe.

    Raises:
        OSError: the disk is full or broken.
    """
    changed = [path for path in folder.iterdir() if path.stat().st_mtime_ns >= since_ns]
    for path in (*changed, folder):
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
