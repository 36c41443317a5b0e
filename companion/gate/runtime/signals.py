"""Signals: what people ask for, and news of children."""

from __future__ import annotations

import contextlib
import signal
import socket
from types import FrameType

_PASSED_ON = {
    signal.SIGINT: signal.SIGINT,
    signal.SIGTERM: signal.SIGTERM,
    # The terminal is gone: that ends the flight, and not the vehicle.
    signal.SIGHUP: signal.SIGTERM,
}
_KEPT_OUT = (*_PASSED_ON, signal.SIGQUIT, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU)
"""None of these may end or stop the gate: the vehicle would be left to itself."""
_BY_THE_KERNEL = 128
"""SI_KERNEL: a key was pressed in the terminal, and its whole process group has the signal."""
MOST = 16


class Signals:
    """Keeps signals from doing anything by themselves; to be made in the main thread before any other is started.

    Attributes:
        wake: readable when a child has ended; `drain` empties it.
    """

    def __init__(self) -> None:
        self.wake, self._bell = socket.socketpair()
        self.wake.setblocking(False)
        self._bell.setblocking(False)
        self._mask = signal.pthread_sigmask(signal.SIG_BLOCK, _KEPT_OUT)
        self._handler = signal.signal(signal.SIGCHLD, _nothing)
        self._wakeup = signal.set_wakeup_fd(self._bell.fileno(), warn_on_full_buffer=False)

    def drain(self) -> None:
        """The bell was heard."""
        with contextlib.suppress(BlockingIOError):
            self.wake.recv(4096)

    def requests(self) -> list[signal.Signals | None]:
        """Requests for the end since the last call: what to pass on, or None when the application has it already."""
        found: list[signal.Signals | None] = []
        for _ in range(MOST):
            came = signal.sigtimedwait(_KEPT_OUT, 0)
            if came is None:
                break
            number = signal.Signals(came.si_signo)
            if number is signal.SIGINT and came.si_code == _BY_THE_KERNEL:
                found.append(None)
            elif number in _PASSED_ON:
                found.append(_PASSED_ON[number])
        return found

    def close(self) -> None:
        """As it was before."""
        signal.set_wakeup_fd(self._wakeup)
        signal.signal(signal.SIGCHLD, self._handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, self._mask)
        self.wake.close()
        self._bell.close()


def _nothing(_number: int, _frame: FrameType | None) -> None:
    """A handler has to be there for the bell to ring."""
