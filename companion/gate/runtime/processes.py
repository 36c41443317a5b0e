"""This process before all others, and those below it: to start them, to hear of their end, to leave none behind."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path

_PROC = Path("/proc")
_SET_PDEATHSIG = 1
_SET_CHILD_SUBREAPER = 36
_RESET = (signal.SIGPIPE, signal.SIGXFSZ)
"""Ignored by Python; other programs expect their death by them."""
_ZOMBIE = "Z"
MOST_DEATHS = 64
"""Heard of in one call."""
PRIORITY = 1
"""The least of real time: before every ordinary process, behind whatever drives the hardware."""
NICENESS = -10


def take_precedence() -> str:
    """Before everything else on this computer, for this thread only: what it starts (`spawn`) is given none of it.

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


def adopt_orphans() -> None:
    """Whoever loses its parent below us becomes ours, so that the children of a killed process can be found."""
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_with_parent(number: signal.Signals | None) -> None:
    """Have the kernel send this process a signal when the one that started it has ended; None: no more.

    It is the end of the thread that counts: who starts processes in a thread that ends before must not use it.
    """
    ctypes.CDLL(None).prctl(_SET_PDEATHSIG, number or 0, 0, 0, 0)


def spawn(command: Sequence[str], environment: Mapping[str, str], inherit: Sequence[int], nice: int) -> int:
    """Start a program in our process group, so that the terminal is its terminal too; gives its process id.

    It has the descriptors 0 to 2 and those in ``inherit``, no blocked signal, and none of our precedence.

    Raises:
        OSError: it cannot be started.
    """
    for entry in os.listdir("/proc/self/fd"):  # noqa: PTH208 - names are wanted, not paths
        if (fd := int(entry)) > 2:
            # The one that lists them is closed by now.
            with contextlib.suppress(OSError):
                os.set_inheritable(fd, fd in inherit)
    arguments, variables = list(command), dict(environment)
    if os.sched_getscheduler(0) == os.SCHED_RR:
        ordinary = (os.SCHED_OTHER, os.sched_param(0))
        pid = os.posix_spawnp(command[0], arguments, variables, setsigmask=(), setsigdef=_RESET, scheduler=ordinary)
    else:
        pid = os.posix_spawnp(command[0], arguments, variables, setsigmask=(), setsigdef=_RESET)
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, pid, nice)
    return pid


def exit_code_of(pid: int) -> int | None:
    """The exit code of a child that has ended (negative: the signal); None while it runs. It stays a zombie.

    To take leave of a process (`deaths`) can take the kernel long: for an application that had just been killed `wait4`
    was measured to block for 0.6 s. That is longer than the autopilot waits, so it is not done while anything flies.
    """
    with contextlib.suppress(ChildProcessError):
        ended = os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        if ended is not None:
            return ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status
    return None


def deaths() -> list[tuple[int, int]]:
    """Process ids and exit codes (negative: the signal) of the children that ended since the last call.

    May take the kernel long: `exit_code_of`.
    """
    found: list[tuple[int, int]] = []
    with contextlib.suppress(ChildProcessError):
        while len(found) < MOST_DEATHS:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                break
            found.append((pid, os.waitstatus_to_exitcode(status)))
    return found


def children() -> list[int]:
    """Process ids of all children that have not ended, the adopted ones too."""
    own = str(os.getpid())
    found: list[int] = []
    for entry in _PROC.iterdir():
        if entry.name.isdecimal():
            # It may end while it is looked at. The name in brackets may hold spaces and brackets itself.
            with contextlib.suppress(OSError):
                stat = entry.joinpath("stat").read_text(errors="replace").rpartition(")")[2].split()
                if stat[1] == own and stat[0] != _ZOMBIE:
                    found.append(int(entry.name))
    return found


def kill(pid: int) -> None:
    """End a child at once."""
    with contextlib.suppress(OSError):
        os.kill(pid, signal.SIGKILL)
