"""What all benches share: options, a table, the figures in a JSON file, and what a process has used."""

from __future__ import annotations

import json
import sys
import time
from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
from numpy.typing import NDArray

from companion import text_table
from companion.config.settings import Settings
from companion.mapping.files.whole import whole_file

Row = dict[str, object]


@dataclass(frozen=True, slots=True)
class Usage:
    """What a process has used so far: seconds of a core, and MB of memory now."""

    t_s: float
    cpu_s: float
    rss_mb: float

    @classmethod
    def of(cls, pid: int) -> Usage:
        """As the kernel counts."""
        process = psutil.Process(pid)
        cpu = process.cpu_times()
        return cls(time.monotonic(), cpu.user + cpu.system, process.memory_info().rss / 1e6)


def parser(description: str | None) -> ArgumentParser:
    """A parser with the option that every bench has."""
    made = ArgumentParser(description=(description or "").partition("\n")[0])
    made.add_argument("--json", type=Path, metavar="FILE", help="write the figures of every row into this file too")
    return made


def show(rows: Sequence[Row], columns: Sequence[str], json_file: Path | None = None) -> None:
    """Print the named columns of the rows, and write all that the rows hold."""
    cells = [[_text(row.get(column)) for column in columns] for row in rows]
    print("\n".join(text_table.columns([columns, *cells], left=())))
    if json_file is not None:
        write(rows, json_file)


def camera_rate(text: str) -> tuple[int, int, float]:
    """The width and height in px and the rate in Hz that an option says: ``WxH@HZ``."""
    size, _, rate = text.partition("@")
    width, _, height = size.partition("x")
    return int(width), int(height), float(rate)


def with_camera(settings: Settings, **camera: float) -> Settings:
    """The same settings, but for these of the camera."""
    changed = settings.sensors.camera.model_copy(update=camera)
    return settings.model_copy(update={"sensors": settings.sensors.model_copy(update={"camera": changed})})


def quantiles(name: str, values_ms: Sequence[float] | NDArray[np.float64]) -> Row:
    """The median and the 99th percentile, under the names of their columns."""
    return {f"{name} p{share}, ms": float(np.percentile(values_ms, share)) for share in (50, 99)}


def say(text: str) -> None:
    """Tell whoever waits how far it is."""
    print(text, file=sys.stderr, flush=True)


def write(rows: Sequence[Row], json_file: Path) -> None:
    """Write all that the rows hold, whole or not at all: an earlier measurement may be there."""
    with whole_file(json_file) as file:
        file.write((json.dumps(list(rows), indent=2) + "\n").encode())


def _text(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
