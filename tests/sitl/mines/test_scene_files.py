"""Files of whole scenes: every node at its place, in the unit and with the axis that the file names."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from companion.errors import InputError
from sitl.mines import load_world
from tests.sitl.mines.meshes import BOX, QUADS, area_m2, is_the_box, open_edges_of, world_of


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
        assert open_edges_of(world) == 0
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
