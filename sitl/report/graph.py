"""The navigation graph over the plan of the mine, as in the paper's Fig. 6."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from companion.control.graph import EdgeKind, Exit, Graph, Left, Vertex
from companion.viewer.graphs import EDGE_COLOURS, EDGE_LABELS, UNVISITED, VISITED, edges_of, line_m, untaken
from sitl.report.data import ReportData
from sitl.report.plan import Plan, marker, plan_png
from sitl.report.style import FAINT_INK, INK

_ARROW_IN = 0.17


def graph_png(data: ReportData, plan: Plan | None, graph: Graph) -> bytes:
    """The graph of one flight, as a PNG: its edges by what they are, its vertices, and the exits not taken."""

    def draw(axes: Axes) -> list[Line2D]:
        handles = _draw_edges(axes, graph)
        handles += _draw_exits(axes, untaken(graph))
        return handles + _draw_vertices(axes, graph.vertices)

    return plan_png(data, plan, draw)


def _draw_edges(axes: Axes, graph: Graph) -> list[Line2D]:
    """What was flown often is thicker."""
    handles = []
    for order, kind in enumerate(reversed(EdgeKind)):
        edges = edges_of(graph, kind)
        if not edges:
            continue
        style = "--" if kind in (EdgeKind.WALL, EdgeKind.OPEN) else "-"
        axes.add_collection(
            LineCollection(
                [line_m(graph, edge)[:, :2] for edge in edges],
                colors=EDGE_COLOURS[kind],
                linewidths=[1.4 + 0.7 * min(edge.flown + edge.flown_back - 1, 4) for edge in edges],
                linestyles=style,
                capstyle="round",
                zorder=3.0 + 0.1 * order,
            )
        )
        handles.append(Line2D([], [], color=EDGE_COLOURS[kind], lw=2.5, ls=style, label=EDGE_LABELS[kind]))
    return handles[::-1]


def _draw_exits(axes: Axes, exits: Iterable[Exit]) -> list[Line2D]:
    """A dotted line to T_m; red where nobody has come to it."""
    handles = {}
    for exit_ in exits:
        colour = VISITED if exit_.visited else UNVISITED
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
