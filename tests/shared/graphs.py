"""A small navigation graph with something of everything in it."""

from __future__ import annotations

import math

import numpy as np

from companion.control.graph import Edge, EdgeKind, End, Exit, Graph, Left, Vertex


def small_graph() -> Graph:
    """A start, a tangent to a boundary, the boundary flown twice, back once, and an exit of each kind."""
    vertices = (
        Vertex(0.5, 1.0, 1.5, 0.0, 0.25, 0, 1, 0, 0.0, 0.0),
        Vertex(3.0, 1.5, 1.5, 0.0, 0.5, -1, 1, 1, 8.0, 60.0),
        Vertex(5.0, 1.5, 1.5, 0.125, -math.pi / 2.0, -1, 2, 0, 30.5, 90.0),
    )
    arc_m = np.array([[3.0, 1.5, 1.5], [4.0, 1.75, 1.5], [5.0, 1.5, 1.5]], np.float32)
    there, here = End(1, 1), End(2, 1)
    edges = (
        Edge(EdgeKind.CIRCLE, End(0, 0), End(0, 0), 0, arc_m[:2], 1, 0, 0.5, 4.0, 0.0, 4.0),
        Edge(EdgeKind.TANGENT, End(0, 0), there, 0, arc_m[:2], 1, 0, 2.5, 4.0, 4.0, 8.0),
        Edge(EdgeKind.BOUNDARY, there, here, -1, arc_m, 2, 1, 6.75, 15.0, 8.0, 90.0),
    )
    exits = (
        Exit(EdgeKind.TANGENT, Left.TAKEN, End(0, 0), 0.5, 1.0, 1.5, 3.0, 1.5, 0.0, -1, 1, True, 4.0, 4.0),
        Exit(EdgeKind.TANGENT, Left.DECLINED, here, 5.0, 1.5, 1.5, 5.5, 0.5, 0.0, 1, 2, False, 30.5, 90.0),
        Exit(EdgeKind.KNOWN, Left.DECLINED, there, 3.0, 1.5, 1.5, 0.5, 1.0, 0.0, 0, 1, True, 60.0, 60.0),
        Exit(EdgeKind.TANGENT, Left.OUT_OF_REACH, None, 4.0, 1.75, 1.5, 5.75, 1.0, 0.0, -1, 0, False, 20.0, 21.0),
    )
    return Graph(vertices, edges, exits, left_out=2)
