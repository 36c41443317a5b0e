"""What is drawn of a navigation graph: its edges as lines by what they are, and the exits that were not taken."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from companion.control.graph import Edge, EdgeKind, Exit, Graph, Left
from companion.errors import InputError
from companion.mapping.files.graph_file import read_graph
from companion.model import FloatArray

# The colours of Okabe and Ito.
EDGE_COLOURS = {
    EdgeKind.CIRCLE: "#009e73",
    EdgeKind.TANGENT: "#d55e00",
    EdgeKind.BOUNDARY: "#0072b2",
    EdgeKind.KNOWN: "#e69f00",
    EdgeKind.WALL: "#cc79a7",
    EdgeKind.OPEN: "#56b4e9",
}
EDGE_LABELS = {
    EdgeKind.CIRCLE: "initial circle",
    EdgeKind.TANGENT: "tangent segment",
    EdgeKind.BOUNDARY: "boundary arc",
    EdgeKind.KNOWN: "over known ground",
    EdgeKind.WALL: "to the nearest wall",
    EdgeKind.OPEN: "out into the open",
}
UNVISITED = "#b3001b"
"""An untaken exit to which nobody has come by another way either."""
VISITED = "#6b737b"

_ARCS = EdgeKind.CIRCLE, EdgeKind.BOUNDARY


def edges_of(graph: Graph, kind: EdgeKind) -> list[Edge]:
    """The edges of a kind; straights that were too short to lead to another vertex are left out."""
    return [
        edge for edge in graph.edges if edge.kind is kind and (kind in _ARCS or edge.start.vertex != edge.end.vertex)
    ]


def line_m(graph: Graph, edge: Edge) -> FloatArray:
    """(n, 3) an edge from vertex to vertex: an arc as it was flown first, all else straight."""
    ends = [graph.vertices[end.vertex][:3] for end in (edge.start, edge.end)]
    between = edge.line_m.astype(np.float64) if edge.kind in _ARCS else np.empty((0, 3))
    return np.vstack([ends[:1], between, ends[1:]])


def untaken(graph: Graph) -> list[Exit]:
    """The exits that were seen and never taken."""
    return [exit_ for exit_ in graph.exits if exit_.left is not Left.TAKEN]


class GraphLines(NamedTuple):
    """What is drawn in one colour: (n, 2, 3) segments in m, n > 0."""

    label: str
    colour: str
    segments_m: FloatArray


def graph_lines(graphs: Iterable[Graph]) -> list[GraphLines]:
    """Graphs as lines in space: the edges by what they are, and the exits that were not taken."""
    drawn: defaultdict[tuple[str, str], list[FloatArray]] = defaultdict(list)
    for graph in graphs:
        for kind in EdgeKind:
            for line in (line_m(graph, edge) for edge in edges_of(graph, kind)):
                drawn[EDGE_LABELS[kind], EDGE_COLOURS[kind]].append(np.stack([line[:-1], line[1:]], axis=1))
        for exit_ in untaken(graph):
            what = ("exit come to otherwise", VISITED) if exit_.visited else ("exit never come to", UNVISITED)
            seen_from = exit_.from_x_m, exit_.from_y_m, exit_.from_z_m
            drawn[what].append(np.array([[seen_from, (exit_.x_m, exit_.y_m, exit_.from_z_m)]]))
    return [GraphLines(*what, np.concatenate(segments)) for what, segments in drawn.items()]


def graphs_in(folder: Path) -> dict[str, Graph]:
    """By file name, every ``graph*.json`` in a folder.

    Raises:
        InputError: such a file is no navigation graph, or cannot be read.
    """
    found = {}
    for path in sorted(folder.glob("graph*.json")):
        try:
            found[path.name] = read_graph(path)
        except InputError as error:
            raise InputError(f"{error}; move it away to see the map without it") from None
    return found
