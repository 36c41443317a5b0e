"""How much processor time and memory this process and its children take, from /proc."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

_PROC = Path("/proc")
MOST_PROCESSES = 64


@dataclass(frozen=True, slots=True)
class Load:
    """What was used since the last sample, and what is held now.

    Attributes:
        cpu_share: processor time over time: 1 is one core; of this process.
        children_cpu_share: of all processes that it started, and theirs.
        memory_mb: resident memory of this process.
        children_memory_mb: of its children; what they share is counted in each.
    """

    cpu_share: float
    children_cpu_share: float
    memory_mb: float
    children_memory_mb: float


class LoadMeter:
    """Call `sample` about once a second."""

    def __init__(self) -> None:
        self._last_s: float | None = None
        self._cpu_s: dict[int, float] = {}
        if _PROC.joinpath("self/stat").exists():
            self._ticks_per_s = os.sysconf("SC_CLK_TCK")
            self._page_bytes = os.sysconf("SC_PAGE_SIZE")

    def sample(self, t_s: float) -> Load | None:
        """The load since the last call; ``None`` at the first one, and where there is no /proc."""
        own = os.getpid()
        used = {pid: found for pid in _family(own) if (found := self._usage(pid)) is not None}
        cpu_s = {pid: seconds for pid, (seconds, _) in used.items()}
        before, self._cpu_s = self._cpu_s, cpu_s
        last_s, self._last_s = self._last_s, t_s
        if last_s is None or t_s <= last_s or own not in used or own not in before:
            return None
        # A process that was not there a second ago has used all of its time since.
        share = {pid: (seconds - before.get(pid, 0.0)) / (t_s - last_s) for pid, seconds in cpu_s.items()}
        return Load(
            cpu_share=share[own],
            children_cpu_share=sum(value for pid, value in share.items() if pid != own),
            memory_mb=used[own][1],
            children_memory_mb=sum(megabytes for pid, (_, megabytes) in used.items() if pid != own),
        )

    def _usage(self, pid: int) -> tuple[float, float] | None:
        """Processor time in s and resident memory in MB; ``None`` when the process has ended."""
        try:
            # The name in brackets may hold spaces and brackets itself.
            fields = _PROC.joinpath(str(pid), "stat").read_text().rpartition(")")[2].split()
            return (int(fields[11]) + int(fields[12])) / self._ticks_per_s, int(fields[21]) * self._page_bytes / 1e6
        except (OSError, ValueError, IndexError):
            return None


def _family(pid: int) -> list[int]:
    """The process and those that it started, and so on."""
    family = [pid]
    for member in family:
        try:
            for task in _PROC.joinpath(str(member), "task").iterdir():
                family.extend(int(child) for child in task.joinpath("children").read_text().split())
        except (OSError, ValueError):
            continue  # it, or one of its threads, has ended meanwhile
        if len(family) >= MOST_PROCESSES:
            break
    return family[:MOST_PROCESSES]
