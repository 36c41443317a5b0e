"""Every face of a mesh file comes in where it is, or is told, or the file is refused: for each format that is read."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import open3d
import pytest
import trimesh
from numpy.typing import NDArray

from companion.errors import InputError
from sitl.mines import World, load_world
from sitl.mines.mesh import open_edges
from sitl.scene.raycast import RayCaster

BOX = "v 0 0 0\nv 10 0 0\nv 10 4 0\nv 0 4 0\nv 0 0 3\nv 10 0 3\nv 10 4 3\nv 0 4 3\n"
QUADS = "f 1 2 3 4\nf 5 8 7 6\nf 1 5 6 2\nf 2 6 7 3\nf 3 7 8 4\nf 4 8 5 1\n"


def box() -> trimesh.Trimesh:
    """A closed room of 10 x 4 x 3 m with one corner at 0."""
    mesh: trimesh.Trimesh = trimesh.creation.box((10, 4, 3))
    mesh.apply_translation((5.0, 2.0, 1.5))
    return mesh


def world_of(path: Path, content: str | bytes) -> World:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return load_world(str(path), 0, (5.0, 2.0, 1.5, 0.0))


def area_m2(world: World) -> float:
    corners = world.vertices_m[world.triangles].astype(np.float64)
    crossed = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(crossed, axis=1).sum() / 2)


def is_open(world: World) -> int:
    return open_edges(world.vertices_m.astype(np.float64), world.triangles.astype(np.int64))


def is_the_box(world: World) -> bool:
    """Whether it is closed and has the size and the surface of the box."""
    low, high = world.vertices_m.min(axis=0), world.vertices_m.max(axis=0)
    same = np.allclose([*low, *high], [0, 0, 0, 10, 4, 3], atol=1e-5)
    return bool(same and is_open(world) == 0 and np.isclose(area_m2(world), 2 * (40 + 30 + 12), atol=1e-3))


class TestObj:
    """OBJ, in double precision, faces of any number of corners."""

    def test_faces_with_four_corners_are_two_triangles(self, tmp_path: Path) -> None:
        assert is_the_box(world_of(tmp_path / "box.obj", BOX + QUADS))

    def test_quads_beside_triangles_and_indices_of_texture_and_normal(self, tmp_path: Path) -> None:
        faces = QUADS.replace("f 1 2 3 4\n", "f 1/1/1 2//1 3/2\nf 1 3 4\n")
        assert is_the_box(world_of(tmp_path / "box.obj", BOX + "vt 0 0\nvt 1 0\nvn 0 0 1\n" + faces))

    def test_negative_indices_count_back_from_the_vertex_read_last(self, tmp_path: Path) -> None:
        """With more vertices after the faces, as in files of several objects."""
        sides = "".join("f" + "".join(f" {int(i) - 9}" for i in line.split()[1:]) + "\n" for line in QUADS.splitlines())
        world = world_of(
            tmp_path / "box.obj", f"o room\n{BOX}{sides}o other\nv 1 1 1\nv 1 1 1.1\nv 1 1.1 1\nf -3 -2 -1\n"
        )
        assert len(world.triangles) == 13
        assert area_m2(world) == pytest.approx(164.0 + 0.005, abs=1e-4)

    def test_a_wall_around_a_doorway_leaves_the_doorway_open(self, tmp_path: Path) -> None:
        """One face of eight corners: a fan from its first corner would shut the door."""
        wall = "v 5 0 0\nv 5 1 0\nv 5 1 2\nv 5 3 2\nv 5 3 0\nv 5 4 0\nv 5 4 3\nv 5 0 3\nf 9 10 11 12 13 14 15 16\n"
        world = world_of(tmp_path / "box.obj", BOX + QUADS + wall)
        caster = RayCaster(world)
        through = caster.cast(np.array([[2.0, 2.0, 1.0], [2.0, 0.5, 1.0], [2.0, 2.0, 2.5]]), np.array([1.0, 0.0, 0.0]))
        np.testing.assert_allclose(through, [8.0, 3.0, 3.0], atol=1e-5)
        assert area_m2(world) == pytest.approx(164.0 + 12.0 - 4.0, abs=1e-3)

    def test_lines_points_and_surfaces_that_are_left_out_are_told(self, tmp_path: Path) -> None:
        world = world_of(tmp_path / "box.obj", BOX + QUADS + "l 1 2 3\nl 2 3\np 1\nf 1 2\ncurv 0 1 1 2\n")
        assert {"2 lines are left out", "1 points are left out", "1 statements 'curv' are left out"} < set(
            world.remarks
        )
        assert "1 faces with fewer than three corners are left out" in world.remarks

    def test_lines_that_go_on_line_ends_of_windows_and_colours_are_read(self, tmp_path: Path) -> None:
        text = BOX.replace("v 0 0 0\n", "v 0 0 0 0.5 0.5 0.5\n") + QUADS.replace("f 1 2 3 4", "f 1 2 \\\n3 4")
        assert is_the_box(world_of(tmp_path / "box.obj", text.replace("\n", "\r\n")))

    @pytest.mark.parametrize(
        ("faces", "says"),
        [
            ("f 1 2 9\n", "vertex 9 of only 8"),
            ("f 1 2 -9\n", "of only 8"),
            ("f 0 1 2\n", "vertex 0"),
            ("f 1 2 x\n", "cannot be read"),
            ("v 1 2\nf 1 2 3\n", "line of a vertex"),
        ],
    )
    def test_faces_and_vertices_that_cannot_be_are_refused(self, tmp_path: Path, faces: str, says: str) -> None:
        with pytest.raises(InputError, match=says):
            world_of(tmp_path / "box.obj", BOX + faces)

    def test_a_file_that_was_cut_off_tells_how_open_it_is(self, tmp_path: Path) -> None:
        """OBJ has no count of faces: a cut at the end of a line cannot be told from a whole file."""
        world = world_of(tmp_path / "box.obj", BOX + QUADS.rsplit("f", 1)[0])
        assert "the surface is open: 4 of its edges have a triangle on one side only" in world.remarks


class TestStl:
    """STL, which as text has to end, and as binary may have more behind it."""

    def text(self) -> str:
        text: str = trimesh.exchange.stl.export_stl_ascii(box())
        return text

    def test_text_and_binary_are_the_box(self, tmp_path: Path) -> None:
        assert is_the_box(world_of(tmp_path / "a.stl", self.text()))
        assert is_the_box(world_of(tmp_path / "b.stl", trimesh.exchange.stl.export_stl(box())))
        two = self.text() + self.text().replace("vertex ", "vertex  ").upper()
        assert len(world_of(tmp_path / "c.stl", two).triangles) == 24

    @pytest.mark.parametrize("share", [0.3, 0.5, 0.9])
    def test_text_that_was_cut_is_refused(self, tmp_path: Path, share: float) -> None:
        text = self.text()
        with pytest.raises(InputError, match="its end is missing"):
            world_of(tmp_path / "a.stl", text[: int(len(text) * share)])

    def test_text_with_a_triangle_of_two_corners_is_refused(self, tmp_path: Path) -> None:
        lines = self.text().splitlines()
        del lines[next(k for k, line in enumerate(lines) if "vertex" in line)]
        with pytest.raises(InputError, match="12 triangles with 35 corners"):
            world_of(tmp_path / "a.stl", "\n".join(lines))

    def test_bytes_after_the_last_triangle_are_told_and_left_out(self, tmp_path: Path) -> None:
        world = world_of(tmp_path / "b.stl", trimesh.exchange.stl.export_stl(box()) + b"trailing")
        assert is_the_box(world)
        assert "8 bytes after the last triangle are left out" in world.remarks

    def test_binary_far_from_0_is_refused_because_its_numbers_are_too_coarse(self, tmp_path: Path) -> None:
        far = box().apply_translation((500_000, 6_000_000, 0))
        with pytest.raises(InputError, match=r"steps of 0.5 m so far from 0.*double precision"):
            world_of(tmp_path / "far.stl", trimesh.exchange.stl.export_stl(far))
        text = trimesh.exchange.stl.export_stl_ascii(far)
        (tmp_path / "far.stl").write_text(text)
        world = load_world(str(tmp_path / "far.stl"), 0, (500_005.0, 6_000_002.0, 1.5, 0.0))
        assert is_the_box(world)

    def test_a_count_of_zero_is_told_and_the_triangles_are_read(self, tmp_path: Path) -> None:
        data = bytearray(trimesh.exchange.stl.export_stl(box()))
        data[80:84] = bytes(4)
        world = world_of(tmp_path / "b.stl", bytes(data))
        assert is_the_box(world)
        assert any("holds no triangles, and holds 12" in remark for remark in world.remarks)

    def test_binary_that_was_cut_is_refused_also_where_it_calls_itself_solid(self, tmp_path: Path) -> None:
        data = bytearray(trimesh.exchange.stl.export_stl(box()))
        data[:12] = b"solid facet "
        assert is_the_box(world_of(tmp_path / "b.stl", bytes(data)))
        with pytest.raises(InputError, match="should hold 12 triangles and ends after 10"):
            world_of(tmp_path / "b.stl", bytes(data[:600]))


class TestPly:
    """PLY with faces of four corners, strips, cuts."""

    HEAD = "ply\nformat ascii 1.0\nelement vertex 8\nproperty double x\nproperty double y\nproperty double z\n"
    POINTS = BOX.replace("v ", "")

    def test_faces_with_four_corners(self, tmp_path: Path) -> None:
        quads = "".join("4" + "".join(f" {int(i) - 1}" for i in q.split()[1:]) + "\n" for q in QUADS.splitlines())
        face = "element face 6\nproperty list uchar int vertex_index\nend_header\n"
        assert is_the_box(world_of(tmp_path / "box.ply", self.HEAD + face + self.POINTS + quads))

    def test_strips_are_refused_with_the_way_to_convert(self, tmp_path: Path) -> None:
        strips = "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
        with pytest.raises(InputError, match=r"strips.*MeshLab"):
            world_of(tmp_path / "box.ply", self.HEAD + strips + self.POINTS + "5 0 1 2 3 4\n")

    def test_single_precision_far_from_0_is_refused_and_double_is_not(self, tmp_path: Path) -> None:
        far = box().apply_translation((5e5, 6e6, 0.0))
        mesh = open3d.geometry.TriangleMesh(
            open3d.utility.Vector3dVector(far.vertices), open3d.utility.Vector3iVector(far.faces.astype(np.int32))
        )
        assert open3d.io.write_triangle_mesh(tmp_path / "double.ply", mesh)
        assert is_the_box(load_world(str(tmp_path / "double.ply"), 0, (500_005.0, 6_000_002.0, 1.5, 0.0)))
        with pytest.raises(InputError, match=r"steps of 0.5 m so far from 0"):
            world_of(tmp_path / "single.ply", trimesh.exchange.ply.export_ply(far))

    def test_a_binary_file_that_was_cut_is_refused(self, tmp_path: Path) -> None:
        data = trimesh.exchange.ply.export_ply(box())
        assert is_the_box(world_of(tmp_path / "box.ply", data))
        for share in (0.5, 0.8, 0.99):
            with pytest.raises(InputError, match="damaged"):
                world_of(tmp_path / "box.ply", data[: int(len(data) * share)])


class TestOff:
    """OFF with faces of any number of corners, and what may stand behind them."""

    QUADS = "".join("4" + "".join(f" {int(i) - 1}" for i in q.split()[1:]) + "\n" for q in QUADS.splitlines())

    def test_quads_colours_comments_and_counts_in_the_first_line(self, tmp_path: Path) -> None:
        points = BOX.replace("v ", "")
        assert is_the_box(world_of(tmp_path / "a.off", "OFF\n8 6 0\n" + points + self.QUADS))
        coloured = self.QUADS.replace("\n", " 0.5 0.5 1 # wall\n")
        assert is_the_box(world_of(tmp_path / "b.off", "# a room\nOFF 8 6 12\n\n" + points + coloured))
        with_colour = points.replace("\n", " 255 0 0 255\n")
        assert is_the_box(world_of(tmp_path / "c.off", "COFF\r\n8 6 0\r\n" + with_colour + self.QUADS))

    def test_coordinates_far_away_keep_their_digits(self, tmp_path: Path) -> None:
        (tmp_path / "far.off").write_text(trimesh.exchange.off.export_off(box().apply_translation((5e5, 6e6, 0))))
        world = load_world(str(tmp_path / "far.off"), 0, (500_005.0, 6_000_002.0, 1.5, 0.0))
        assert is_the_box(world)

    @pytest.mark.parametrize(
        ("text", "says"),
        [
            (QUADS.rsplit("\n", 2)[0], "should hold 8 vertices and 6 faces and ends after 13 lines"),
            (QUADS.replace("4 0 1", "4 0 99"), "names vertex 99 of only 8"),
            (QUADS.replace("4 0 1", "5 0 1", 1), "fewer vertices than it says"),
            (QUADS.replace("4 0 1", "4 0 -1", 1), "a negative one"),
            (QUADS.replace("4 0 1", "4 0 x", 1), "cannot be read"),
        ],
    )
    def test_what_is_damaged_is_refused(self, tmp_path: Path, text: str, says: str) -> None:
        with pytest.raises(InputError, match=says):
            world_of(tmp_path / "a.off", "OFF\n8 6 0\n" + BOX.replace("v ", "") + text)


class TestGltf:
    """glTF with several nodes."""

    def scene(self) -> trimesh.Scene:
        """Two halves of the box, y up, in nodes of their own: one moved, the other turned about and moved."""
        half = trimesh.creation.box((5, 3, 4))
        turned = trimesh.transformations.rotation_matrix(np.pi, (0, 1, 0))
        turned[:3, 3] = (7.5, 1.5, -2.0)
        scene = trimesh.Scene()
        scene.add_geometry(half, transform=trimesh.transformations.translation_matrix((2.5, 1.5, -2.0)))
        scene.add_geometry(half, transform=turned)
        return scene

    @pytest.mark.parametrize("suffix", [".glb", ".gltf"])
    def test_every_node_is_at_its_place_and_y_is_up(self, tmp_path: Path, suffix: str) -> None:
        self.scene().export(tmp_path / f"two{suffix}")
        world = load_world(str(tmp_path / f"two{suffix}"), 0, (2.0, 2.0, 1.5, 0.0))
        low, high = world.vertices_m.min(axis=0), world.vertices_m.max(axis=0)
        np.testing.assert_allclose([*low, *high], [0, 0, 0, 10, 4, 3], atol=1e-5)
        assert area_m2(world) == pytest.approx(164.0 + 24.0, abs=1e-3)

    def test_a_part_near_0_on_a_node_far_away_keeps_its_digits(self, tmp_path: Path) -> None:
        scene = trimesh.Scene()
        place = trimesh.transformations.translation_matrix((6_000_000.0, 0.25, -500_000.0))
        scene.add_geometry(trimesh.creation.box((10, 3, 4)), transform=place)
        scene.export(tmp_path / "far.glb")
        world = load_world(str(tmp_path / "far.glb"), 0, (6_000_000.0, 500_000.0, 0.0, 0.0))
        assert world.origin_m == (6_000_000.0, 500_000.0, 0.0)
        np.testing.assert_allclose(world.vertices_m.min(axis=0), [-5.0, -2.0, -1.25], atol=1e-6)

    def changed(self, **more: object) -> bytes:
        data: bytes = self.scene().export(file_type="glb")
        size = struct.unpack_from("<I", data, 12)[0]
        header = {**json.loads(data[20 : 20 + size]), **more}
        text = json.dumps(header).encode()
        text += b" " * (-len(text) % 4)
        body = struct.pack("<I4s", len(text), b"JSON") + text + data[20 + size :]
        return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body

    def test_a_compression_that_is_not_read_is_named_with_the_way_out(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"needs KHR_draco_mesh_compression.*Blender"):
            world_of(tmp_path / "a.glb", self.changed(extensionsRequired=["KHR_draco_mesh_compression"]))

    def test_animations_are_told(self, tmp_path: Path) -> None:
        world = world_of(tmp_path / "a.glb", self.changed(animations=[{"channels": [], "samplers": []}]))
        assert any(remark.startswith("animations are left out") for remark in world.remarks)

    def test_a_file_that_was_cut_or_whose_other_half_is_missing_is_refused(self, tmp_path: Path) -> None:
        data: bytes = self.scene().export(file_type="glb")
        with pytest.raises(InputError, match="ends after"):
            world_of(tmp_path / "a.glb", data[:-100])
        self.scene().export(tmp_path / "two.gltf")
        for buffer in tmp_path.glob("*.bin"):
            buffer.unlink()
        with pytest.raises(InputError, match="no mesh can be read"):
            load_world(str(tmp_path / "two.gltf"), 0, (2.0, 2.0, 1.5, 0.0))


def collada(up: str, unit_m: float, faces: str, matrix: str, points: NDArray[np.float64]) -> str:
    """A Collada file with one mesh, under a node with ``matrix``."""
    numbers = " ".join(f"{value:.17g}" for value in points.ravel())
    return f"""<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2020-01-01T00:00:00</created><modified>2020-01-01T00:00:00</modified>
