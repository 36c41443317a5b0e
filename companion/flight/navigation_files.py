"""What the navigator has learnt, written beside the map at the end of a flight."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

from companion.control.graph import Graph
from companion.control.known_ground import Window
from companion.control.navigator import Navigator
from companion.mapping.files.graph_file import write_graph
from companion.mapping.files.ground_file import write_known_ground


@dataclass(frozen=True, slots=True)
class Navigation:
    """The navigation graph of a flight, and what it knew of the ground."""

    graph: Graph
    ground: Window

    @classmethod
    def of(cls, navigator: Navigator) -> Self:
        """That of a navigator that has flown."""
        return cls(navigator.graph.finish(), navigator.known_ground.seen())

    def write(self, map_folder: Path, folder: Path) -> None:
        """Write ``graph.json`` and ``known_ground.npz``.

        Args:
            map_folder: where the map is.
            folder: of this flight. Where it has gone on with the map of another one, its name is part of the files'
                names, so that those of the other flight stay.

        Raises:
            OSError: one cannot be written.
        """
        of = "" if map_folder == folder else f"-{folder.name}"
        write_graph(self.graph, map_folder / f"graph{of}.json")
        write_known_ground(self.ground, map_folder / f"known_ground{of}.npz")
