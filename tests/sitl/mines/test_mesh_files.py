"""Every face of a mesh file comes in where it is, or is told, or the file is refused: for each format that is read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d
import pytest
import trimesh

from companion.errors import InputError
from sitl.mines import load_world
from sitl.scene.raycast import RayCaster
from tests.sitl.mines.meshes import BOX, QUADS, area_m2, box, is_the_box, world_of


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
