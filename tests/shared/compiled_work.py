"""Compiled code that is interrupted, as the beginning of a script for a process of its own."""

from __future__ import annotations

COMPILED_WORK = """
import os, signal, sys, threading
from typing import NamedTuple
import numpy as np
from numba import njit

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

def interrupted(numbers):
    ended = 0
    for number in numbers:
        try:
            # On a busy computer it strikes before this has returned.
            threading.Timer(0.01 + 0.0007 * ended, os.kill, (os.getpid(), number)).start()
            while True:
                work(x)
        except KeyboardInterrupt:
            ended += 1
    return ended
"""
"""`interrupted` works until each of some signals has struck, and returns how many of them ended the work."""
