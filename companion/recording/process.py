"""How much processor time and memory this process and its children take."""

from __future__ import annotations

from collections.abc import Iterator

import psutil


class LoadMeter:
    """Call `sample` about once a second."""

    def __init__(self) -> None:
        self._own = psutil.Process()
        self._last_s: float | None = None
        self._cpu_s: dict[psutil.Process, float] = {}

    def sample(self, t_s: float) -> dict[str, float]:
        """What was used since the last call and what is held now, by name; empty at the first call.

        ``cpu_share`` is processor time over time of this process, 1 is one core; ``children_cpu_share`` that of all
        processes that it started, and theirs; ``memory_mb`` and ``children_memory_mb`` their resident memory, of which
        what is shared is counted in each.
        """
        used = dict(self._usage())
        before, self._cpu_s = self._cpu_s, {process: cpu_s for process, (cpu_s, _) in used.items()}
        last_s, self._last_s = self._last_s, t_s
        if last_s is None or t_s <= last_s:
            return {}
        # A process that was not there a second ago has used all of its time since.
        share = {process: (cpu_s - before.get(process, 0.0)) / (t_s - last_s) for process, cpu_s in self._cpu_s.items()}
        memory_mb = {process: megabytes for process, (_, megabytes) in used.items()}
        own_share, own_mb = share.pop(self._own), memory_mb.pop(self._own)
        return {
            "cpu_share": own_share,
            "children_cpu_share": sum(share.values()),
            "memory_mb": own_mb,
            "children_memory_mb": sum(memory_mb.values()),
        }

    def _usage(self) -> Iterator[tuple[psutil.Process, tuple[float, float]]]:
        """Processor time in s and resident memory in MB of this process and all that came of it."""
        for process in (self._own, *self._own.children(recursive=True)):
            try:
                with process.oneshot():
                    cpu = process.cpu_times()
                    yield process, (cpu.user + cpu.system, process.memory_info().rss / 1e6)
            except psutil.Error:
                continue  # it has ended meanwhile
