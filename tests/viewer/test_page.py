"""The page in the browser: that it is served, what is on it, and that nobody else sees it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from sitl.launch.processes import free_tcp_port

pytest.importorskip("viser", reason="pip install mine-companion[ground]")

from companion.cli import main as cli
from companion.config.mapping import MapSettings
from companion.errors import InputError
from companion.mapping.journal import Header, Journal
from companion.mapping.voxels.chunks import OFFSETS
from companion.mapping.voxels.piece import MapPiece
from companion.viewer.graphs import GraphLines, graph_lines
from companion.viewer.page import Page, serve
from companion.viewer.voxels import PackedVoxels, State
from tests.shared.graphs import small_graph
from tests.viewer.maps import nothing, tunnel


def served(voxels: PackedVoxels, most_points: int = 1_000_000, lines: Sequence[GraphLines] = ()) -> Iterator[Page]:
    way = {"trajectory.csv": np.array([[0.5, 1.0, 0.5], [5.5, 1.0, 0.5]])}
    with serve(voxels, "mission/map.journal", way, "127.0.0.1", free_tcp_port(), most_points, lines) as page:
        yield page


@pytest.fixture
def page() -> Iterator[Page]:
    """A tunnel, served."""
    yield from served(tunnel())


def test_the_page_is_served_from_this_machine(page: Page) -> None:
    """Protects the view underground: the page comes over HTTP, and asks no other machine for anything."""
    with urllib.request.urlopen(f"http://127.0.0.1:{page.port}/") as answer:
        text = answer.read().decode("utf-8")
    assert answer.status == 200
    head = text.partition("<body")[0]
    assert "<script" in text
    assert 'src="http' not in head
    assert 'href="http' not in head


def test_every_voxel_but_the_roof_is_on_the_page(page: Page) -> None:
    """Protects the first sight: the ground and the walls, from dark to light, and not a closed lid."""
    voxels = tunnel()
    # The roof is 60 x 20 voxels: those over the walls hide nothing.
    assert page.drawing.points == voxels.count(State.OCCUPIED) - 60 * 20
    assert page.note == ""


def test_a_large_map_is_shown_coarser_and_it_is_said() -> None:
    """Protects from a page that never opens, and from taking what is thinned out for the whole."""
    # 14,400 free voxels are 1,800 cubes of 2.
    for shown in served(tunnel(), most_points=2000):
        assert "too many voxels to show each: occupied in cubes of 0.2 m, free in cubes of 0.2 m" in shown.note
        assert 0 < shown.drawing.points <= 2000


def test_the_navigation_graph_is_on_the_page() -> None:
    """Protects the view of what was decided where: a line for every edge, and for every exit that was not taken."""
    for shown in served(tunnel(), lines=graph_lines([small_graph()])):
        assert {label: len(handle.points) for label, handle in shown.graph.items()} == {
            "initial circle": 3,
            "tangent segment": 1,
            "boundary arc": 4,
            "exit never come to": 2,
            "exit come to otherwise": 1,
        }


def test_an_empty_map_is_served_too() -> None:
    """Protects a flight that saw nothing."""
    for shown in served(nothing()):
        assert shown.drawing.points == 0


def test_a_port_that_is_taken_is_refused() -> None:
    """Protects from looking at another map: viser alone would quietly take the next port."""
    with closing(socket.socket()) as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = int(other.getsockname()[1])
        with (
            pytest.raises(InputError, match=f"cannot listen at 127.0.0.1 port {port}: .* give another --port"),
            serve(tunnel(), "map", {}, "127.0.0.1", port, 1000),
        ):
            pass


def test_the_map_is_never_made_public(page: Page) -> None:
    """Protects the customer's map: no visitor can have it published through viser's tunnel."""
    assert page.server.request_share_url() is None


def test_ctrl_c_ends_the_command(tmp_path: Path) -> None:
    """Protects the terminal: the address is printed, and Ctrl-C ends it with 130 and without a traceback."""
    with Journal.open(tmp_path / "map.journal", Header.of(MapSettings())) as journal:
        values = np.where(OFFSETS[:, 2] > 8, 2000, -1000).astype(np.int16)
        journal.append(MapPiece(np.zeros((1, 3), np.int32), values[None]))
    port = free_tcp_port()
    with subprocess.Popen(
        [sys.executable, "-m", "companion", "map", "view", str(tmp_path), "--port", str(port)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(Path(cli.__file__).parents[2]), "PYTHONUNBUFFERED": "1"},
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == f"{tmp_path}: open http://localhost:{port}; Ctrl-C ends it\n"
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/") as answer:
                assert answer.status == 200
            process.send_signal(signal.SIGINT)
            printed, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert printed.strip() == ""
