"""How the process of the map is started."""

from __future__ import annotations

import time
from multiprocessing import get_context
from multiprocessing.connection import Connection

import pytest

from companion.mapping.process import supervisor
from companion.mapping.process.messages import FromMap, Preparing, Ready, ToMap
from companion.mapping.process.supervisor import MapSupervisor

STAGE_S, STAGES = 1.5, 4


def slow_to_start(pipe: Connection[FromMap, ToMap]) -> None:
    """Be a map on a small computer."""
    for number in range(STAGES):
        pipe.send(Preparing(f"compiling part {number}"))
        time.sleep(STAGE_S)
    pipe.send(Ready())
    pipe.recv()


async def test_a_process_that_says_what_it_is_at_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small computer compiles for many minutes: only silence is given up."""
    monkeypatch.setattr(supervisor, "SILENT_TIMEOUT_S", 0.8 * STAGES * STAGE_S)
    heard: list[FromMap] = []

    async def start() -> bool:
        process = MapSupervisor(get_context("spawn"), slow_to_start, (), heard.append, lambda: 0)
        await process.begin()
        try:
            return process.is_ready
        finally:
            await process.close()

    assert await start()
    assert [type(message) for message in heard] == [Preparing] * STAGES + [Ready]
