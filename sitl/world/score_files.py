"""The two files that a flight in a simulator leaves: the score and the true trajectory."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from companion.errors import InputError
from companion.mapping.files.whole import whole_file
from sitl.world.contact_monitor import Look

COLUMNS = ("t_s", "x_m", "y_m", "z_m", "yaw_rad", "vx_mps", "vy_mps", "vz_mps", "d_m", "touching")
MOST_ROWS = 2_000_000
"""More than a day at 20 looks a second; a process that is forgotten must not fill the disk."""


def write_score(path: Path, score: dict[str, object]) -> None:
    """Writes the score as JSON; a reader sees the old one or the new one, never half of it.

    Raises:
        InputError: it cannot be written.
    """
    try:
        with whole_file(path) as file:
            file.write((json.dumps(score, indent=2, allow_nan=False) + "\n").encode())
    except OSError as error:
        raise InputError(f"--score {path}: {error.strerror or error}") from error


class Trajectory:
    """The true trajectory as CSV, a row for each look.

    Args:
        path: of the file, or None for none.

    Raises:
        InputError: it cannot be written.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._rows = 0
        self._file: IO[str] | None = None
        self._writer: Any = None

    def __enter__(self) -> Self:
        if self._path is not None:
            try:
                self._file = self._path.open("w", newline="", encoding="ascii")
            except OSError as error:
                raise InputError(f"--trajectory {self._path}: {error.strerror or error}") from error
            self._writer = csv.writer(self._file)
            self._writer.writerow(COLUMNS)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()
            self._file = self._writer = None

    def add(self, look: Look) -> None:
        """Adds a row: times as `time.monotonic`, places in the mine, d empty while not flying."""
        if self._writer is None or self._rows >= MOST_ROWS:
            return
        self._rows += 1
        pose = look.pose
        numbers = (pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad, pose.vx_mps, pose.vy_mps, pose.vz_mps)
        d_m = "" if look.d_m is None else f"{look.d_m:.3f}"
        self._writer.writerow([f"{pose.t_s:.4f}", *(f"{x:.4f}" for x in numbers), d_m, int(look.touching)])

    def flush(self) -> None:
        """Hands everything to the operating system, for whoever reads along."""
        if self._file is not None:
            self._file.flush()
