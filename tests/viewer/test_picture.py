"""The picture of a map and what it is drawn from: places, the way flown, packed voxels."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.errors import InputError
from companion.viewer.voxels import State, trajectories
from tests.shared.graphs import small_graph
from tests.viewer.maps import nothing, tunnel

pytest.importorskip("matplotlib", reason="pip install mine-companion[ground]")

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text

from companion.viewer.graphs import graph_lines
from companion.viewer.picture import SECTION_PX, map_figure, round_length_m, write_picture
from companion.viewer.voxels import PackedVoxels

FREE_COLOUR, PAPER_COLOUR = (222, 233, 241), (255, 255, 255)


def drawn(voxels: PackedVoxels, path: Path, ways: list[NDArray[np.float64]] | None = None) -> NDArray[np.int64]:
    """The pixels (rows, columns, 3) of the file."""
    write_picture(voxels, "mission/map.journal", ways or [], path)
    return np.rint(imread(path)[..., :3] * 255.0).astype(np.int64)


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.findobj(Text)]


def pixels_of(image: NDArray[np.int64], colour: tuple[int, int, int]) -> int:
    return int((image == colour).all(axis=-1).sum())


def test_plan_and_sections_are_to_scale(tmp_path: Path) -> None:
    """Protects distances that are read off the picture: free space in the sections has the size that it has."""
    image = drawn(tunnel(), tmp_path / "a.png")
    # 60 x 20 x 12 voxels and walls: the plan is 62 of them in 1300 px wide; both sections are to the same scale.
    px = 1300 / 62
    sections = (60 * 12 + 20 * 12) * px**2
    key = 23 * 15
    assert pixels_of(image, FREE_COLOUR) == pytest.approx(sections + key, rel=0.02)


@pytest.mark.parametrize("length", [3000, 30_000])
def test_floor_and_roof_of_a_long_tunnel_stay_apart(tmp_path: Path, length: int) -> None:
    """Protects tunnels of kilometres, whose sections would be a line or all wall: heights are drawn larger."""
    image = drawn(tunnel(length), tmp_path / "a.png")
    assert image.shape[1] < 1900
    free = (image == FREE_COLOUR).all(axis=-1)
    rows = np.flatnonzero(free.sum(axis=1) > 1000)
    # The section's free part is 12 of its 14 voxels.
    assert SECTION_PX[0] * 12 / 14 - 2 <= len(rows) <= SECTION_PX[1]


def test_what_is_said_of_the_extent_is_that_of_the_map() -> None:
    """Protects lengths and heights that are copied from the picture: they are not rounded up to what a pixel covers."""
    written = texts(map_figure(tunnel(3000), "a", []))
    assert any(words.endswith("extent 300.2 x 2.2 x 1.4 m") for words in written)
    assert {"-0.1", "1.3"} <= set(written)
    assert any(words.startswith("section A at y = 1.") and words.endswith(" m, heights x 50") for words in written)


def test_no_line_runs_off_the_sheet(tmp_path: Path) -> None:
    """Protects captions and long titles: the sheet is as wide as what is on it, with a margin."""
    write_picture(tunnel(), 20 * "a long name ", [], tmp_path / "a.png")
    for image in (drawn(tunnel(30_000), tmp_path / "b.png"), np.rint(imread(tmp_path / "a.png")[..., :3] * 255.0)):
        margin = np.concatenate([image[:, :20].reshape(-1, 3), image[:, -20:].reshape(-1, 3)])
        assert (margin == 255).all()


def test_how_much_is_drawn_is_told(tmp_path: Path) -> None:
    """Protects from minutes of silence: drawing a tunnel of kilometres takes longer than reading it."""
    shares: list[float] = []
    write_picture(tunnel(3000), "a", [], tmp_path / "a.png", shares.append)
    assert len(shares) > 4
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.mark.parametrize("length", [20, 60, 3000, 30_000])
def test_numbers_beside_each_other_do_not_touch(length: int) -> None:
    """Protects the axes of large maps and of a low section, which would have one number only."""
    figure = map_figure(tunnel(length), "a", [])
    canvas = FigureCanvasAgg(figure)
    canvas.draw()  # type: ignore[no-untyped-call]
    for axes in figure.axes[:3]:
        boxes = [
            label.get_window_extent()
            for label, place in zip(axes.get_xticklabels(), axes.get_xticks(), strict=True)
            if axes.get_xlim()[0] <= place <= axes.get_xlim()[1]
        ]
        assert len(boxes) >= 2
        assert all(left.x1 + 5.0 < right.x0 for left, right in pairwise(boxes))


def test_the_way_is_drawn_where_it_was_flown(tmp_path: Path) -> None:
    """Protects the way: along the middle of the tunnel it is a level line; outside the plan it is not drawn."""
    way = np.array([[0.5, 1.0, 0.5], [5.5, 1.0, 0.5], [500.0, 1.0, 0.5]])
    with_way, without = drawn(tunnel(), tmp_path / "a.png", [way]), drawn(tunnel(), tmp_path / "b.png")
    assert with_way.shape == without.shape
    changed = np.argwhere((with_way != without).any(axis=-1))
    on_plan = changed[changed[:, 0] < 600]
    assert 5.0 * 130 <= np.ptp(on_plan[:, 1]) <= 5.7 * 1300 / 6.2 + 8
    assert np.ptp(on_plan[:, 0]) <= 8


def test_an_empty_map_is_a_picture_too(tmp_path: Path) -> None:
    """Protects a flight that saw nothing: a white plan, and no division by zero."""
    assert "voxel 0.1 m    nothing is known: no voxel is occupied or free" in texts(map_figure(nothing(), "a", []))
    image = drawn(nothing(), tmp_path / "a.png")
    assert pixels_of(image, PAPER_COLOUR) > 0.9 * image.shape[0] * image.shape[1]


def test_nothing_half_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the picture that is there when the disk is full."""
    (tmp_path / "a.png").write_bytes(b"old")

    def full(*_: object, **__: object) -> None:
        raise OSError("full")

    monkeypatch.setattr(Figure, "savefig", full)
    with pytest.raises(OSError, match="full"):
        drawn(tunnel(), tmp_path / "a.png")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a.png", b"old")]


