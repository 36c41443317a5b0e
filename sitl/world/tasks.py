"""What runs again and again, until a person ends it."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from collections.abc import Callable, Iterator

INTERRUPTED, TERMINATED = "interrupted", "terminated"


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
