"""A signal ends a command wherever it strikes, and never as a crash."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import os, signal, threading
from typing import NamedTuple
import numpy as np
from numba import njit
from companion.interruption import ENDS, signals_are_ctrl_c

class Made(NamedTuple):
    a: np.ndarray

@njit
def work(x):
    s = 0.0
    for i in range(100_000):
        s += np.sin(i * x[0])
    return Made(np.full(3, s))

x = np.ones(2)
work(x)
signals_are_ctrl_c()
ended = 0
for number in ENDS * 6:
    threading.Timer(0.01 + 0.0007 * ended, os.kill, (os.getpid(), number)).start()
    try:
        while True:
            work(x)
    except KeyboardInterrupt:
        ended += 1
print("ended", ended)
"""


@pytest.mark.timeout(120)
def test_a_signal_in_compiled_code_ends_the_work_and_not_the_process() -> None:
    """Protects what was flown for: numba does not notice an exception while it gives back a named tuple."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False, timeout=110)
    assert (done.returncode, done.stdout) == (0, "ended 18\n"), done.stderr
