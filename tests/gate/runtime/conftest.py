"""For all tests of the shell around the gate."""

from __future__ import annotations

import contextlib
import gc
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.gate.runtime import main as process
from companion.gate.runtime import processes, supervisor


@pytest.fixture(autouse=True)
def own_family(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The processes that other tests have started are not the gate's."""
    before = with_zombies()
    real_children = processes.children

    def children() -> list[int]:
        return [pid for pid in real_children() if pid not in before]

    def deaths() -> list[tuple[int, int]]:
        found = []
        for pid in with_zombies() - before:
            ended, status = os.waitpid(pid, os.WNOHANG)
            if ended:
                found.append((pid, os.waitstatus_to_exitcode(status)))
        return found

    monkeypatch.setattr(supervisor, "children", children)
    monkeypatch.setattr(supervisor, "deaths", deaths)
    monkeypatch.setattr(process, "adopt_orphans", lambda: None)
    yield
    gc.unfreeze()
    for pid in with_zombies() - before:
        processes.kill(pid)
        os.waitpid(pid, 0)


def with_zombies() -> set[int]:
    """Process ids of all children, also of those that have ended and were not waited for."""
    found: set[int] = set()
    for task in Path(f"/proc/{os.getpid()}/task").iterdir():
        # A thread may end while it is looked at.
        with contextlib.suppress(OSError):
            found |= {int(pid) for pid in (task / "children").read_text(encoding="ascii").split()}
    return found
