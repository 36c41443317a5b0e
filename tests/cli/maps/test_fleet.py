"""`companion map merge` of the maps of vehicles that flew in one fleet, each in a frame of its own."""

from __future__ import annotations

import json
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from companion.cli.maps.fleet_frame import FLEET_FRAME
from companion.control.sharing import Frame
from companion.mapping.files.moved import MovedMap
from companion.mapping.journal import Journal
from companion.mapping.voxels.chunks import NOTHING
from tests.cli.maps.conftest import HEADER, Run, journal_at

LIES = Frame(2.0, -0.5, 0.3, math.pi / 2.0)


def values_in(folder: Path) -> dict[tuple[int, ...], list[int]]:
    """Every chunk with something in it."""
    with Journal.read_only(folder) as journal:
        return {
            tuple(chunk): values.tolist()
            for piece in journal.pieces()
            for chunk, values in zip(piece.chunks.tolist(), piece.values, strict=True)
            if (values != NOTHING).any()
        }


def flight(folder: Path, frame: object) -> Path:
    """A flight's folder with a room in it, and what its summary says."""
    journal_at(folder / "map.journal")
    (folder / "summary.json").write_text(json.dumps({"fleet": {"number": 1, "frame": frame}}), encoding="utf-8")
    return folder


@pytest.fixture
def fleet(tmp_path: Path) -> tuple[Path, Path]:
    """The flights of two vehicles that saw the same room; the second lies elsewhere, turned to the left."""
    first, second = flight(tmp_path / "vehicle-1", asdict(Frame())), tmp_path / "vehicle-2"
    flight(second, asdict(LIES))
    with Journal.read_only(first / "map.journal") as room:
        moved = MovedMap(room, Frame(*LIES.own(0.0, 0.0, 0.0), -LIES.yaw_rad))
        piece = moved.read(moved.chunks)
    for segment in (second / "map.journal").iterdir():
        segment.unlink()
    with Journal.open(second / "map.journal", HEADER) as journal:
        journal.append(piece)
    return first, second


def test_a_room_that_two_vehicles_saw_is_one_room(run: Run, fleet: tuple[Path, Path], tmp_path: Path) -> None:
    """Protects V: each map goes where its vehicle says that it lies, and it is said what was moved."""
    code, printed, errors = run("merge", *fleet, "-o", tmp_path / "mine.journal")
    assert code == 0, errors
    assert "from 2 maps" in printed
    assert f"{fleet[1]}: moved by 2.00 -0.50 0.30 m and turned by 90.0 degrees to the left" in errors
    once, twice = values_in(fleet[0] / "map.journal"), values_in(tmp_path / "mine.journal")
    assert set(once) == set(twice)
    for chunk, values in once.items():
        known = np.array(values) != NOTHING
        doubled = np.clip(2 * np.array(values), HEADER.lowest, HEADER.highest)
        assert np.array_equal(np.array(twice[chunk]), np.where(known, doubled, NOTHING))
    with Journal.read_only(tmp_path / "mine.journal") as mine:
        assert mine.header.frame == FLEET_FRAME


def test_the_merged_map_goes_with_the_next_vehicle(run: Run, fleet: tuple[Path, Path], tmp_path: Path) -> None:
    """Protects merging in steps: the result is in the shared frame, and is not moved again."""
    first, second = fleet
    third = flight(tmp_path / "vehicle-3", asdict(Frame(0.1, 0.0, 0.0, 0.0)))
    assert run("merge", first, second, "-o", tmp_path / "two.journal")[0] == 0
    assert run("merge", tmp_path / "two.journal", third, "-o", tmp_path / "steps.journal")[0] == 0
    assert run("merge", third, second, first, "-o", tmp_path / "once.ot")[0] == 0


def test_a_map_in_a_frame_of_its_own_does_not_go_with_them(run: Run, fleet: tuple[Path, Path], tmp_path: Path) -> None:
    """Protects from a map of which nobody knows where it lies, put anywhere."""
    unknown = flight(tmp_path / "lost", None)
    alone = journal_at(tmp_path / "alone" / "map.journal").parent
    for other in (unknown, alone):
        code, _, errors = run("merge", fleet[0], other, "-o", tmp_path / "mine.journal")
        assert code == 2
        assert "do not go together" in errors
        assert "is in the summary.json beside it, as fleet.frame" in errors
    assert run("merge", unknown, alone, "-o", tmp_path / "mine.journal")[0] == 0


@pytest.mark.parametrize(
    "frame", [{"x_m": 1.0}, "north", [1, 2, 3, 4], asdict(Frame(math.inf)), asdict(Frame(yaw_rad=math.nan))]
)
def test_a_frame_that_is_none_is_refused(run: Run, fleet: tuple[Path, Path], tmp_path: Path, frame: object) -> None:
    """Protects from a damaged summary that counts as one that says nothing."""
    other = flight(tmp_path / "other", frame)
    code, _, errors = run("merge", fleet[0], other, "-o", tmp_path / "mine.journal")
    assert code == 2
    assert "fleet.frame has to be x_m, y_m, z_m and yaw_rad" in errors


def test_a_map_farther_away_than_voxels_reach_is_refused(run: Run, fleet: tuple[Path, Path], tmp_path: Path) -> None:
    """Protects from voxels anywhere: the line names the flight."""
    other = flight(tmp_path / "other", asdict(Frame(1e9)))
    code, _, errors = run("merge", fleet[0], other, "-o", tmp_path / "mine.journal")
    assert code == 2
    assert f"{other}: a map cannot be moved so far away; look at fleet.frame" in errors