@pytest.mark.parametrize(
    ("least", "length"), [(0.9, 1.0), (1.0, 1.0), (1.1, 2.0), (3.0, 5.0), (0.03, 0.05), (700.0, 1000.0)]
)
def test_scale_bars_are_round(least: float, length: float) -> None:
    """Protects the scale bar from numbers that nobody reads."""
    assert round_length_m(least) == pytest.approx(length)


def test_the_navigation_graph_is_drawn_and_explained() -> None:
    """Protects the picture of a mission: what the lines over its plan are stands in the key."""
    written = texts(map_figure(tunnel(), "a", [], lines=graph_lines([small_graph()])))
    assert {"tangent segment", "boundary arc", "exit never come to"} <= set(written)
    assert "tangent segment" not in texts(map_figure(tunnel(), "a", []))


# The way flown, from the files beside a map.


def test_every_file_is_a_way(tmp_path: Path) -> None:
    """Protects missions with several vehicles; rows without a position are left out, not drawn at the origin."""
    (tmp_path / "trajectory-1.csv").write_text("t_s,x_m,y_m,z_m\n0,1,2,3\n1,,2,3\n2,nan,2,3\n3,4,5,6\n")
    (tmp_path / "trajectory-2.csv").write_text("t_s,x_m,y_m,z_m\n")
    found = trajectories(tmp_path)
    assert found["trajectory-1.csv"].tolist() == [[1, 2, 3], [4, 5, 6]]
    assert found["trajectory-2.csv"].shape == (0, 3)


def test_the_map_is_in_the_frame_of_the_estimate(tmp_path: Path) -> None:
    """Protects simulated missions with drift: the true way would not lie in the map that the vehicle made."""
    columns = "x_m,y_m,z_m,estimated_x_m,estimated_y_m,estimated_z_m"
    (tmp_path / "trajectory.csv").write_text(f"{columns}\n0,0,0,1,2,3\n")
    assert trajectories(tmp_path)["trajectory.csv"].tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("text", ["time,lat,lon\n0,1,2\n", "x_m,y_m,z_m\n1,two,3\n", ""])
def test_a_file_of_something_else_is_named(tmp_path: Path, text: str) -> None:
    """Protects from a traceback: one message with the file, and what to do."""
    (tmp_path / "trajectory.csv").write_text(text)
    with pytest.raises(InputError, match=r"trajectory\.csv: .* move it away to see the map without it"):
        trajectories(tmp_path)


# Packed voxels: that they say what the map says, and what of it is shown coarser.


def coordinates(state: State, level: int = 0) -> set[tuple[int, ...]]:
    return {tuple(row) for numbers in tunnel().numbers(state, level) for row in numbers.tolist()}


def test_every_voxel_is_where_it_is_in_the_map() -> None:
    """Protects the place and the state of each voxel, on both sides of the origin."""
    free = {(x, y, z) for x in range(60) for y in range(20) for z in range(12)}
    around = {(x, y, z) for x in range(-1, 61) for y in range(-1, 21) for z in range(-1, 13)}
    assert coordinates(State.FREE) == free
    assert coordinates(State.OCCUPIED) == around - free
    assert coordinates(State.UNDECIDED) == {(-9, 0, 0)}
    assert [tunnel().count(state) for state in State] == [len(around - free), len(free), 1]


@pytest.mark.parametrize("level", [1, 2, 3, 4])
def test_a_wall_shows_in_every_coarser_cube_that_it_touches(level: int) -> None:
    """Protects from walls that vanish when a large map is shown coarser; free is what is free by half."""
    edge = 2**level
    walls = {tuple(part // edge for part in voxel) for voxel in coordinates(State.OCCUPIED)}
    assert coordinates(State.OCCUPIED, level) == walls
    free = [tuple(part // edge for part in voxel) for voxel in coordinates(State.FREE)]
    cubes, counts = np.unique(np.array(free), axis=0, return_counts=True)
    assert coordinates(State.FREE, level) == {tuple(row) for row in cubes[counts >= edge**3 // 2].tolist()}


def test_an_empty_map() -> None:
    """Protects a flight that saw nothing: no chunks, no voxels, no error."""
    assert len(nothing().chunks) == 0
    assert [nothing().count(state) for state in State] == [0, 0, 0]
    assert list(nothing().numbers(State.FREE)) == []
