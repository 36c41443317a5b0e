"""A simulated mission on the operator's page, while it flies."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import typer

from companion.cli.maps.extra import of_the_extra
from sitl.sim.simulation import Simulation

HOST = "127.0.0.1"
MOST_POINTS = 1_000_000


@contextmanager
def watched(simulation: Simulation, name: str, port: int | None) -> Iterator[Callable[[], None]]:
    """Serve the operator's page of a mission while the block runs.

    Args:
        simulation: the mission.
        name: of the mission.
        port: of the page; None: there is none.

    Yields:
        What the mission's thread has to call often, so that the page sees it.

    Raises:
        InputError: nothing can listen there.
        CompanionError: the extra is not installed.
    """
    if port is None:
        yield lambda: None
        return
    with of_the_extra("companion sim --page"):
        from companion.ground.page import serve
        from sitl.sim.watched import WatchedSimulation
    station, ends = WatchedSimulation(simulation, name), threading.Event()
    with serve(station, name, HOST, port, MOST_POINTS) as page:
        thread = threading.Thread(target=page.run, args=(ends.is_set,), name="page")
        thread.start()
        try:
            typer.echo(f"watch it at http://localhost:{page.port}")
            yield station.look
        finally:
            ends.set()
            thread.join()
