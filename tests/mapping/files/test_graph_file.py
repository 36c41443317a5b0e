"""The navigation graph and the known ground as files: what is written comes back, and what cannot be is refused."""

from __future__ import annotations

import json
import math
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.control.graph import Graph
from companion.control.known_ground import KnownGround, Place
from companion.errors import InputError
from companion.mapping.files.graph_file import read_graph, write_graph
from companion.mapping.files.ground_file import ground_content, ground_of_content, read_known_ground, write_known_ground
from companion.model import Pose
from tests.control.scene import measurement, scan_of
from tests.shared.graphs import small_graph


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A graph that was written."""
    write_graph(small_graph(), tmp_path / "graph.json", (500_000.0, 5_800_000.0, -412.5))
    return tmp_path / "graph.json"


def rough(value: Any) -> Any:
    """The same in mm, so that it can be compared."""
    if isinstance(value, float):
        return round(value, 3)
    if isinstance(value, np.ndarray):
        return value.round(3).tolist()
    return [rough(part) for part in value] if isinstance(value, tuple) else value


def test_a_graph_comes_back_as_it_was(file: Path) -> None:
    """Protects everything that is in it, to the mm."""
    assert rough(read_graph(file)) == rough(small_graph())


def test_a_graph_of_a_flight_that_saw_nothing_comes_back(tmp_path: Path) -> None:
    """Protects a flight that ended before the first tick."""
    write_graph(Graph(), tmp_path / "graph.json")
    assert read_graph(tmp_path / "graph.json") == Graph()


def test_it_is_geojson_that_a_gis_program_draws(file: Path) -> None:
    """Points and lines with three coordinates each, properties that are no lists, and where the origin was surveyed."""
    content = json.loads(file.read_text(encoding="utf-8"))
    assert content["type"] == "FeatureCollection"
    assert content["origin_m"] == [500_000.0, 5_800_000.0, -412.5]
    shapes = [feature["geometry"]["type"] for feature in content["features"]]
    assert shapes == 3 * ["Point"] + 7 * ["LineString"]
    for feature in content["features"]:
        assert feature["type"] == "Feature"
        assert not any(isinstance(value, list | dict) for value in feature["properties"].values())
        places = feature["geometry"]["coordinates"]
        assert all(len(place) == 3 for place in (places if isinstance(places[0], list) else [places]))


def test_what_a_gis_program_adds_is_passed_over(file: Path) -> None:
    """Protects a file that was saved again: other members, other properties, an id."""
    content = json.loads(file.read_text(encoding="utf-8"))
    content |= {"crs": {"type": "name"}, "bbox": [0, 0, 1, 1]}
    content["features"][0] |= {"id": 7}
    content["features"][0]["properties"]["colour"] = "red"
    file.write_text(json.dumps(content), encoding="utf-8")
    assert rough(read_graph(file)) == rough(small_graph())


def _set(*keys: Any, value: Any) -> Callable[[Any], None]:
    def change(content: Any) -> None:
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


OF = "properties"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_set("type", value="Feature"), "type = Feature"),
        (_set("format", value="companion navigation graph 2"), "format = companion navigation graph 2"),
        (_set("unit", value="ft"), "unit = ft"),
        (_set("features", 1, OF, "gamma", value=5), r"features\.1\.properties\.gamma = 5"),
        (_set("features", 1, OF, "heading_rad", value=math.nan), r"features\.1\.properties\.heading_rad = nan"),
        (_set("features", 0, OF, "met", value=-1), r"features\.0\.properties\.met = -1"),
        (_set("features", 0, OF, "met", value="1"), r"features\.0\.properties\.met = 1"),
        (_set("features", 0, OF, "what", value="house"), r"features\.0"),
        (_set("features", 0, "geometry", "coordinates", value=[1.0, 2.0]), r"coordinates\.2: is no .* Field required"),
        (_set("features", 5, OF, "end", value=3), r"features\.5\.end = 3: there are 3 vertices, from 0"),
        (_set("features", 7, OF, "vertex", value=9), r"features\.7\.vertex = 9: there are 3 vertices, from 0"),
        (_set("features", 4, OF, "flown", value=0), r"features\.4\.flown = 0: an edge was flown once at least"),
        (_set("features", 4, OF, "kind", value="road"), r"features\.4\.properties\.kind = road"),
        (_set("features", 1, OF, "number", value=2), "not numbered 0 to 2 in their order"),
        (_set("features", 6, "geometry", "coordinates", value=3 * [[0.0, 0.0, 0.0]]), "an exit has 2 points, not 3"),
        (lambda content: content["features"][3][OF].pop("way_m"), r"features\.3\.properties\.way_m: .* Field required"),
    ],
)
def test_a_damaged_graph_is_refused_by_name(file: Path, change: Callable[[Any], object], says: str) -> None:
    """Protects whoever edits one: one message with the file, the place and the value, and no traceback."""
    content = json.loads(file.read_text(encoding="utf-8"))
    change(content)
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError, match=f"^{re.escape(str(file))}: .*{says}"):
        read_graph(file)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe", b"null"])
def test_what_is_no_graph_is_refused(tmp_path: Path, content: bytes) -> None:
    """Protects from a traceback."""
    (tmp_path / "graph.json").write_bytes(content)
    with pytest.raises(InputError, match=r"graph\.json: "):
        read_graph(tmp_path / "graph.json")


def test_no_file_is_refused(tmp_path: Path) -> None:
    """Protects from a traceback."""
    for read in (read_graph, read_known_ground):
        with pytest.raises(InputError, match="nothing: No such file"):
            read(tmp_path / "nothing")


# The known ground.


def looked(at_z_m: float = 1.5) -> KnownGround:
    """What was seen in a drift 4 m wide, and a place of it that is blocked."""
    ground = KnownGround()
    scan = scan_of(lambda b: 2.0 / abs(math.sin(b)) if abs(math.sin(b)) > 0.1 else math.inf)
    for x_m in range(6):
        ground.see(measurement(scan, h_m=1.5), Pose(0.0, float(x_m), 0.0, at_z_m, 0.0))
    ground.block(Place(3.0, 0.5, at_z_m - 1.5))
    return ground


def test_the_known_ground_comes_back_as_it_was(tmp_path: Path) -> None:
    """Cells, heights, where it lies and what is blocked; no larger than what was seen."""
    ground = looked(at_z_m=13.5)
    written, path = ground.seen(), tmp_path / "known_ground.npz"
    write_known_ground(written, path)
    read = read_known_ground(path)
    np.testing.assert_array_equal(read.grid.cells, written.grid.cells)
    np.testing.assert_array_equal(read.grid.ground_dm, written.grid.ground_dm)
    assert (read.x_m, read.y_m, read.cell_m) == (written.x_m, written.y_m, written.cell_m)
    cells = read.grid.cells
    assert all(edge.any() for edge in (cells[:, 0], cells[:, -1], cells[:, :, 0], cells[:, :, -1]))
    row, column = read.cell(Place(4.0, 0.2, 12.0))
    assert (read.grid.cells[0, row, column], read.grid.ground_dm[0, row, column]) == (1, 120)
    assert read.blocked.tolist() == [[*read.cell(Place(3.0, 0.5, 0.0)), 120]]


def test_ground_that_nobody_looked_for_has_no_cells(tmp_path: Path) -> None:
    """With a coin nothing is noted: the file says so, and can be read."""
    write_known_ground(KnownGround().seen(), tmp_path / "known_ground.npz")
    assert read_known_ground(tmp_path / "known_ground.npz").grid.cells.size == 0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cells", np.full((1, 2, 2), 9, np.uint8)),
        ("cells", np.zeros((9, 2, 2), np.uint8)),
        ("cells", np.zeros((2, 2), np.uint8)),
        ("ground_dm", np.zeros((1, 1, 1), np.int16)),
        ("ground_dm", np.zeros((1, 2, 2), np.float64)),
        ("belief", np.zeros((1, 2, 2), np.int16)),
        ("blocked", np.zeros((3,), np.int64)),
        ("low_m", np.array([0.0, np.nan])),
        ("cell_m", np.array(0.0)),
    ],
)
def test_damaged_ground_is_refused_by_name(tmp_path: Path, name: str, value: np.ndarray[Any, Any]) -> None:
    """Protects whoever plans with it: the array that is wrong, and no traceback."""
    whole: dict[str, Any] = {
        "cells": np.zeros((1, 2, 2), np.uint8),
        "ground_dm": np.zeros((1, 2, 2), np.int16),
        "belief": np.zeros((1, 2, 2), np.int8),
        "blocked": np.zeros((0, 3), np.int64),
        "low_m": np.zeros(2),
        "cell_m": np.array(0.5),
    }
    np.savez(tmp_path / "known_ground.npz", **(whole | {name: value}))
    with pytest.raises(InputError, match=rf"known_ground\.npz: {name}: .* the file is damaged"):
        read_known_ground(tmp_path / "known_ground.npz")


def test_any_damage_to_the_known_ground_is_told() -> None:
    """Before, a byte that was flipped could end whoever read the file: a flight that goes on from it must not end."""
    content = ground_content(looked().seen())
    assert ground_of_content(content, "whole").free_m2 == looked().seen().free_m2
    chance = random.Random(1)  # noqa: S311 - damage, not a secret
    told = []
    for n in range(2000):
        damaged = bytearray(content)
        if n % 4:
            damaged[chance.randrange(len(damaged))] = chance.randrange(256)
        else:
            del damaged[chance.randrange(len(damaged)) :]
        try:
            ground_of_content(bytes(damaged), "flight.mcap: known_ground.npz")
        except InputError as error:
            told.append(str(error))
    assert len(told) > 1000
    assert all(text.startswith("flight.mcap: known_ground.npz: ") for text in told)


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04"])
def test_what_is_no_known_ground_is_refused(tmp_path: Path, content: bytes) -> None:
    """Protects from a traceback, and from code in a pickle."""
    (tmp_path / "known_ground.npz").write_bytes(content)
    with pytest.raises(InputError, match=r"known_ground\.npz: "):
        read_known_ground(tmp_path / "known_ground.npz")
    np.save(tmp_path / "other.npy", np.zeros(3))
    with pytest.raises(InputError, match=r"other\.npy: is no known ground"):
        read_known_ground(tmp_path / "other.npy")
