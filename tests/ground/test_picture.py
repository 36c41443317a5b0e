"""The picture of a map: that places on it are places in the map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("PIL", reason="pip install mine-companion[ground]")

from PIL import Image

from companion.ground.paper import Axis, round_step
from companion.ground.picture import SECTION_PX, write_picture
from companion.ground.voxels import PackedVoxels
from tests.ground.maps import nothing, tunnel

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


def test_the_way_is_drawn_where_it_was_flown(tmp_path: Path) -> None:
    """Protects the way: along the middle of the tunnel it is a level line; outside the plan it is not drawn."""
    way = np.array([[0.5, 1.0, 0.5], [5.5, 1.0, 0.5], [500.0, 1.0, 0.5]])
    with_way, without = drawn(tunnel(), tmp_path / "a.png", [way]), drawn(tunnel(), tmp_path / "b.png")
    changed = np.argwhere((with_way != without).any(axis=-1))
    on_plan = changed[changed[:, 0] < 600]
    assert 5.0 * 130 <= np.ptp(on_plan[:, 1]) <= 5.0 * 1300 / 6.2 + 8
    assert np.ptp(on_plan[:, 0]) <= 8


def test_an_empty_map_is_a_picture_too(tmp_path: Path) -> None:
    """Protects a flight that saw nothing: a white plan, and no division by zero."""
    image = drawn(nothing(), tmp_path / "a.png")
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
    ticks = axis.ticks_m()
    places = np.array([axis.at(tick) for tick in ticks])
    assert all(axis.low_m - 1e-6 <= tick <= axis.high_m + 1e-6 for tick in ticks)
    assert (np.abs(np.diff(places)) >= 85.0 - 1e-6).all()
    assert np.allclose((places - 100.0) / px_per_m - 3.3, ticks)
