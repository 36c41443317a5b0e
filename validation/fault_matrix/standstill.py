"""Whether the computer stood still: a process of the flight wanted to run, and was given no processor.

The kernel counts how long each thread has waited for one, and for how long the host of a virtual machine has taken a
processor away, which no thread is told of. A process that sleeps, is stopped, or waits for something of its own does
not wait for a processor: a gate that holds itself up stays the gate's fault.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.shared.beside import OwnThread

LOOK_S = 0.02
NOTED_S = 0.02
"""Shorter waits happen on every computer all the time."""
REMEMBERED = 10_000
WIRES = "the wires"
"""The relays, which live in this process."""
HOST = "a processor of the virtual machine"
_STOLEN = 7
"""Column behind a processor's name in /proc/stat: time that the host gave to others."""
WINDOW_S = 0.5
"""What the host takes in pieces with hardly anything between them is one standstill."""
_TICKS_PER_S = os.sysconf("SC_CLK_TCK")
_PROC = Path("/proc")


@dataclass(frozen=True, slots=True)
class Wait:
    """One time in which somebody did not run.

    Attributes:
        ended_s: when it was seen to be over, in s of `time.monotonic`.
        lasted_s: how long it was.
        who: had to wait.
    """

    ended_s: float
    lasted_s: float
    who: str

    def __str__(self) -> str:
        return f"{self.who} for {self.lasted_s:.2f} s"


NOBODY = Wait(0.0, 0.0, "nobody")


class Standstill(OwnThread):
    """Looks on, in a thread of its own, while the block lasts.

    Args:
        watched: process ids by name.
        proc: where the kernel tells of processes.
    """

    def __init__(self, watched: Mapping[str, int], proc: Path = _PROC) -> None:
        self._watched = {name: proc / str(pid) / "task" for name, pid in watched.items()}
        self._processors = proc / "stat"
        self._stolen: dict[str, deque[tuple[float, float]]] = {}
        self._waited_ns: dict[Path, int] = {}
        self._looked_s: float | None = None
        self._waits: deque[Wait] = deque(maxlen=REMEMBERED)
        super().__init__("standstill")

    def longest(self, since_s: float, until_s: float) -> Wait:
        """The longest wait that ended between two moments of `time.monotonic`."""
        waits = [wait for wait in tuple(self._waits) if since_s <= wait.ended_s <= until_s]
        return max(waits, key=lambda wait: wait.lasted_s, default=NOBODY)

    def look(self, now_s: float) -> None:
        """Note who has waited since the last look."""
        if self._looked_s is not None:
            self._note(now_s, now_s - self._looked_s - LOOK_S, WIRES)
        self._looked_s = now_s
        self._look_at_processors(now_s)
        for name, tasks in self._watched.items():
            # A process may end while it is looked at.
            with contextlib.suppress(OSError):
                for task in tasks.iterdir():
                    self._look_at(task, name, now_s)

    def _look_at(self, task: Path, name: str, now_s: float) -> None:
        with contextlib.suppress(OSError):
            waited_ns = int((task / "schedstat").read_text(encoding="ascii").split()[1])
            before_ns = self._waited_ns.get(task)
            self._waited_ns[task] = waited_ns
            if before_ns is not None:
                self._note(now_s, (waited_ns - before_ns) * 1e-9, name)

    def _look_at_processors(self, now_s: float) -> None:
        for line in self._processors.read_text(encoding="ascii").splitlines()[1:]:
            processor, *columns = line.split()
            if not processor.startswith("cpu"):
                break
            stolen = self._stolen.setdefault(processor, deque())
            stolen.append((now_s, int(columns[_STOLEN]) / _TICKS_PER_S))
            while len(stolen) > 1 and stolen[1][0] <= now_s - WINDOW_S:
                stolen.popleft()
            self._note(now_s, stolen[-1][1] - stolen[0][1], HOST)

    def _note(self, now_s: float, lasted_s: float, who: str) -> None:
        if lasted_s >= NOTED_S:
            self._waits.append(Wait(now_s, lasted_s, who))

    def _run(self) -> None:
        while not self._stop.wait(LOOK_S):
            self.look(time.monotonic())
