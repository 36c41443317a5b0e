"""What the page needs of the vehicles, wherever it comes from: the link, or a flight that is played back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from companion.link.words import Answer, Command, Place, Telemetry
from companion.mapping.voxels.piece import MapSnapshot, MapSource
from companion.model import FloatArray
from companion.viewer.graphs import GraphLines


class VehicleView(Protocol):
    """A vehicle as the ground knows it. Every member may be asked from any thread, and answers at once."""

    @property
    def name(self) -> str:
        """Its name."""
        ...

    @property
    def telemetry(self) -> Telemetry | None:
        """The newest; None before the first."""
        ...

    @property
    def age_s(self) -> float:
        """Since anything was heard of it; infinite before."""
        ...

    @property
    def doubt(self) -> str:
        """Why something that claims to be its telemetry is refused just now; empty where nothing is."""
        ...

    @property
    def map_age_s(self) -> float:
        """How old what is missing of its map is: 0 when the ground has all of it; infinite where nothing is known."""
        ...

    @property
    def map_number(self) -> int:
        """Another one when what was shown of its map is void: it tells of another map, or the copy begins anew."""
        ...

    def changed(self, revision: int) -> MapSnapshot:
        """The states of the chunks that changed after a revision of the ground's copy of its map; 0: of all."""
        ...

    def source(self) -> MapSource:
        """The ground's copy of its map, for files.

        Raises:
            CompanionError: there is none yet.
        """
        ...

    def way_m(self) -> FloatArray:
        """(n, 3) the way flown, as far as the ground heard of it."""
        ...

    def graph(self) -> Sequence[GraphLines]:
        """The navigation graph; empty while none has come."""
        ...

    def frontiers_m(self) -> Sequence[Place]:
        """What is left to explore."""
        ...

    def ask(self, command: Command, on_answer: Callable[[Answer | None], None]) -> None:
        """Send a command; ``on_answer`` is called once, from any thread: None when no answer came in time."""
        ...


class Station(Protocol):
    """All that the ground knows."""

    def vehicles(self) -> Sequence[VehicleView]:
        """Every vehicle that was ever heard of, in the order of their names."""
        ...
