"""What the worlds promise: closed, of the size that the paper gives them, the same every time, refused with reasons."""

from __future__ import annotations

import functools
import json
import struct
from pathlib import Path

import numpy as np
import open3d
import pytest
from numpy.typing import NDArray

from companion.errors import InputError
from companion.model import Pose
from sitl.mines import World, load_world
from sitl.mines.plan import extruded
from sitl.mines.random_mine import drawn_network
from sitl.scene.raycast import RayCaster
from sitl.scene.visibility import traveling_surface
from sitl.sim.nearest_start import Room
from sitl.sim.start import check_start

GENERATED = ("complex", "slope", "room", "random:0", "random:1")
SEEDS = range(21)
_DOWN, _UP = np.array([0.0, 0.0, -1.0]), np.array([0.0, 0.0, 1.0])


@functools.cache
def world_of(spec: str) -> World:
    return load_world(spec, seed=0)


@functools.cache
def caster_of(spec: str) -> RayCaster:
    return RayCaster(world_of(spec))


def open_edges(triangles: NDArray[np.int32]) -> int:
    """Directed edges that are not met by exactly one triangle from the other side."""
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    there = np.sort(edges @ [2**32, 1])
    back = np.sort(edges @ [1, 2**32])
    repeated = np.sum(np.diff(there) == 0)
    return int(repeated + len(np.setxor1d(there, back)))


def width_m(spec: str, x_m: float, y_m: float, z_m: float, bearing_rad: float) -> float:
    """Clear width through a point along a bearing."""
    along = np.array([np.cos(bearing_rad), np.sin(bearing_rad), 0.0])
    return float(caster_of(spec).cast(np.array([x_m, y_m, z_m]), np.stack([along, -along])).sum())


