"""What all benches share: options, a table, the figures in a JSON file, and what a process has used."""

from __future__ import annotations

import json
import time
from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import psutil

from companion import text_table


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


Row = dict[str, object]


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


def write(rows: Sequence[Row], json_file: Path) -> None:
    """Write all that the rows hold."""
    json_file.write_text(json.dumps(list(rows), indent=2) + "\n", encoding="utf-8")


def _text(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
