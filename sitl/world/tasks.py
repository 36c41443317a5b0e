"""Running several things until one of them ends, or a person ends them."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Coroutine, Iterator
from typing import Any

INTERRUPTED, TERMINATED = "interrupted", "terminated"


async def until(stop: asyncio.Event, *works: Coroutine[Any, Any, None]) -> None:
    """Runs everything until ``stop`` is set or one of them ends; raises what that one raised. None is left behind."""
    tasks: list[asyncio.Future[Any]] = [asyncio.create_task(work) for work in works]
    tasks.append(asyncio.ensure_future(stop.wait()))
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def every(period_s: float, action: Callable[[], None], at_once: bool = True) -> None:
    """Calls ``action`` again and again until cancelled."""
    if not at_once:
        await asyncio.sleep(period_s)
    while True:
        action()
        await asyncio.sleep(period_s)


@contextlib.contextmanager
def signals_call(stop: Callable[[str], None]) -> Iterator[None]:
    """Ctrl-C and SIGTERM call ``stop`` with the reason, so that everything ends in good order."""
    loop = asyncio.get_running_loop()
    reasons = {signal.SIGINT: INTERRUPTED, signal.SIGTERM: TERMINATED}
    # Not in the main thread of a program: then whoever runs it stops it.
    with contextlib.suppress(RuntimeError, ValueError):
        for number, reason in reasons.items():
            loop.add_signal_handler(number, stop, reason)
    try:
        yield
    finally:
        for number in reasons:
            with contextlib.suppress(RuntimeError, ValueError):
                loop.remove_signal_handler(number)
