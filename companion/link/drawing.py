"""What is drawn besides the map: the navigation graph and what is left to explore, as bytes."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

from companion.control.graph import Graph
from companion.errors import InputError
from companion.link.wire import WireError
from companion.link.words import Place
from companion.mapping.files.graph_file import graph_content, parse_graph

MOST_FRONTIERS = 256
NO_GRAPH = Graph()


@dataclass(frozen=True, slots=True)
class Drawing:
    """Graph and frontiers.

    Attributes:
        graph: as far as it was met.
        frontiers_m: a place on each frontier, those that count first.
    """

    graph: Graph = NO_GRAPH
    frontiers_m: tuple[Place, ...] = ()

    def encoded(self) -> bytes:
        """As bytes."""
        places = [[round(value, 2) for value in place] for place in self.frontiers_m[:MOST_FRONTIERS]]
        return json.dumps(places).encode() + b"\n" + graph_content(self.graph)


def read_drawing(data: bytes) -> Drawing:
    """The drawing that some bytes are.

    Raises:
        WireError: they are none.
    """
    line, _, graph = data.partition(b"\n")
    try:
        places = tuple((float(x), float(y), float(z)) for x, y, z in json.loads(line))
        drawing = Drawing(parse_graph(graph, "the graph that came"), places)
    except (ValueError, TypeError, InputError) as error:
        raise WireError(f"no drawing: {error}") from None
    if len(places) > MOST_FRONTIERS or not all(math.isfinite(value) for place in places for value in place):
        raise WireError("no drawing: its frontiers are too many, or not finite")
    return drawing
