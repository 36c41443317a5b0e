"""How much processor time and memory this process and its children take."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import psutil


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
        self._own = psutil.Process()
        self._last_s: float | None = None
        self._cpu_s: dict[psutil.Process, float] = {}

    def sample(self, t_s: float) -> Load | None:
        """The load since the last call; ``None`` at the first one."""
        used = dict(self._usage())
        before, self._cpu_s = self._cpu_s, {process: cpu_s for process, (cpu_s, _) in used.items()}
        last_s, self._last_s = self._last_s, t_s
        if last_s is None or t_s <= last_s:
            return None
        # A process that was not there a second ago has used all of its time since.
        share = {process: (cpu_s - before.get(process, 0.0)) / (t_s - last_s) for process, cpu_s in self._cpu_s.items()}
        memory_mb = {process: megabytes for process, (_, megabytes) in used.items()}
        own_share, own_mb = share.pop(self._own), memory_mb.pop(self._own)
        return Load(own_share, sum(share.values()), own_mb, sum(memory_mb.values()))

    def _usage(self) -> Iterator[tuple[psutil.Process, tuple[float, float]]]:
        """Processor time in s and resident memory in MB of this process and all that came of it."""
        for process in (self._own, *self._own.children(recursive=True)):
            try:
                with process.oneshot():
                    cpu = process.cpu_times()
                    yield process, (cpu.user + cpu.system, process.memory_info().rss / 1e6)
            except psutil.Error:
                continue  # it has ended meanwhile
