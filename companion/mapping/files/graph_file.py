"""The navigation graph as a file, `graph.json`: GeoJSON, so that GIS programs open it beside the map; docs/map.md."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError

from companion.control.graph import Edge, EdgeKind, End, Exit, Graph, Left, Vertex
from companion.errors import InputError
from companion.mapping.files.whole import whole_file

GRAPH_FORMAT = "companion navigation graph 1"

MOST_BYTES = 100_000_000
"""Of a file that is read: the largest graph that a flight makes has a third of that."""

_DIGITS = 3
"""mm, ms and mrad."""

_Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e9, le=1e9)]
_Count = Annotated[int, Field(ge=0)]
_Sense = Literal[-1, 0, 1]
_Place = tuple[_Number, _Number, _Number]


class _Part(BaseModel):
    """A part of the file; what GIS programs add to it is passed over."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)


class _Point(_Part):
    type: Literal["Point"] = "Point"
    coordinates: _Place


class _Line(_Part):
    type: Literal["LineString"] = "LineString"
    coordinates: Annotated[tuple[_Place, ...], Field(min_length=2)]


class _OfVertex(_Part):
    what: Literal["vertex"] = "vertex"
    number: _Count
    ground_m: _Number
    heading_rad: _Number
    gamma: _Sense
    met: _Count
    met_back: _Count
    first_s: _Number
    last_s: _Number


class _OfEdge(_Part):
    what: Literal["edge"] = "edge"
    kind: EdgeKind
    start: _Count
    start_along: _Sense
    end: _Count
    end_along: _Sense
    gamma: _Sense
    length_m: _Number
    flown: _Count
    flown_back: _Count
    way_m: _Number
    time_s: _Number
    first_s: _Number
    last_s: _Number


class _OfExit(_Part):
    what: Literal["exit"] = "exit"
    kind: EdgeKind
    left: Left
    vertex: _Count | None
    along: _Sense
    ground_m: _Number
    gamma: _Sense
    decided: _Count
    visited: bool
    first_s: _Number
    last_s: _Number


class _VertexFeature(_Part):
    type: Literal["Feature"] = "Feature"
    geometry: _Point
    properties: _OfVertex


class _EdgeFeature(_Part):
    type: Literal["Feature"] = "Feature"
    geometry: _Line
    properties: _OfEdge


class _ExitFeature(_Part):
    type: Literal["Feature"] = "Feature"
    geometry: _Line
    properties: _OfExit


def _what(feature: Any) -> str | None:
    if isinstance(feature, dict):
        properties = feature.get("properties")
        found = properties.get("what") if isinstance(properties, dict) else None
        return found if isinstance(found, str) else None
    return getattr(getattr(feature, "properties", None), "what", None)


_Feature = Annotated[
    Annotated[_VertexFeature, Tag("vertex")]
    | Annotated[_EdgeFeature, Tag("edge")]
    | Annotated[_ExitFeature, Tag("exit")],
    Discriminator(_what),
]


class _File(_Part):
    type: Literal["FeatureCollection"] = "FeatureCollection"
    format: Literal["companion navigation graph 1"] = "companion navigation graph 1"
    frame: Literal["east-north-up"] = "east-north-up"
    unit: Literal["m"] = "m"
    origin_m: _Place
    left_out: _Count
    features: tuple[_Feature, ...]


