"""Tasks that end together: beside a block, and the first of several."""

from __future__ import annotations

import asyncio

import pytest

from companion.errors import InputError
from companion.flight.tasks import background, first_of


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


async def test_the_first_that_ends_ends_the_others_before_anything_goes_on() -> None:
    """Else a manoeuvre that was broken off could still send a command into what follows it."""
    log: list[str] = []
    first = asyncio.ensure_future(asyncio.sleep(0.0))
    assert await first_of(first, forever(log), forever(log)) == {first}
    assert log == ["ended", "ended"]


async def test_what_fails_first_gives_its_error_to_whoever_asks() -> None:
    log: list[str] = []
    (ended,) = await first_of(failing(), forever(log))
    with pytest.raises(InputError, match="no such camera"):
        ended.result()


async def test_whoever_waits_for_the_first_takes_all_of_them_along() -> None:
    log: list[str] = []
    waiting = asyncio.create_task(first_of(forever(log), forever(log)))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting
    assert log == ["ended", "ended"]
