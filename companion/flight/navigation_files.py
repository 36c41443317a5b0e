"""What the navigator has learnt, written beside the map at the end of a flight, and taken up by the next one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from companion.control.graph import Graph
from companion.control.known_ground import KnownGround, Window
from companion.control.navigator import Navigator
from companion.errors import InputError
from companion.flight.events import Event, EventEmitter
from companion.mapping.files.graph_file import write_graph
from companion.mapping.files.ground_file import GROUND_NAME, ground_content, read_known_ground, write_known_ground


@dataclass(frozen=True, slots=True)
class Navigation:
    """The navigation graph of a flight, and what it knew of the ground."""

    graph: Graph
    ground: Window

    @classmethod
    def of(cls, navigator: Navigator) -> Self:
        """That of a navigator that has flown."""
        return cls(navigator.graph.finish(), navigator.known_ground.seen())

    def write(self, map_folder: Path, folder: Path, goes_on: bool) -> None:
        """Write ``graph.json`` and ``known_ground.npz``.

        Args:
            map_folder: where the map is.
            folder: of this flight. Where it has gone on with the map of another one, its name is part of the files'
                names, so that those of the other flight stay.
            goes_on: whether it has gone on from the ground of the other one: then all of that is in its own, which
                takes its place.

        Raises:
            OSError: one cannot be written.
        """
        of = "" if map_folder == folder else f"-{folder.name}"
        write_graph(self.graph, map_folder / f"graph{of}.json")
        ground = map_folder / GROUND_NAME
        if ground.exists() and not goes_on:
            ground = map_folder / f"known_ground{of}.npz"
        write_known_ground(self.ground, ground)


@dataclass(frozen=True, slots=True)
class EarlierGround:
    """What earlier flights have seen of the ground, where this one goes on with their map.

    Attributes:
        window: what this flight goes on from; None where it begins anew.
        problem: why it begins anew though a map goes on; None otherwise.
    """

    window: Window | None = None
    problem: str | None = None

    @classmethod
    def taken_up(cls, ground: KnownGround, map_folder: Path | None) -> Self:
        """Take up what lies beside the map of earlier flights; whatever is wrong with that ends no flight.

        Args:
            ground: of a navigator that has not flown yet.
            map_folder: where the map is that goes on; None: none does.
        """
        if map_folder is None:
            return cls()
        path = map_folder / GROUND_NAME
        try:
            earlier = read_known_ground(path)
            ground.go_on_from(earlier)
        except InputError as error:
            return cls(problem=str(error))
        except ValueError as error:
            return cls(problem=f"{path}: {error}")
        return cls(earlier)

    @property
    def content(self) -> bytes:
        """For the recording; empty where it begins anew."""
        return b"" if self.window is None else ground_content(self.window)

    @property
    def free_m2(self) -> float | None:
        """How much floor had been seen; None where it begins anew."""
        return None if self.window is None else round(self.window.free_m2, 1)

    def tell(self, events: EventEmitter) -> None:
        """Say what became of it."""
        if self.problem is not None:
            events.emit(Event.GROUND_NOT_RESUMED, why=self.problem)
        elif self.window is not None:
            events.emit(Event.GROUND_RESUMED, area_m2=self.window.free_m2)
