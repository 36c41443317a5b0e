"""Unit, axes, origin and size of a mesh file: right, or refused with what to do; and what is told about them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d
import pytest
from numpy.typing import NDArray

from companion.config.settings import Settings
from companion.errors import InputError
from companion.model import Pose
from sitl.mines import World, load_world
from sitl.mines.placing import Reading
from sitl.scene.raycast import RayCaster
from sitl.sim.nearest_start import Room
from sitl.sim.simulation import Simulation
from sitl.sim.start import check_start, remarks_on_start

START = (3.0, 1.8, 1.0, 0.5)
ROOM = Room(0.3, 1.0, 0.5)


def written(path: Path, vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> str:
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(vertices), open3d.utility.Vector3iVector(triangles)
    )
    assert open3d.io.write_triangle_mesh(path, mesh)
    return str(path)


@pytest.fixture(scope="module")
def room() -> World:
    return load_world("room", 0)


def file_of(room: World, path: Path, factor: float = 1.0, shift: tuple[float, float, float] = (0, 0, 0)) -> str:
    return written(path, (room.vertices_m.astype(np.float64)) * factor + np.array(shift), room.triangles)


@pytest.mark.parametrize(
    ("shift", "origin_m"),
    [
        ((500_000.0, 6_000_000.0, 400.0), (500_000.0, 6_000_000.0, 0.0)),
        ((45_123.0, -38_456.0, -900.0), (45_100.0, -38_500.0, 0.0)),
        ((0.0, 1_200_000.0, 2_345.0), (0.0, 1_200_000.0, 2_300.0)),
    ],
)
def test_a_mesh_far_away_keeps_its_shape_and_tells_its_origin(
    tmp_path: Path, room: World, shift: tuple[float, float, float], origin_m: tuple[float, float, float]
) -> None:
    """In double precision, of which 1 nm is left at 6,000 km; in single precision half a metre would be."""
    path = file_of(room, tmp_path / "utm.ply", shift=shift)
    start = (START[0] + shift[0], START[1] + shift[1], START[2] + shift[2], START[3])
    world = load_world(path, 0, start)
    assert world.origin_m == origin_m
    assert any("origin_m" in remark for remark in world.remarks)
    near = room.vertices_m + (np.array(shift) - origin_m)
    np.testing.assert_allclose(world.vertices_m, near, atol=1e-4)
    assert world.start is not None
    place = np.array([world.start.x_m, world.start.y_m, world.start.z_m]) + origin_m
    np.testing.assert_allclose(place, start[:3], atol=1e-6)
    assert f"({start[0]:.2f}, {start[1]:.2f}" in world.named(world.start.x_m, world.start.y_m, world.start.z_m)


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (600.0, -800.0, 900.0)])
def test_a_mesh_near_0_stays_where_it_is_to_the_last_bit(
    tmp_path: Path, room: World, shift: tuple[float, float, float]
) -> None:
    path = file_of(room, tmp_path / "near.ply", shift=shift)
    world = load_world(path, 0, START)
    assert world.origin_m == (0.0, 0.0, 0.0)
    expected = (room.vertices_m.astype(np.float64) + np.array(shift)).astype(np.float32)
    assert world.vertices_m.tobytes() == expected.tobytes()
    assert world.start == Pose(0.0, *START)


@pytest.mark.parametrize(
    ("factor", "says"),
    [
        (1000.0, r"10000 x 7000 x 2700 m.*looks like millimetres: --scale 0.001.*10 x 7 x 2.7 m"),
        (0.001, r"no mine is shorter than 2 m.*--scale"),
    ],
)
def test_a_size_that_no_mine_has_is_refused_with_the_likely_unit(
    tmp_path: Path, room: World, factor: float, says: str
) -> None:
    with pytest.raises(InputError, match=says):
        load_world(file_of(room, tmp_path / "mine.ply", factor), 0, START)


def test_a_long_mine_in_centimetres_is_not_taken_for_one_in_millimetres(tmp_path: Path, room: World) -> None:
    """30 km x 300 m in the file: in millimetres it would be 30 cm high."""
    stretched = room.vertices_m.astype(np.float64) * [3000.0, 100.0, 100.0]
    with pytest.raises(InputError, match=r"looks like centimetres: --scale 0.01"):
        load_world(written(tmp_path / "mine.ply", stretched, room.triangles), 0, START)


def test_a_vertex_far_from_all_others_is_refused_and_one_that_no_triangle_uses_is_not(
    tmp_path: Path, room: World
) -> None:
    more = np.vstack([room.vertices_m.astype(np.float64), [500_000.0, 6_000_000.0, 0.0]])
    world = load_world(written(tmp_path / "unused.ply", more, room.triangles), 0, START)
    assert world.origin_m == (0.0, 0.0, 0.0)
    used = np.vstack([room.triangles, [0, 1, len(more) - 1]]).astype(np.int32)
    with pytest.raises(InputError, match="is a vertex far away from all others"):
        load_world(written(tmp_path / "used.ply", more, used), 0, START)


def test_with_a_scale_mesh_and_start_are_in_the_unit_of_the_file(tmp_path: Path, room: World) -> None:
    path = file_of(room, tmp_path / "mm.ply", 1000.0)
    world = load_world(path, 0, (3000.0, 1800.0, 1000.0, 0.5), Reading(scale=0.001))
    np.testing.assert_allclose(world.vertices_m, room.vertices_m, atol=1e-5)
    assert world.start == Pose(0.0, *START)
    assert any(remark.endswith("one unit being 0.001 m") for remark in world.remarks)


def test_y_up_is_turned_where_it_is_asked_for_and_hinted_at_where_it_is_likely(tmp_path: Path, room: World) -> None:
    on_its_side = room.vertices_m.astype(np.float64)[:, [0, 2, 1]] * [1, 1, -1]
    path = written(tmp_path / "side.ply", on_its_side, room.triangles)
    world = load_world(path, 0, START, Reading(up="y"))
    np.testing.assert_allclose(world.vertices_m, room.vertices_m, atol=1e-6)
    assert not any("--up" in remark for remark in world.remarks)
    assert world.remarks[0].endswith("the file's y being up")
    assert any("--up y" in remark for remark in load_world(path, 0, START).remarks)
    assert not any("--up" in remark for remark in load_world(file_of(room, tmp_path / "r.ply"), 0, START).remarks)


def test_the_extent_is_always_told(tmp_path: Path, room: World) -> None:
    world = load_world(file_of(room, tmp_path / "room.ply"), 0, START)
    assert world.remarks == (
        f"{len(room.triangles)} triangles, 10 x 7 x 2.7 m (x 0.00 to 10.00, y 0.00 to 7.00, z 0.00 to 2.70)",
    )


@pytest.mark.parametrize("reading", [{"scale": 0.0}, {"scale": -1.0}, {"scale": float("nan")}, {"cloud_voxel_m": 0.0}])
def test_a_reading_that_cannot_be_is_refused(reading: dict[str, float]) -> None:
    with pytest.raises(InputError, match="--"):
        Reading(**reading)  # type: ignore[arg-type]


def test_a_generated_mine_is_not_read() -> None:
    with pytest.raises(InputError, match="are for mesh files"):
        load_world("room", 0, None, Reading(scale=0.01))


class TestStart:
    """Where nothing is above it, a start is flown; where nothing is near it, the unit is wrong."""

    def opened(self, room: World) -> World:
        """The room without its roof."""
        roof = (room.vertices_m[room.triangles][:, :, 2] > 2.6).all(axis=1)
        return replace(room, triangles=room.triangles[~roof], start=Pose(0.0, *START))

    def test_an_open_top_is_told_and_accepted(self, room: World) -> None:
        world = self.opened(room)
        caster = RayCaster(world)
        assert world.start is not None
        check_start(world, caster, world.start, ROOM)
        assert remarks_on_start(world, caster) == (
            "no roof above the start: what is open to the sky is flown in as well",
        )
        closed = replace(room, start=Pose(0.0, *START))
        assert remarks_on_start(closed, RayCaster(closed)) == ()

    def test_a_mission_measures_everything_under_the_open_sky(self, room: World) -> None:
        """No reading above is none that is missing, and no place is passed over for want of a roof."""
        simulation = Simulation(self.opened(room), Settings(), seed=1)
        simulation.run(2.0)
        assert simulation.ended_because == "time limit"
        measurement = simulation.flights[0].measurement
        assert measurement is not None
        assert not measurement.missing
        assert simulation.truth.reach_m2 == pytest.approx(Simulation(room, Settings(), seed=1).truth.reach_m2, rel=0.1)
        assert any("no roof" in remark for remark in simulation.score()["remarks"])  # type: ignore[attr-defined]

    def test_a_start_on_top_of_a_closed_mine_is_told(self, room: World) -> None:
        world = replace(room, start=Pose(0.0, 3.0, 1.8, 9.0, 0.0))
        (remark,) = remarks_on_start(world, RayCaster(world))
        assert "2.7 m under the floor is another surface: is the start on top of the mine?" in remark

    def test_a_start_in_a_mesh_in_centimetres_is_refused_with_the_way_out(self, tmp_path: Path, room: World) -> None:
        """10 m in centimetres are 1000 m: no size that is refused, but from the start nothing could be seen."""
        world = load_world(file_of(room, tmp_path / "cm.ply", 100.0), 0, (300.0, 180.0, 100.0, 0.0))
        assert world.start is not None
        with pytest.raises(InputError, match=r"nearest surface is 100 m away.*--scale \(0.01 for centimetres"):
            check_start(world, RayCaster(world), world.start, ROOM)

    def test_where_nothing_has_a_roof_a_place_without_one_is_named(self, room: World) -> None:
        """Protects an open pit: the place that would do is under the sky as well, and in the file's coordinates."""
        world = replace(self.opened(room), origin_m=(500_000.0, 0.0, 0.0))
        with pytest.raises(InputError, match=r"would do: --start 50000\d\.\d\d "):
            check_start(world, RayCaster(world), Pose(0.0, 0.1, 1.8, 1.0, 0.0), ROOM)

    def test_a_start_outside_is_refused_in_the_coordinates_of_the_file(self, tmp_path: Path, room: World) -> None:
        path = file_of(room, tmp_path / "utm.ply", shift=(500_000.0, 6_000_000.0, 0.0))
        world = load_world(path, 0, (500_003.0, 6_000_009.0, 1.0, 0.0))
        assert world.start is not None
        with pytest.raises(InputError, match=r"start \(500003.00, 6000009.00, 1.00\).*x 500000.00 to 500010.00"):
            check_start(world, RayCaster(world), world.start, ROOM)
