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


class LossyText(io.TextIOWrapper):
    """Writes to where another text stream writes until that fails; what is written afterwards is lost.

    Failures are caught here, above the buffer, and not below it: an interruption (Ctrl-C) that comes in Python code
    between the system's write and the buffer's account of it would let the buffer write the same once more.

    Args:
        like: the other stream; it stays open.
        on_problem: is called once, with the error, when nothing can be written any more.

    Attributes:
        problem: the error; None while all is well.
    """

    def __init__(self, like: io.TextIOWrapper, on_problem: Callable[[OSError], object]) -> None:
        # A descriptor of its own: it can be led elsewhere when the other one fails. It stays open until the process
        # ends, for whoever keeps this stream, such as a handler of logs.
        super().__init__(
            io.BufferedWriter(io.FileIO(os.dup(like.fileno()), "wb", closefd=False)),
            encoding=like.encoding,
            errors=like.errors,
            line_buffering=like.line_buffering,
            write_through=like.write_through,
        )
        self.problem: OSError | None = None
        self._on_problem = on_problem

    def write(self, text: str) -> int:
        """Write some text, or lose it."""
        try:
            return super().write(text)
        except OSError as error:
            self._lose(error)
            return len(text)

    def flush(self) -> None:
        """Write what waits, or lose it."""
        try:
            super().flush()
        except OSError as error:
            self._lose(error)

    def _lose(self, error: OSError) -> None:
        # A descriptor that does not wait is full: whoever writes is told, and may try again.
        if isinstance(error, BlockingIOError):
            raise error
        # Led to nowhere, where also what waits in the buffer goes: it would fail again with every line, and at the end.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno(), inheritable=False)
        os.close(nowhere)
        self.problem = error
        self._on_problem(error)


@contextmanager
def lossy_output() -> Iterator[Callable[[], OSError | None]]:
    """Let standard output and standard error be lost, for a while, instead of raising.

    What became of standard output is said once on standard error. Nothing is said of a pipe that its reader has closed:
    who reads only the first lines (``| head``) wants no more.

    Yields:
        Why standard output was lost, if it was and somebody may miss it.
    """
    lossy: dict[str, LossyText] = {}

    def lost() -> OSError | None:
        problem = lossy["stdout"].problem if "stdout" in lossy else None
        return None if problem is None or problem.errno == errno.EPIPE else problem

    with ExitStack() as stack:
        for name, tell in (("stdout", _tell), ("stderr", lambda _: None)):
            stream = getattr(sys, name)
            # Anything else has been put there by somebody who reads it, such as a test.
            if type(stream) is io.TextIOWrapper and isinstance(stream.buffer, io.BufferedWriter | io.FileIO):
                lossy[name] = LossyText(stream, tell)
                stack.callback(setattr, sys, name, stream)
                setattr(sys, name, lossy[name])
        try:
            yield lost
        finally:
            for name in ("stdout", "stderr"):
                # None: it was closed when the program was started.
                if (stream := getattr(sys, name)) is not None:
                    stream.flush()


def _tell(error: OSError) -> None:
    if error.errno == errno.EPIPE:
        return
    try:
        os.write(2, f"standard output: {error.strerror}; what would be printed from here on is lost\n".encode())
    except OSError:
        return
