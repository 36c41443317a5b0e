"""Processes of this computer that fly missions, one at a time each.

Every worker is a pool of one, so that a death takes nothing along but the mission that the worker was flying. None of
them outlives the process that started it, however that ends.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import get_context
from typing import Protocol, Self

from companion.gate.runtime.processes import end_with_parent
from companion.interruption import ENDS
from sitl.campaign.mission import Mission, Row

Fly = Callable[[Mission], Row]
"""Flies a mission and returns its figures; found by its name in every worker."""


class Workers(Protocol):
    """Who flies the missions: processes here, or those of a cluster. A context manager, at whose end they stop."""

    died: tuple[type[BaseException], ...]
    """What the future of a mission raises whose worker died."""

    def room(self) -> int:
        """How many missions may be under way."""

    def who(self) -> str:
        """How many there are, for whoever waits."""

    def submit(self, fly: Fly, mission: Mission) -> Future[Row]:
        """Let a mission be flown; there is `room` for it."""

    def check(self) -> None:
        """Raise what keeps all missions from being flown."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


class LocalWorkers:
    """Workers of this computer.

    Args:
        count: how many.
    """

    died: tuple[type[BaseException], ...] = (BrokenProcessPool,)

    def __init__(self, count: int) -> None:
        self._count = count
        self._processes: dict[ProcessPoolExecutor, Future[int]] = {}
        self._idle: list[ProcessPoolExecutor] = []
        self._busy: dict[Future[Row], ProcessPoolExecutor] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker, process in self._processes.items():
            with suppress(BrokenProcessPool, ProcessLookupError):
                os.kill(process.result(), signal.SIGKILL)
            worker.shutdown()

    def room(self) -> int:
        """One mission for each worker."""
        return self._count

    def who(self) -> str:
        """As many as there were to be."""
        return f"{self._count} at a time"

    def submit(self, fly: Fly, mission: Mission) -> Future[Row]:
        """Give a mission to a worker that has none; one that died is replaced."""
        for future in [future for future in self._busy if future.done()]:
            worker = self._busy.pop(future)
            if isinstance(future.exception(), BrokenProcessPool):
                del self._processes[worker]
                worker.shutdown()
            else:
                self._idle.append(worker)
        worker = self._idle.pop() if self._idle else self._begun()
        future = worker.submit(fly, mission)
        self._busy[future] = worker
        return future

    def check(self) -> None:
        """Nothing can keep them from flying."""

    def _begun(self) -> ProcessPoolExecutor:
        # A fork would share the threads and locks of numba and Open3D.
        worker = ProcessPoolExecutor(1, get_context("spawn"), _end_with, (os.getpid(),))
        # Workers inherit what is blocked: signals of the terminal are for the parent, which gets its own afterwards.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDS)
        try:
            self._processes[worker] = worker.submit(os.getpid)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return worker


def _end_with(parent: int) -> None:
    """In a worker: die when its parent does."""
    end_with_parent(signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)  # it had died before this could be asked