<unit name="u" meter="{unit_m}"/><up_axis>{up}</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="{points.size}">{numbers}</float_array>
<technique_common><accessor source="#pa" count="{len(points)}" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
{faces}
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node id="n"><matrix>{matrix}</matrix>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


class TestCollada:
    """Collada with a unit and an axis of its own, and several kinds of faces."""

    CORNERS = np.array([[float(x) for x in line.split()[1:]] for line in BOX.splitlines()])
    INDICES = " ".join(str(int(i) - 1) for line in QUADS.splitlines() for i in line.split()[1:])
    QUADS = f"""<polylist count="6"><input semantic="VERTEX" source="#v" offset="0"/>
<vcount>4 4 4 4 4 4</vcount><p>{INDICES}</p></polylist>"""
    HERE = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"

    def test_unit_axis_and_place_of_the_node_are_as_the_file_says(self, tmp_path: Path) -> None:
        """Centimetres, y up, and a node that puts it 2 m along x and back 4 m along its z."""
        y_up = self.CORNERS[:, [0, 2, 1]] * [100.0, 100.0, -100.0]
        world = world_of(
            tmp_path / "a.dae", collada("Y_UP", 0.01, self.QUADS, "1 0 0 200 0 1 0 0 0 0 1 400 0 0 0 1", y_up)
        )
        low, high = world.vertices_m.min(axis=0), world.vertices_m.max(axis=0)
        np.testing.assert_allclose([*low, *high], [2, -4, 0, 12, 0, 3], atol=1e-5)
        assert is_open(world) == 0
        assert any("one unit being 0.01 m" in remark for remark in world.remarks)

    def test_triangles_and_polygons_z_up_in_metres(self, tmp_path: Path) -> None:
        corners = self.INDICES.split()
        quads = [corners[k : k + 4] for k in range(0, 24, 4)]
        cut = " ".join(" ".join([*q[:3], q[0], *q[2:]]) for q in quads[:3])
        faces = f"""<triangles count="6"><input semantic="VERTEX" source="#v" offset="0"/><p>{cut}</p></triangles>
<polygons count="3"><input semantic="VERTEX" source="#v" offset="0"/>
{"".join(f"<p>{' '.join(q)}</p>" for q in quads[3:])}</polygons>
<lines count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1</p></lines>"""
        world = world_of(tmp_path / "a.dae", collada("Z_UP", 1.0, faces, self.HERE, self.CORNERS))
        assert is_the_box(world)
        assert "1 groups of lines are left out" in world.remarks

    def test_coordinates_far_away_keep_their_digits(self, tmp_path: Path) -> None:
        """The library reads single precision, of which at 6,000 km half a metre is left."""
        far = self.CORNERS + np.array([500_000.0, 6_000_000.0, 0.25])
        path = tmp_path / "a.dae"
        path.write_text(collada("Z_UP", 1.0, self.QUADS, self.HERE, far), encoding="utf-8")
        world = load_world(str(path), 0, (500_005.0, 6_000_002.0, 1.5, 0.0))
        np.testing.assert_allclose(world.vertices_m, self.CORNERS + np.array([0, 0, 0.25]), atol=1e-5)

    @pytest.mark.parametrize(
        ("old", "new", "says"),
        [
            ("</COLLADA>", "", "no mesh can be read"),
            (">0 0 0", ">nan 0 0", "not finite"),
            ("<p>0 1", "<p>0 99", "maxindex=99"),
            ("<p>0 1", "<p>0 -1", "-1"),
            ('<scene><instance_visual_scene url="#s"/></scene>', "", "scene"),
        ],
    )
    def test_what_is_damaged_is_refused(self, tmp_path: Path, old: str, new: str, says: str) -> None:
        text = collada("Z_UP", 1.0, self.QUADS, self.HERE, self.CORNERS)
        assert old in text
        with pytest.raises(InputError, match=says):
            world_of(tmp_path / "a.dae", text.replace(old, new, 1))