def heights_m(spec: str, points: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Free height below and above points."""
    caster = caster_of(spec)
    return caster.cast(points, _DOWN), caster.cast(points, _UP)


@pytest.mark.parametrize("spec", GENERATED)
def test_a_generated_world_is_closed(spec: str) -> None:
    assert open_edges(world_of(spec).triangles) == 0


@pytest.mark.parametrize("seed", range(5))
def test_any_plan_gives_a_closed_surface(seed: int) -> None:
    """Noise as a plan has all sixteen cases of marching squares, the two ambiguous ones among them."""
    rng = np.random.default_rng(seed)
    plan = rng.normal(size=(20, 30))
    plan[[0, -1]] = plan[:, [0, -1]] = -1.0
    shell = extruded(
        *(np.arange(20.0), np.arange(30.0)),
        lambda x, y: plan[x.astype(int), y.astype(int)],
        *(np.add, lambda x, y: 2.0 + 0.1 * (x - y) ** 2),
        wall_strips=3,
    )
    assert open_edges(shell.triangles) == 0


def test_triangles_of_generated_worlds_face_the_free_space() -> None:
    """The signed volume is that of the free space, negative because the triangles look inwards.

    The room by hand: 10 x 3.6 + 3.6 x 3.4 m of floor, 2.7 m high. Its five convex corners may lose 1 cm x 1 cm / 2.
    """
    corners = world_of("room").vertices_m[world_of("room").triangles].astype(np.float64)
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    assert -volume == pytest.approx((10.0 * 3.6 + 3.6 * 3.4) * 2.7, abs=6 * 0.01**2 / 2 * 2.7)


@pytest.mark.parametrize(
    ("x_m", "y_m", "bearing_rad"),
    [
        (6.0, 0.0, np.pi / 2),
        (12.0, 6.0, 0.0),
        (24.0, 30.0, 0.0),
        (24.0, -6.0, 0.0),
        (0.0, 9.0, 0.0),
        (42.0, 19.0, np.arctan2(10.0, -12.0) + np.pi / 2),
    ],
)
def test_drifts_of_complex_are_4_m_wide_and_3_m_high(x_m: float, y_m: float, bearing_rad: float) -> None:
    assert width_m("complex", x_m, y_m, 1.0, bearing_rad) == pytest.approx(4.0, abs=1e-3)
    below, above = heights_m("complex", np.array([[x_m, y_m, 1.0]]))
    assert below[0] + above[0] == pytest.approx(3.0, abs=1e-5)


def test_loops_of_complex_go_around_pillars_of_at_least_4_m() -> None:
    middles = np.array([[24.0, 6.0, 1.5], [24.0, 18.0, 1.5], [42.0, 8.0, 1.5]])
    below, _above = heights_m("complex", middles)
    assert np.isinf(below).all(), "a pillar's middle is in the rock"
    # Roof and floor are open above and below rock, so the nearest surface is the pillar's own wall.
    assert (caster_of("complex").distance(middles) >= 2.0).all()


def test_slope_has_flat_parts_and_ramps_of_15_degrees_and_is_3_m_high() -> None:
    world = world_of("slope")
    floor = world.start_area_m
    caster = caster_of("slope")
    below, above = caster.cast(floor + _UP, _DOWN), caster.cast(floor + _UP, _UP)
    np.testing.assert_allclose(below, 1.0, atol=1e-3)
    np.testing.assert_allclose(below + above, 3.0, atol=1e-3)
    corners = world.vertices_m[world.triangles].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    slopes_deg = np.rad2deg(np.arccos(np.clip(normals[normals[:, 2] > 0.5, 2], -1.0, 1.0)))
    assert set(slopes_deg.round(0).tolist()) == {0.0, 15.0}
    assert width_m("slope", 30.0, 0.0, 5.0, np.pi / 2) == pytest.approx(4.0, abs=1e-3)


def test_room_has_the_size_of_the_board_tunnel() -> None:
    assert width_m("room", 3.0, 1.8, 1.0, np.pi / 2) == pytest.approx(3.6, abs=1e-3)
    assert width_m("room", 3.0, 1.8, 1.0, 0.0) == pytest.approx(10.0, abs=1e-3)
    assert width_m("room", 8.2, 6.0, 1.0, np.pi / 2) == pytest.approx(7.0, abs=1e-3)
    below, above = heights_m("room", np.array([[8.2, 6.0, 1.0]]))
    assert below[0] + above[0] == pytest.approx(2.7, abs=1e-5)


@pytest.mark.parametrize("spec", GENERATED)
def test_start_points_lie_on_the_floor(spec: str) -> None:
    """Within 5 cm: a rough floor has moved sideways too, by up to 7 cm, at slopes that reach a half."""
    below, above = heights_m(spec, world_of(spec).start_area_m + _UP)
    np.testing.assert_allclose(below, 1.0, atol=0.05)
    assert np.isfinite(above).all()


def test_networks_are_as_long_as_promised_and_have_loops() -> None:
    for seed in range(300):
        network = drawn_network(np.random.default_rng(seed))
        assert 120.0 <= network.length_m <= 220.0, seed
        assert 1 <= network.loops <= 3, seed


@pytest.mark.parametrize("seed", SEEDS)
def test_a_random_mine_hangs_together_and_is_nowhere_too_narrow_or_low(seed: int) -> None:
    """A vehicle that keeps 1 m from walls reaches every point of every drift's middle."""
    spec = f"random:{seed}"
    floor = world_of(spec).start_area_m
    caster = caster_of(spec)
    assert open_edges(world_of(spec).triangles) == 0

    first = floor[0] + 1.2 * _UP
    surface = traveling_surface(caster, (first[0], first[1], first[2]), height_m=1.2, margin_m=1.0)
    # A point of a grid of 0.5 m is never further than 0.36 m away; near walls the next one may have to do.
    away = np.linalg.norm(floor[:, None, :2] - surface[None, :, :2], axis=2).min(axis=1)
    assert away.max() <= 0.36 + 0.5

    bearings = np.arange(36) * (np.pi / 36)
    fan = np.stack([np.cos(bearings), np.sin(bearings), np.zeros(36)], axis=1)
    middle = floor[::2] + 1.2 * _UP
    every = np.repeat(middle, 36, axis=0)
    clear = caster.cast(every, np.tile(fan, (len(middle), 1))) + caster.cast(every, np.tile(-fan, (len(middle), 1)))
    assert clear.min() >= 2.8
    below, above = heights_m(spec, floor + 1.2 * _UP)
    assert (below + above).min() >= 2.8 - 0.3
    assert (below + above).max() <= 3.6 + 0.3


def test_a_seed_draws_the_same_mine_every_time_and_another_seed_another_one() -> None:
    again = load_world("random", seed=1)
    np.testing.assert_array_equal(again.vertices_m, world_of("random:1").vertices_m)
    np.testing.assert_array_equal(again.triangles, world_of("random:1").triangles)
    assert again.name == "random:1"
    shapes = {world_of(f"random:{seed}").vertices_m.tobytes() for seed in SEEDS}
    assert len(shapes) == len(SEEDS)


def test_a_start_may_be_given_for_a_generated_world() -> None:
    assert world_of("room").start is None
    assert load_world("room", 0, (2.0, 1.8, 1.0, 0.5)).start == Pose(0.0, 2.0, 1.8, 1.0, 0.5)


def _write(path: Path) -> None:
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(world_of("room").vertices_m.astype(np.float64)),
        open3d.utility.Vector3iVector(world_of("room").triangles),
    )
    mesh.compute_triangle_normals()  # STL cannot be written without
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        assert open3d.io.write_triangle_mesh(path, mesh)


@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".off"])
def test_a_mesh_file_is_read_with_the_start_beside_it(tmp_path: Path, suffix: str) -> None:
    _write(tmp_path / f"mine{suffix}")
    start = json.dumps({"start": {"x": 2, "y": 1.8, "z": 1, "yaw": 0.5}})
    # With the byte order mark that editors on Windows put in front.
    (tmp_path / "mine.json").write_text(start, encoding="utf-8-sig" if suffix == ".stl" else "utf-8")
    world = load_world(str(tmp_path / f"mine{suffix}"), seed=0)
    assert world.name == "mine"
    assert len(world.triangles) == len(world_of("room").triangles)
    np.testing.assert_allclose(world.vertices_m.max(axis=0), [10.0, 7.0, 2.7], atol=1e-4)
    assert world.start == Pose(0.0, 2.0, 1.8, 1.0, 0.5)
    assert load_world(str(tmp_path / f"mine{suffix}"), 0, (3.0, 1.8, 1.0, 0.0)).start == Pose(0.0, 3.0, 1.8, 1.0, 0.0)


