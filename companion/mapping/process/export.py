"""The files of a map, made from its journal by a process of their own.

So the map goes on taking images meanwhile, whatever the files cost, and what has been mapped can be written although
the process that mapped it is dead.
"""

from __future__ import annotations

import asyncio
import os
import signal
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext
from pathlib import Path

from companion.errors import CompanionError
from companion.gate.runtime.processes import end_with_parent
from companion.mapping.journal import JOURNAL_NAME, Journal
from companion.mapping.process.messages import MapError
from companion.mapping.process.supervisor import FILES_NICENESS, ignore_the_terminal, start

SAVE_TIMEOUT_S = 600.0
"""A large map on a slow card takes minutes; one that hangs must not keep the application for ever."""

Written = tuple[Path, ...] | str
"""Where the files are, or why they are not."""


async def write_files(context: SpawnContext, folder: Path) -> list[Path]:
    """Write the files of the map whose journal is in ``folder``, each whole or not at all; where they are.

    Raises:
        MapError: a file cannot be written, there is no journal, or it took longer than `SAVE_TIMEOUT_S`.
    """
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_serve, args=(theirs, folder), name="map-files", daemon=True)
    loop = asyncio.get_running_loop()
    answered = asyncio.Event()
    try:
        try:
            await asyncio.to_thread(start, process)
        finally:
            theirs.close()
        loop.add_reader(ours.fileno(), answered.set)
        await asyncio.wait_for(answered.wait(), SAVE_TIMEOUT_S)
        written: Written = ours.recv()
    except TimeoutError:
        raise MapError(f"the map was not written to {folder} in {SAVE_TIMEOUT_S:g} s; its journal is whole") from None
    except EOFError:
        raise MapError(f"the process that writes the map to {folder} died; its journal is whole") from None
    except OSError as error:
        raise MapError(f"the process that writes the map cannot be started: {error.strerror}") from None
    finally:
        loop.remove_reader(ours.fileno())
        ours.close()
        if process.pid is not None:
            process.kill()
            process.join()
            process.close()
    if isinstance(written, str):
        raise MapError(written)
    return list(written)


def _serve(pipe: Connection[Written, None], folder: Path) -> None:
    ignore_the_terminal()
    # Nobody hears any more what it has written; each file is whole or not there.
    end_with_parent(signal.SIGKILL)
    os.nice(FILES_NICENESS)
    pipe.send(_written(folder))


def _written(folder: Path) -> Written:
    # Loaded here and not there: the file formats are of no use to the application.
    from companion.mapping.files import write_map

    try:
        with Journal.read_only(folder / JOURNAL_NAME) as journal:
            return tuple(write_map(journal, folder).values())
    except CompanionError as error:
        return str(error)
    except OSError as error:
        return (
            f"cannot write the map to {folder}: {error.strerror}; make room or give another folder: its journal "
            f"({JOURNAL_NAME}) has everything"
        )
