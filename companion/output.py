"""Standard output and standard error of a command: the work goes on when they take nothing any more.

A disk that is full, a pipe that nobody reads any more or a terminal that is gone must end neither a flight nor the
writing of what it was for.
"""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager


class Outlet(io.RawIOBase):
    """Writes to a file descriptor until that fails; what is written afterwards is lost.

    Args:
        fd: where to; it stays open.
        on_problem: is called once, with the error, when nothing can be written any more.

    Attributes:
        problem: the error; None while all is well.
    """

    def __init__(self, fd: int, on_problem: Callable[[OSError], object]) -> None:
        super().__init__()
        self.problem: OSError | None = None
        self._fd = fd
        self._on_problem = on_problem

    def writable(self) -> bool:
        """It is."""
        return True

    def fileno(self) -> int:
        """The descriptor."""
        return self._fd

    def isatty(self) -> bool:
        """Whether it is a terminal."""
        return os.isatty(self._fd)

    def write(self, data: object) -> int | None:
        """Write some of ``data``, or lose all of it; None: a descriptor that does not wait is full."""
        view = memoryview(data)  # type: ignore[arg-type]
        if self.problem is None:
            try:
                return os.write(self._fd, view)
            except BlockingIOError:
                return None
            except OSError as error:
                self.problem = error
                self._on_problem(error)
        return view.nbytes


@contextmanager
def lossy_output() -> Iterator[Callable[[], OSError | None]]:
    """Let standard output and standard error be lost, for a while, instead of raising.

    What became of standard output is said once on standard error. Nothing is said of a pipe that its reader has closed:
    who reads only the first lines (``| head``) wants no more.

    Yields:
        Why standard output was lost, if it was and somebody may miss it.
    """
    outlets: list[Outlet] = []

    def lost() -> OSError | None:
        problem = next((outlet.problem for outlet in outlets if outlet.fileno() == 1), None)
        return None if problem is None or problem.errno == errno.EPIPE else problem

    with ExitStack() as stack:
        for name, tell in (("stdout", _tell), ("stderr", lambda _: None)):
            stream = getattr(sys, name)
            # Anything else has been put there by somebody who reads it, such as a test.
            if type(stream) is io.TextIOWrapper and isinstance(stream.buffer, io.BufferedWriter | io.FileIO):
                outlets.append(Outlet(stream.fileno(), tell))
                stack.callback(setattr, sys, name, stream)
                setattr(sys, name, _text(outlets[-1], stream))
        try:
            yield lost
        finally:
            for name in ("stdout", "stderr"):
                # None: it was closed when the program was started.
                if (stream := getattr(sys, name)) is not None:
                    stream.flush()


def _text(outlet: Outlet, like: io.TextIOWrapper) -> io.TextIOWrapper:
    return io.TextIOWrapper(
        io.BufferedWriter(outlet),
        encoding=like.encoding,
        errors=like.errors,
        line_buffering=like.line_buffering,
        write_through=like.write_through,
    )


def _tell(error: OSError) -> None:
    if error.errno == errno.EPIPE:
        return
    try:
        os.write(2, f"standard output: {error.strerror}; what would be printed from here on is lost\n".encode())
    except OSError:
        return