def write_graph(graph: Graph, path: Path, origin_m: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
    """Write a graph; whole or not at all.

    Args:
        graph: in the map's own coordinates.
        path: the file.
        origin_m: where the map's origin is in surveyed coordinates: it is noted, and the coordinates stay as they are.

    Raises:
        OSError: it cannot be written; what was there before still is.
    """
    with whole_file(path) as out:
        out.write(graph_content(graph, origin_m))


def graph_content(graph: Graph, origin_m: Sequence[float] = (0.0, 0.0, 0.0)) -> bytes:
    """What `write_graph` writes."""
    file = _File(
        origin_m=(float(origin_m[0]), float(origin_m[1]), float(origin_m[2])),
        left_out=graph.left_out,
        features=(
            *(_of_vertex(number, vertex) for number, vertex in enumerate(graph.vertices)),
            *map(_of_edge, graph.edges),
            *map(_of_exit, graph.exits),
        ),
    )
    head = file.model_dump(mode="json")
    # A line for each feature: people look into it, and differences between two stay readable.
    features = ",\n".join(json.dumps(_rounded(feature)) for feature in head.pop("features"))
    return f'{json.dumps(head)[:-1]}, "features": [\n{features}\n]}}\n'.encode()


def read_graph(path: Path) -> Graph:
    """The graph in a file that `write_graph` has written.

    Raises:
        InputError: there is none, or it is not one that can be.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"{path}: is larger than {MOST_BYTES / 1e6:.0f} MB: no flight makes such a graph")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}") from None
    return parse_graph(content, str(path))


def parse_graph(content: bytes, path: str) -> Graph:
    """The graph in the content of such a file; ``path`` is named in what is wrong with it.

    Raises:
        InputError: it is not one that can be.
    """
    try:
        file = _File.model_validate_json(content, strict=True)
    except ValidationError as error:
        raise InputError(f"{path}: {_first_problem(error)}") from None
    features = file.features
    vertices = [_vertex(feature) for feature in features if isinstance(feature, _VertexFeature)]
    numbers = [feature.properties.number for feature in features if isinstance(feature, _VertexFeature)]
    if numbers != list(range(len(numbers))):
        raise InputError(
            f"{path}: the vertices are not numbered 0 to {len(numbers) - 1} in their order: one is missing"
        )
    for place, feature in enumerate(features):
        _refuse_unknown(f"{path}: features.{place}", feature, len(vertices))
    edges = [_edge(feature) for feature in features if isinstance(feature, _EdgeFeature)]
    exits = [_exit(feature) for feature in features if isinstance(feature, _ExitFeature)]
    return Graph(tuple(vertices), tuple(edges), tuple(exits), file.left_out)


def _first_problem(error: ValidationError) -> str:
    """The first thing that is wrong, and how many more there are."""
    first, *more = error.errors(include_url=False)
    where = ".".join(str(part) for part in first["loc"] if part not in ("vertex", "edge", "exit")) or "the file"
    also = f" ({len(more)} more)" if more else ""
    value = "" if first["type"] in ("missing", "json_invalid") else f" = {str(first['input'])[:60]}"
    wrong = f"is no navigation graph of this program: {first['msg']}{also}"
    return f"{where}{value}: {wrong}; companion replay --graph makes it again"


def _refuse_unknown(where: str, feature: _VertexFeature | _EdgeFeature | _ExitFeature, vertices: int) -> None:
    properties = feature.properties
    named: dict[str, int | None] = {}
    if isinstance(properties, _OfEdge):
        named = {"start": properties.start, "end": properties.end}
        if properties.flown + properties.flown_back == 0:
            raise InputError(f"{where}.flown = 0: an edge was flown once at least; the file is damaged")
    elif isinstance(properties, _OfExit):
        named = {"vertex": properties.vertex}
        if len(feature.geometry.coordinates) != 2:
            raise InputError(f"{where}.coordinates: an exit has 2 points, not {len(feature.geometry.coordinates)}")
    for name, number in named.items():
        if number is not None and number >= vertices:
            raise InputError(f"{where}.{name} = {number}: there are {vertices} vertices, from 0; the file is damaged")


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, _DIGITS)
    if isinstance(value, dict):
        return {key: _rounded(part) for key, part in value.items()}
    return [_rounded(part) for part in value] if isinstance(value, list) else value


def _of_vertex(number: int, vertex: Vertex) -> _VertexFeature:
    x_m, y_m, z_m, *_ = vertex
    rest = vertex._asdict()
    return _VertexFeature(
        geometry=_Point(coordinates=(x_m, y_m, z_m)),
        properties=_OfVertex(number=number, **{name: rest[name] for name in Vertex._fields[3:]}),
    )


def _vertex(feature: _VertexFeature) -> Vertex:
    properties = feature.properties.model_dump(exclude={"what", "number"})
    return Vertex(*feature.geometry.coordinates, **properties)


def _of_edge(edge: Edge) -> _EdgeFeature:
    line = tuple((float(x), float(y), float(z)) for x, y, z in edge.line_m)
    return _EdgeFeature(
        geometry=_Line(coordinates=line),
        properties=_OfEdge(
            kind=edge.kind,
            start=edge.start.vertex,
            start_along=_sense(edge.start.along),
            end=edge.end.vertex,
            end_along=_sense(edge.end.along),
            gamma=_sense(edge.gamma),
            length_m=edge.length_m,
            flown=edge.flown,
            flown_back=edge.flown_back,
            way_m=edge.way_m,
            time_s=edge.time_s,
            first_s=edge.first_s,
            last_s=edge.last_s,
        ),
    )


def _edge(feature: _EdgeFeature) -> Edge:
    of = feature.properties
    return Edge(
        of.kind,
        End(of.start, of.start_along),
        End(of.end, of.end_along),
        of.gamma,
        np.array(feature.geometry.coordinates, np.float32),
        of.flown,
        of.flown_back,
        of.way_m,
        of.time_s,
        of.first_s,
        of.last_s,
    )


def _of_exit(exit_: Exit) -> _ExitFeature:
    seen_from = exit_.from_x_m, exit_.from_y_m, exit_.from_z_m
    return _ExitFeature(
        geometry=_Line(coordinates=(seen_from, (exit_.x_m, exit_.y_m, exit_.from_z_m))),
        properties=_OfExit(
            kind=exit_.kind,
            left=exit_.left,
            vertex=None if exit_.vertex is None else exit_.vertex.vertex,
            along=_sense(0 if exit_.vertex is None else exit_.vertex.along),
            ground_m=exit_.ground_m,
            gamma=_sense(exit_.gamma),
            decided=exit_.decided,
            visited=exit_.visited,
            first_s=exit_.first_s,
            last_s=exit_.last_s,
        ),
    )


def _exit(feature: _ExitFeature) -> Exit:
    of, (seen_from, to) = feature.properties, feature.geometry.coordinates
    vertex = None if of.vertex is None else End(of.vertex, of.along)
    where = *seen_from, to[0], to[1], of.ground_m
    return Exit(of.kind, of.left, vertex, *where, of.gamma, of.decided, of.visited, of.first_s, of.last_s)


def _sense(value: int) -> _Sense:
    return 1 if value > 0 else -1 if value < 0 else 0
