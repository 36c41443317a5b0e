"""How the processes of the map are started."""

from __future__ import annotations

import signal
from multiprocessing.context import SpawnProcess

MAP_NICENESS = 15
"""The map yields to the control tick: beside a process of niceness 0 it gets 3 % of a processor that both want."""

FILES_NICENESS = 19
"""The files yield to the control tick, and to the map."""


def start(process: SpawnProcess) -> None:
    """Start with SIGINT held back, or a Ctrl-C while the process is loading would end it."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def ignore_ctrl_c() -> None:
    """In the process: a Ctrl-C in the terminal reaches every process, and the application decides what ends when."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
