"""The navigation graph over the plan of the mine, as in the paper's Fig. 6."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from companion.control.graph import Edge, EdgeKind, Exit, Graph, Left, Vertex
from sitl.report.data import ReportData
from sitl.report.plan import Plan, marker, plan_png
from sitl.report.style import CRITICAL, FAINT_INK, GRAPH_COLOURS, GRAPH_LABELS, INK

_ARROW_IN = 0.17
_STRAIGHT = (EdgeKind.TANGENT, EdgeKind.KNOWN, EdgeKind.WALL, EdgeKind.OPEN)


def graph_png(data: ReportData, plan: Plan | None, graph: Graph) -> bytes:
    """The graph of one flight, as a PNG: its edges by what they are, its vertices, and the exits not taken."""

    def draw(axes: Axes) -> list[Line2D]:
        handles = _draw_edges(axes, graph)
        handles += _draw_exits(axes, graph.exits)
        return handles + _draw_vertices(axes, graph.vertices)

    return plan_png(data, plan, draw)


def _draw_edges(axes: Axes, graph: Graph) -> list[Line2D]:
    """Arcs as they were flown first, segments from vertex to vertex; what was flown often is thicker.

    Straights too short to lead to another vertex are left out.
    """
    handles = []
    for order, kind in enumerate(reversed(EdgeKind)):
        edges = [e for e in graph.edges if e.kind is kind and (kind not in _STRAIGHT or e.start.vertex != e.end.vertex)]
        if not edges:
            continue
        style = "--" if kind in (EdgeKind.WALL, EdgeKind.OPEN) else "-"
        axes.add_collection(
            LineCollection(
                [_line(graph, edge) for edge in edges],
                colors=GRAPH_COLOURS[kind],
                linewidths=[1.4 + 0.7 * min(edge.flown + edge.flown_back - 1, 4) for edge in edges],
                linestyles=style,
                capstyle="round",
                zorder=3.0 + 0.1 * order,
            )
        )
        handles.append(Line2D([], [], color=GRAPH_COLOURS[kind], lw=2.5, ls=style, label=GRAPH_LABELS[kind]))
    return handles[::-1]


def _line(graph: Graph, edge: Edge) -> list[tuple[float, float]]:
    (a, _), (b, _) = edge.start, edge.end
    ends = [(vertex.x_m, vertex.y_m) for vertex in (graph.vertices[a], graph.vertices[b])]
    between = [] if edge.kind in _STRAIGHT else [(float(x), float(y)) for x, y in edge.line_m[:, :2]]
    return [ends[0], *between, ends[1]]


def _draw_exits(axes: Axes, exits: Iterable[Exit]) -> list[Line2D]:
    """Those that were not taken: a dotted line to T_m; red where nobody has come to it."""
    handles = {}
    for exit_ in exits:
        if exit_.left is Left.TAKEN:
            continue
        colour = FAINT_INK if exit_.visited else CRITICAL
        label = f"{exit_.left.value}, {'come to otherwise' if exit_.visited else 'never come to'}"
        shape = "x" if exit_.left is Left.DECLINED else "o"
        axes.plot((exit_.from_x_m, exit_.x_m), (exit_.from_y_m, exit_.y_m), color=colour, lw=1.2, ls=":", zorder=5)
        axes.plot(exit_.x_m, exit_.y_m, shape, ms=6, mfc="none", mec=colour, mew=1.6, zorder=5)
        handles[label] = Line2D([], [], marker=shape, color=colour, lw=1.2, ls=":", ms=6, mfc="none", label=label)
    return [handles[label] for label in sorted(handles)]


def _draw_vertices(axes: Axes, vertices: Sequence[Vertex]) -> list[Line2D]:
    """A dot each, and on a boundary an arrow for each heading."""
    if not vertices:
        return []
    axes.plot([v.x_m for v in vertices], [v.y_m for v in vertices], "o", ms=3.0, ls="none", color=INK, zorder=7)
    handles = [marker("o", INK, "vertex")]
    headings = [
        (vertex, vertex.heading_rad + turn_rad, times > 0)
        for vertex in vertices
        if vertex.gamma != 0
        for turn_rad, times in ((0.0, vertex.met), (math.pi, vertex.met_back))
    ]
    for flown, colour, label in ((False, FAINT_INK, "heading not flown"), (True, INK, "heading flown")):
        some = [(vertex, heading_rad) for vertex, heading_rad, was in headings if was is flown]
        if some:
            at = [v.x_m for v, _ in some], [v.y_m for v, _ in some]
            to = [math.cos(heading) for _, heading in some], [math.sin(heading) for _, heading in some]
            size: dict[str, Any] = {"units": "inches", "scale_units": "inches", "scale": 1.0 / _ARROW_IN}
            axes.quiver(*at, *to, color=colour, width=0.014, headwidth=5, zorder=6.0 + 0.1 * flown, **size)
            handles.append(marker(">", colour, label, colour))
    return handles
