"""What is drawn of the navigation graphs beside a map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.control.graph import EdgeKind, Graph
from companion.errors import InputError
from companion.mapping.files.graph_file import write_graph
from companion.viewer.graphs import EDGE_COLOURS, EDGE_LABELS, UNVISITED, graph_lines, graphs_in, line_m
from tests.shared.graphs import small_graph


def test_every_graph_beside_a_map_is_read(tmp_path: Path) -> None:
    """Protects missions of several vehicles, and maps that several flights have made."""
    for name in ("graph-1.json", "graph-2.json"):
        write_graph(small_graph(), tmp_path / name)
    found = graphs_in(tmp_path)
    assert {name: graph.counts() for name, graph in found.items()} == {
        "graph-1.json": small_graph().counts(),
        "graph-2.json": small_graph().counts(),
    }
    assert graphs_in(tmp_path / "elsewhere") == {}


def test_a_file_of_something_else_is_named(tmp_path: Path) -> None:
    """Protects from a traceback: one message with the file, and what to do."""
    (tmp_path / "graph.json").write_text('{"nodes": []}')
    with pytest.raises(InputError, match=r"graph\.json: .* move it away to see the map without it"):
        graphs_in(tmp_path)


def test_arcs_are_drawn_as_flown_and_segments_straight_from_vertex_to_vertex() -> None:
    """As in the paper's Fig. 6."""
    graph = small_graph()
    tangent, arc = graph.edges[1:]
    assert line_m(graph, tangent).tolist() == [[0.5, 1.0, 1.5], [3.0, 1.5, 1.5]]
    assert line_m(graph, arc)[:, 1].tolist() == [1.5, 1.5, 1.75, 1.5, 1.5]


def test_everything_has_a_colour_and_a_name() -> None:
    """What was not taken is told apart by whether somebody has come there; what was taken is an edge."""
    drawn = {lines.label: lines for lines in graph_lines([small_graph(), small_graph()])}
    assert list(drawn) == [
        "initial circle",
        "tangent segment",
        "boundary arc",
        "exit never come to",
        "exit come to otherwise",
    ]
    assert drawn["exit never come to"].colour == UNVISITED
    assert [len(lines.segments_m) for lines in drawn.values()] == [6, 2, 8, 4, 2]
    assert all(np.isfinite(lines.segments_m).all() for lines in drawn.values())
    assert set(EDGE_COLOURS) == set(EDGE_LABELS) == set(EdgeKind)
    assert graph_lines([Graph()]) == []
