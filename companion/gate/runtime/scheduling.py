"""Before everything else on this computer, where the kernel allows it."""

from __future__ import annotations

import contextlib
import os

PRIORITY = 1
"""The least of real time: before every ordinary process, behind whatever drives the hardware."""
NICENESS = -10


def take_precedence() -> str:
    """For this thread only: what it starts is given none of it (`companion.gate.runtime.processes.spawn`).

    Returns:
        What the kernel granted, in words.
    """
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))
        return "real time"
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
        return f"nice {NICENESS}"
    return "no precedence: the kernel allows none (LimitRTPRIO=1 in the service, or CAP_SYS_NICE)"
