"""Ctrl-C, SIGTERM and SIGHUP: they end the work, but not the writing of what it was done for."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

ENDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""A supervisor sends the second, a terminal that is closed the third."""


_NUMBA_BOXES = "_numba_unpickle"
"""The function of numba that compiled functions run before they give back what they have made. Whether an exception
comes out of it is not looked at: the process would crash, and with it would go what it was working for."""


def interrupt(number: int, frame: FrameType | None) -> None:
    """The handler of `ENDS`: raises KeyboardInterrupt; where that is not safe, in the next line of whoever called."""
    inner = frame
    while inner is not None and inner.f_code.co_name != _NUMBA_BOXES:
        inner = inner.f_back
    if inner is None or inner.f_back is None:
        signal.default_int_handler(number, frame)

    def raise_it(_frame: FrameType, _event: str, _argument: object) -> None:
        sys.settrace(None)
        raise KeyboardInterrupt

    inner.f_back.f_trace = raise_it
    sys.settrace(lambda *_: None)


def signals_are_ctrl_c(numbers: Sequence[signal.Signals] = ENDS) -> None:
    """Let signals end a program as Ctrl-C does, unless whoever started it lets them be ignored."""
    if threading.current_thread() is not threading.main_thread():
        return
    for number in numbers:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, interrupt)


def signals_kill() -> None:
    """The end of `signals_are_ctrl_c`: all is done, and Python takes a while to leave, in which nothing can be lost."""
    for number in ENDS:
        if signal.getsignal(number) is interrupt:
            signal.signal(number, signal.SIG_DFL)


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
def stopping(what: str) -> Iterator[Callable[[], bool]]:
    """While something works that can be asked to stop, and has results to write then.

    The first signal asks, so nothing is torn apart in the midst of a step; the second is told to wait, the third breaks
    off. For the writing itself there is `finishing`.

    Args:
        what: what is being done, for the one line that tells it.

    Yields:
        Whether somebody has asked.
    """
    with _counted(what, heard=1) as signals:
        yield lambda: signals() > 0


@contextmanager
def finishing(what: str) -> Iterator[None]:
    """While results are written: the first signal is told to wait, the next one ends it with what is there.

    Args:
        what: what is being done, for the one line that tells it.
    """
    with _counted(what, heard=0):
        yield


@contextmanager
def _counted(what: str, heard: int) -> Iterator[Callable[[], int]]:
    """Count signals: so many are only counted, the next one is told to wait, those after it interrupt."""
    count = 0

    def on_signal(number: int, frame: FrameType | None) -> None:
        nonlocal count
        count += 1
        if count <= heard:
            return
        if count > heard + 1:
            interrupt(number, frame)
            return
        # Not by print: the signal may have come in the middle of one. A terminal that is gone has no reader.
        try:
            os.write(2, f"\n{what}: a moment; interrupt once more to end with what is there\n".encode())
        except OSError:
            return

    if threading.current_thread() is not threading.main_thread():
        yield lambda: 0
        return
    with handled(ENDS, on_signal):
        yield lambda: count
