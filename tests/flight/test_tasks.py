"""Tasks beside a block: they end with it, and their failures end it."""

from __future__ import annotations

import asyncio

import pytest

from companion.errors import InputError
from companion.flight.tasks import background


async def forever(log: list[str]) -> None:
    try:
        await asyncio.Event().wait()
    finally:
        log.append("ended")


async def failing() -> None:
    await asyncio.sleep(0)
    raise InputError("no such camera")


async def test_the_end_of_the_block_ends_what_runs_beside_it() -> None:
    log: list[str] = []
    async with background(forever(log), forever(log)):
        await asyncio.sleep(0)
        assert log == []
    assert log == ["ended", "ended"]


async def test_a_failure_beside_it_ends_the_block_with_that_failure() -> None:
    """As itself, not as a group: its message is for a person."""
    log: list[str] = []

    async def block() -> None:
        async with background(failing(), forever(log)):
            try:
                await asyncio.Event().wait()
            finally:
                log.append("block left")

    with pytest.raises(InputError, match="no such camera"):
        await block()
    assert sorted(log) == ["block left", "ended"]


async def test_a_failure_of_the_block_comes_out_as_it_is() -> None:
    log: list[str] = []

    async def block() -> None:
        async with background(forever(log)):
            await asyncio.sleep(0)
            raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        await block()
    assert log == ["ended"]
