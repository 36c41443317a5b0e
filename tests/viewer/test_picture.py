"""The picture of a map: that places on it are places in the map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("PIL", reason="pip install mine-companion[ground]")

from PIL import Image

from companion.viewer.canvas import TEXT_PX, Axis, Paper, number, round_step, text_width, ticks_in_a_row
from companion.viewer.picture import SECTION_PX, write_picture
from companion.viewer.voxels import PackedVoxels
from tests.viewer.maps import nothing, tunnel

FREE_COLOUR, PAPER_COLOUR = (222, 233, 241), (255, 255, 255)


def drawn(voxels: PackedVoxels, path: Path, ways: list[NDArray[np.float64]] | None = None) -> NDArray[np.int64]:
    write_picture(voxels, "mission/map.journal", ways or [], path)
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"), np.int64)


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


def test_a_long_tunnel_is_stretched_in_height(tmp_path: Path) -> None:
    """Protects tunnels of kilometres, whose sections would be a line: heights are drawn larger, and it is said."""
    image = drawn(tunnel(3000), tmp_path / "a.png")
    assert image.shape[1] < 1900
    free = (image == FREE_COLOUR).all(axis=-1)
    rows = np.flatnonzero(free.sum(axis=1) > 1000)
    # The section's free part is 12 of its 14 voxels.
    assert SECTION_PX[0] * 12 / 14 - 2 <= len(rows) <= SECTION_PX[1]


def test_floor_and_roof_of_a_long_tunnel_stay_apart(tmp_path: Path) -> None:
    """Protects heights: along a tunnel a pixel is many voxels wide, but not high, or the section would be all wall."""
    image = drawn(tunnel(30_000), tmp_path / "a.png")
    free = (image == FREE_COLOUR).all(axis=-1)
    rows = np.flatnonzero(free.sum(axis=1) > 1000)
    assert SECTION_PX[0] * 12 / 14 - 2 <= len(rows) <= SECTION_PX[1]


def test_what_is_said_of_the_extent_is_that_of_the_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects lengths and heights that are copied from the picture: they are not rounded up to what a pixel covers."""
    written: list[str] = []
    monkeypatch.setattr(Paper, "text", lambda _, x, y, words, *rest, **more: written.append(words))  # noqa: ARG005
    drawn(tunnel(3000), tmp_path / "a.png")
    assert any(words.endswith("extent 300.2 x 2.2 x 1.4 m") for words in written)
    assert {"z -0.1 m", "1.3 m"} <= set(written)


def test_no_line_runs_off_the_sheet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects captions and long titles: what is at the right, such as by how much heights are stretched, is whole."""
    ends: list[float] = []
    text = Paper.text

    def watched(self: Paper, x: float, y: float, words: str, size: int = TEXT_PX, *rest: Any, **more: Any) -> None:
        if more.get("anchor", "la")[0] == "l":
            ends.append(x + text_width(words, size))
        text(self, x, y, words, size, *rest, **more)

    monkeypatch.setattr(Paper, "text", watched)
    image = drawn(tunnel(30_000), tmp_path / "a.png")
    assert max(ends) < image.shape[1]
    write_picture(tunnel(), 20 * "a long name ", [], tmp_path / "b.png")
    with Image.open(tmp_path / "b.png") as other:
        assert max(ends) < other.width


def test_how_much_is_drawn_is_told(tmp_path: Path) -> None:
    """Protects from minutes of silence: drawing a tunnel of kilometres takes longer than reading it."""
    shares: list[float] = []
    write_picture(tunnel(3000), "a", [], tmp_path / "a.png", shares.append)
    assert len(shares) > 4
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.mark.parametrize("low_m", [-3.0, 5000.5, 120_000.05])
def test_numbers_beside_each_other_do_not_touch(low_m: float) -> None:
    """Protects the axes of a map far from the origin, and of a low section, which would have one number only."""
    for size_m in (0.35, 4.5, 41.0):
        axis = Axis(low_m, low_m + size_m, 100.0, 150.0 / size_m)
        ticks = ticks_in_a_row(axis)
        places = [axis.at(tick) for tick in ticks]
        widths = [text_width(number(tick)) for tick in ticks]
        assert all(b - a > wide for a, b, wide in zip(places, places[1:], widths, strict=False))
        if low_m < 0.0:
            assert len(ticks) >= 2


def test_the_way_is_drawn_where_it_was_flown(tmp_path: Path) -> None:
    """Protects the way: along the middle of the tunnel it is a level line; outside the plan it is not drawn."""
    way = np.array([[0.5, 1.0, 0.5], [5.5, 1.0, 0.5], [500.0, 1.0, 0.5]])
    with_way, without = drawn(tunnel(), tmp_path / "a.png", [way]), drawn(tunnel(), tmp_path / "b.png")
    changed = np.argwhere((with_way != without).any(axis=-1))
    on_plan = changed[changed[:, 0] < 600]
    assert 5.0 * 130 <= np.ptp(on_plan[:, 1]) <= 5.0 * 1300 / 6.2 + 8
    assert np.ptp(on_plan[:, 0]) <= 8


def test_an_empty_map_is_a_picture_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects a flight that saw nothing: a white plan, and no division by zero."""
    written: list[str] = []
    text = Paper.text

    def watched(self: Paper, x: float, y: float, words: str, *rest: Any, **more: Any) -> None:
        written.append(words)
        text(self, x, y, words, *rest, **more)

    monkeypatch.setattr(Paper, "text", watched)
    image = drawn(nothing(), tmp_path / "a.png")
    assert "voxel 0.1 m    nothing is known: no voxel is occupied or free" in written
    assert pixels_of(image, PAPER_COLOUR) > 0.9 * image.shape[0] * image.shape[1]


def test_nothing_half_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the picture that is there when the disk is full."""
    (tmp_path / "a.png").write_bytes(b"old")

    def full(*_: object, **__: object) -> None:
        raise OSError("full")

    monkeypatch.setattr(Image.Image, "save", full)
    with pytest.raises(OSError, match="full"):
        drawn(tunnel(), tmp_path / "a.png")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a.png", b"old")]


@pytest.mark.parametrize(
    ("least", "step"), [(0.9, 1.0), (1.0, 1.0), (1.1, 2.0), (3.0, 5.0), (0.03, 0.05), (700.0, 1000.0)]
)
def test_steps_are_round(least: float, step: float) -> None:
    """Protects axes and the scale bar from numbers that nobody reads."""
    assert round_step(least) == pytest.approx(step)


@pytest.mark.parametrize("px_per_m", [0.02, 1.0, 37.0, 500.0, -37.0])
def test_ticks_are_where_their_numbers_say(px_per_m: float) -> None:
    """Protects the axes: round coordinates inside the frame, in order, with room between them."""
    axis = Axis(-3.3, 41.7, 100.0, px_per_m)
    ticks = axis.ticks_m(85.0)
    places = np.array([axis.at(tick) for tick in ticks])
    assert all(axis.low_m - 1e-6 <= tick <= axis.high_m + 1e-6 for tick in ticks)
    assert (np.abs(np.diff(places)) >= 85.0 - 1e-6).all()
    assert np.allclose((places - 100.0) / px_per_m - 3.3, ticks)
