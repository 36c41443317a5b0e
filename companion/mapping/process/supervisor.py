"""The supervisor of the map's process: starts it, passes messages, starts it again when it dies, and ends it."""

from __future__ import annotations

import asyncio
import logging
import signal
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

from companion.mapping.process.messages import Failed, FromMap, MapError, Preparing, Ready, Stop, ToMap

SILENT_TIMEOUT_S = 300.0
"""The first start on a computer compiles everything, which takes a small one minutes; it says what it is at."""

RESTARTS = 3
"""A process that dies this often dies of something that another start does not mend."""

REST_S = 1.0

END_TIMEOUT_S = 10.0
"""Time to put the last second on the disk."""

MAP_NICENESS = 15
"""The map yields to the control tick: beside a process of niceness 0 it gets 3 % of a processor that both want."""

FILES_NICENESS = 19
"""The files yield to the control tick, and to the map."""

_OF_A_TERMINAL = (signal.SIGINT, signal.SIGHUP)
"""Ctrl-C, and the end of the terminal: they reach every process that was started in it."""

_log = logging.getLogger(__name__)


class MapSupervisor:
    """Keeps the process of the map running: when it dies it is started again, `RESTARTS` times at most.

    One that hangs is not replaced.

    Args:
        context: that starts processes.
        target: what it runs, with its end of the pipe before the arguments.
        arguments: the others.
        on_message: is given each message.
        on_death: is called each time that it is gone; how many readings are lost with it.

    Attributes:
        restarts: so far.
        why: it could not begin, as it said itself; empty when it could.
        is_ready: it runs and takes readings.
    """

    def __init__(
        self,
        context: SpawnContext,
        target: Callable[..., None],
        arguments: tuple[Any, ...],
        on_message: Callable[[FromMap], None],
        on_death: Callable[[], int],
    ) -> None:
        self._context = context
        self._target = target
        self._arguments = arguments
        self._on_message = on_message
        self._on_death = on_death
        self._process: SpawnProcess | None = None
        self._pipe: Connection[ToMap, FromMap] | None = None
        self._task: asyncio.Task[None] | None = None
        self._closing = asyncio.Event()
        self._gone = asyncio.Event()
        self._news = asyncio.Event()
        self._stage = "loading"
        self._lost = 0
        self.is_ready = False
        self.restarts = 0
        self.why = ""

    @property
    def pid(self) -> int | None:
        """Of the process that runs now."""
        return None if self._process is None else self._process.pid

    async def begin(self) -> None:
        """Start the process and wait until it is ready.

        Raises:
            MapError: it ended at once, or cannot begin, or was silent for `SILENT_TIMEOUT_S`.
        """
        task = self._task = asyncio.create_task(self._keep_running())
        task.add_done_callback(lambda _: self._news.set())
        try:
            while not self.is_ready:
                if self._gone.is_set() or task.done():
                    text = "the process of the map ended at once; its own message, if it had one, stands above"
                    raise MapError(self.why or text)
                self._news.clear()
                await asyncio.wait_for(self._news.wait(), SILENT_TIMEOUT_S)
        except TimeoutError:
            stage = self._stage
            await self.close()
            raise MapError(
                f"the process of the map does not get ready: it has been {stage} for {SILENT_TIMEOUT_S:g} s; on "
                "a small computer compile everything once, before the flight, with: python -m companion.flight.warm_up"
            ) from None
        except BaseException:
            await self.close()
            raise

    def send(self, message: ToMap) -> bool:
        """Send a message; false when the process is gone. There are never so many that the pipe could be full."""
        if self._pipe is None:
            return False
        try:
            self._pipe.send(message)
        except OSError:
            return False
        return True

    async def close(self) -> None:
        """Have the process end, and wait for that."""
        task = self._task
        if task is None:
            return
        self._closing.set()
        try:
            self.send(Stop())
            await asyncio.wait({task}, timeout=END_TIMEOUT_S)
        finally:
            if not task.done() and self._process is not None:
                self._process.kill()
            await task

    async def _keep_running(self) -> None:
        while True:
            try:
                await self._run_once()
            except OSError as error:
                _log.error("the process of the map cannot be started: %s", error.strerror)
            if self._closing.is_set() or self.restarts == RESTARTS:
                return
            try:
                await asyncio.wait_for(self._closing.wait(), REST_S)
            except TimeoutError:
                self.restarts += 1
            else:
                return

    async def _run_once(self) -> None:
        """Start the process, read what it sends, and return when it is gone."""
        self._gone.clear()
        self._pipe, theirs = self._context.Pipe()
        process = self._context.Process(target=self._target, args=(theirs, *self._arguments), name="map", daemon=True)
        try:
            # In a thread: starting takes tens of milliseconds.
            await asyncio.to_thread(start, process)
        finally:
            theirs.close()
        self._process = process
        loop = asyncio.get_running_loop()
        loop.add_reader(self._pipe.fileno(), self._drain)
        try:
            if self._closing.is_set():
                process.kill()
            await self._gone.wait()
        finally:
            loop.remove_reader(self._pipe.fileno())
            self._pipe.close()
            self._pipe = None
            await asyncio.to_thread(process.join, END_TIMEOUT_S)
            process.kill()
            await asyncio.to_thread(process.join)
            if not self._closing.is_set():
                _log.error(
                    "the process of the map died (exit code %s): %d images are lost", process.exitcode, self._lost
                )
            self._process = None
            process.close()

    def _drain(self) -> None:
        """Read all that the process sent; called when there is something to read, or the process is gone."""
        pipe = self._pipe
        if pipe is None:
            return
        try:
            while pipe.poll():
                message = pipe.recv()
                match message:
                    case Preparing(what):
                        self._stage = what
                    case Failed(why):
                        self.why = why
                    case Ready():
                        self.is_ready = True
                self._news.set()
                self._on_message(message)
        except (EOFError, OSError):
            asyncio.get_running_loop().remove_reader(pipe.fileno())
            # At once: whoever sees that it does not run any more sees what is lost with it too.
            self.is_ready = False
            self._lost = self._on_death()
            self._gone.set()
            self._news.set()


def start(process: SpawnProcess) -> None:
    """Start with the terminal's signals held back, or one while the process is loading would end it."""
    signal.pthread_sigmask(signal.SIG_BLOCK, _OF_A_TERMINAL)
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _OF_A_TERMINAL)


def ignore_the_terminal() -> None:
    """In the process: the application decides what ends when."""
    for number in _OF_A_TERMINAL:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _OF_A_TERMINAL)