def test_a_glb_file_is_turned_from_y_up_to_z_up(tmp_path: Path) -> None:
    """A tetrahedron that is 3 m high along the file's y axis."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 3, 0], [0, 0, 2]], dtype=np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.uint16)
    content = faces.tobytes() + points.tobytes()
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5123, "count": 12, "type": "SCALAR"},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 3, 2]},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 24}, {"buffer": 0, "byteOffset": 24, "byteLength": 48}],
        "buffers": [{"byteLength": len(content)}],
    }
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(content), b"BIN\0") + content
    (tmp_path / "cave.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    world = load_world(str(tmp_path / "cave.glb"), 0, (0.1, -0.1, 0.1, 0.0))
    np.testing.assert_allclose(world.vertices_m.min(axis=0), [0.0, -2.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(world.vertices_m.max(axis=0), [1.0, 0.0, 3.0], atol=1e-6)


PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
FACE = "element face 1\nproperty list uchar int vertex_indices\n"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("gone.ply", None, "there is no such file"),
        ("notes.txt", "hello", "give one of .ply, .stl, .obj, .off, .glb"),
        ("empty.ply", "", "damaged"),
        ("empty.stl", "", "no mesh can be read"),
        ("junk.ply", "hello", "damaged"),
        ("junk.glb", "hello", "no mesh can be read"),
        ("cloud.ply", PLY + "end_header\n0 0 0\n1 0 0\n0 1 0\n", "no triangles (3 points)"),
        ("cut.ply", PLY + FACE + "end_header\n0 0 0\n1 0 0\n0 1 0\n", "damaged"),
        ("nan.ply", PLY + FACE + "end_header\n0 0 0\n1 0 nan\n0 1 0\n3 0 1 2\n", "1 of 3 vertices are not finite"),
        ("index.ply", PLY + FACE + "end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", "names vertex 7 of only 3"),
    ],
)
def test_a_mesh_that_cannot_be_used_is_refused_with_its_name_and_the_reason(
    tmp_path: Path, name: str, content: str | None, says: str, capfd: pytest.CaptureFixture[str]
) -> None:
    """And with nothing else on the terminal: the libraries below have messages of their own."""
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError) as refused:
        load_world(str(tmp_path / name), 0, (0.0, 0.0, 1.0, 0.0))
    assert name in str(refused.value)
    assert says in str(refused.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("beside", "says"),
    [
        (None, "Give a start"),
        ("{", "cannot be read"),
        ("[]", "expected"),
        ('{"start": {"x": 1, "y": 2, "z": 3}}', "expected"),
        ('{"start": {"x": 1, "y": 2, "z": "high", "yaw": 0}}', "cannot be read"),
        ('{"start": {"x": 1, "y": 2, "z": NaN, "yaw": 0}}', "finite"),
        ("\ufeff[]", "expected"),
    ],
)
def test_a_mesh_without_a_usable_start_is_refused_with_the_way_out(
    tmp_path: Path, beside: str | None, says: str
) -> None:
    _write(tmp_path / "mine.ply")
    if beside is not None:
        (tmp_path / "mine.json").write_text(beside, encoding="utf-8")
    with pytest.raises(InputError, match=says):
        load_world(str(tmp_path / "mine.ply"), seed=0)


@pytest.mark.parametrize("spec", ["Complex", "random:", "random:x", "random:-1", "complex:1", ""])
def test_an_unknown_world_is_refused(spec: str) -> None:
    with pytest.raises(InputError, match="world"):
        load_world(spec, seed=0)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(InputError, match="seed -1"):
        load_world("random", seed=-1)


@pytest.mark.parametrize(
    ("x_m", "y_m", "z_m", "says"),
    [
        (3.0, 0.2, 1.0, "the nearest surface is 0.20 m away, the vehicle needs 0.30 m"),
        (3.0, 5.0, 1.0, "no floor below"),
        (3.0, 1.8, -1.0, "no floor below"),
    ],
)
def test_a_start_in_the_wall_or_outside_is_refused(x_m: float, y_m: float, z_m: float, says: str) -> None:
    with pytest.raises(InputError, match=says):
        check_start(world_of("room"), caster_of("room"), Pose(0.0, x_m, y_m, z_m, 0.0), Room(0.3, 1.0, 0.5))


def test_a_start_with_room_around_it_is_accepted() -> None:
    check_start(world_of("room"), caster_of("room"), Pose(0.0, 3.0, 1.8, 1.0, 0.0), Room(0.9, 1.0, 0.5))
