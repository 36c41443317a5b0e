"""What a process has used of the computer."""

from __future__ import annotations

import time
from dataclasses import dataclass

import psutil


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
