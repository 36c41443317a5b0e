"""Ctrl-C, SIGTERM and SIGHUP: they end the work, but not the writing of what it was done for."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""A supervisor sends the second, a terminal that is closed the third."""


def signals_are_ctrl_c() -> None:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C does, unless whoever started it lets them be ignored."""
    if threading.current_thread() is not threading.main_thread():
        return
    for number in ENDS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, signal.default_int_handler)


@contextmanager
def handled(numbers: Sequence[signal.Signals], handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Handle signals for a while; those that are ignored stay so."""
    before = {number: signal.getsignal(number) for number in numbers}
    for number, known in before.items():
        if known is not signal.SIG_IGN:
            signal.signal(number, handler)
    try:
        yield
    finally:
        for number, known in before.items():
            signal.signal(number, known)


@contextmanager
def finishing(what: str) -> Iterator[None]:
    """While results are written: the first signal is told to wait, the next one ends it with what is there.

    Args:
        what: what is being done, for the one line that tells it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    asked = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            signal.default_int_handler(number, frame)
        asked = True
        # Not by print: the signal may have come in the middle of one. A terminal that is gone has no reader.
        try:
            os.write(2, f"\n{what}: a moment; interrupt once more to end with what is there\n".encode())
        except OSError:
            return

    with handled(ENDS, ask):
        yield
