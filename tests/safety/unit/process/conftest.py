"""For all tests of the shell around the gate."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator

import pytest

from companion.safety import family, keeper, process


@pytest.fixture(autouse=True)
def own_family(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The processes that other tests have started are not the gate's."""
    before = set(family.children())
    real_children = family.children

    def children() -> list[int]:
        return [pid for pid in real_children() if pid not in before]

    def deaths() -> list[tuple[int, int]]:
        found = []
        for pid in children():
            ended, status = os.waitpid(pid, os.WNOHANG)
            if ended:
                found.append((pid, os.waitstatus_to_exitcode(status)))
        return found

    monkeypatch.setattr(keeper, "children", children)
    monkeypatch.setattr(keeper, "deaths", deaths)
    monkeypatch.setattr(process, "adopt_orphans", lambda: None)
    yield
    gc.unfreeze()
    for pid in children():
        family.kill(pid)
        os.waitpid(pid, 0)
