"""Data sets of others: which image was taken where, and what cannot be."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from companion.errors import InputError
from companion.frames import AXES, flu_of_optical, z_up
from companion.geometry import angles_of_rotation, camera_to_world, rotation, rotation_of
from companion.mapping.datasets import FORMATS, Intrinsics, Listing, PosedImages
from companion.mapping.datasets.posed_images import read_depth
from tests.mapping.datasets import rooms


def _posed(listing: Listing, name: str, up: str | None = None) -> PosedImages:
    format_ = FORMATS[name]
    intrinsics = Intrinsics(0, 0, *rooms.OPTICS)
    return PosedImages(listing.images, intrinsics, True, format_.units_per_m, format_.no_return, 6.0, up or format_.up)


def _listing(name: str, folder: Path, within_s: float = 0.02) -> Listing:
    return FORMATS[name].listing(folder, within_s)


@pytest.mark.parametrize("name", ["tum", "7scenes"])
def test_each_image_looks_where_its_camera_did(name: str, tmp_path: Path) -> None:
    """Protects every sign and order on the way of a pose: the camera's axes in the room, also straight up and down."""
    folder = rooms.tum(tmp_path / "a") if name == "tum" else rooms.seven_scenes(tmp_path / "a")
    listing = _listing(name, folder)
    assert listing.left_out == {}
    frames = list(_posed(listing, name).frames())
    assert len(frames) == len(rooms.VIEWS_DEG)
    for frame, view in zip(frames, rooms.VIEWS_DEG, strict=True):
        turn = rooms.optical(*view)
        axes, place_m = camera_to_world(frame.camera, frame.pose)
        expected = np.stack([turn[:, 2], -turn[:, 0], -turn[:, 1]], axis=1)
        assert np.abs(axes - expected).max() < 1e-5
        assert np.abs(place_m - rooms.EYE_M).max() < 1e-6
        assert np.isnan(frame.depth_m[:2]).all()
        assert np.abs(frame.depth_m[2:] - rooms.depth_m(turn)[2:]).max() < 0.00051


@pytest.mark.parametrize("up", AXES)
def test_what_is_up_becomes_z(up: str) -> None:
    """Protects from a map that is mirrored or lies on its side: a turn that takes the named axis to z."""
    turn = z_up(up)
    axis = np.eye(3)["xyz".index(up[-1])] * (-1.0 if up.startswith("-") else 1.0)
    assert (turn @ axis == [0.0, 0.0, 1.0]).all()
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_a_pose_is_the_next_one_in_time(tmp_path: Path) -> None:
    """Protects the association: the nearer of two, whatever the order of the file; none beyond the bound."""
    (tmp_path / "depth.txt").write_text("10.00 a.png\n10.50 b.png\n11.02 c.png\n20 d.png\n")
    (tmp_path / "groundtruth.txt").write_text(
        "11.00 3 0 0 0 0 0 1\n10.015 1 0 0 0 0 0 1\n9.99 2 0 0 0 0 0 1 \n\n# end\n10.4 4 0 0 0 0 0 1\n"
    )
    listing = _listing("tum", tmp_path)
    assert [(image.path.name, image.position_m[0]) for image in listing.images] == [("a.png", 2.0), ("c.png", 3.0)]
    assert listing.left_out == {"have no pose within 0.02 s": 2}
    assert [image.path.name for image in _listing("tum", tmp_path, 0.2).images] == ["a.png", "b.png", "c.png"]
    with pytest.raises(
        InputError, match=r"depth.txt goes from 10.000 to 20.000 s, groundtruth.txt from 9.990 to 11.000 s"
    ):
        _listing("tum", tmp_path, 0.001)


@pytest.mark.parametrize(
    ("images", "poses", "says"),
    [
        ("1.0\n", "1 0 0 0 0 0 0 1\n", "depth.txt:1: '1.0', expected a time in s and the name of an image"),
        ("# x\nsoon a.png\n", "1 0 0 0 0 0 0 1\n", "depth.txt:2: 'soon a.png', expected finite numbers"),
        ("1 a.png\n", "\n1 0 0 0 0 0 1\n", "groundtruth.txt:2: '1 0 0 0 0 0 1', expected eight numbers"),
        ("1 a.png\n", "1 0 nan 0 0 0 0 1\n", "groundtruth.txt:1: '1 0 nan 0 0 0 0 1', expected finite numbers"),
        ("1 a.png\n", "1 0 0 0 0 0 0 0\n", "groundtruth.txt:1: '1 0 0 0 0 0 0 0', expected a quaternion"),
        ("# none\n", "1 0 0 0 0 0 0 1\n", "depth.txt: has no lines but comments"),
        (None, "1 0 0 0 0 0 0 1\n", "depth.txt: is not there; a sequence of TUM RGB-D has depth.txt"),
        ("1 a.png\n", None, "groundtruth.txt: is not there"),
    ],
)
def test_a_line_that_cannot_be_is_named(images: str | None, poses: str | None, says: str, tmp_path: Path) -> None:
    """Protects whoever has to correct a list: file, line, what stands there, what should."""
    for name, text in (("depth.txt", images), ("groundtruth.txt", poses)):
        if text is not None:
            (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as caught:
        _listing("tum", tmp_path)
    assert says in str(caught.value)


def test_images_of_7_scenes_without_a_pose_are_left_out(tmp_path: Path) -> None:
    """Protects sequences in which the tracking was lost, and such as are not complete: it is said."""
    folder = rooms.seven_scenes(tmp_path / "seq-01")
    (folder / "frame-000003.pose.txt").unlink()
    (folder / "frame-000004.pose.txt").write_text("nan nan nan nan\n" * 3 + "0 0 0 1\n")
    listing = _listing("7scenes", folder)
    assert len(listing.images) == len(rooms.VIEWS_DEG) - 2
    assert sorted(listing.left_out.values()) == [1, 1]
    with pytest.raises(InputError, match="it has the sequences seq-01, give one of them"):
        _listing("7scenes", tmp_path)


@pytest.mark.parametrize(
    ("pose", "says"),
    [
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n", "has 3 lines, expected a matrix of 4 x 4"),
        ("1 0 0\n" * 4, "pose.txt:1: '1 0 0', expected four numbers"),
        ("2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n", "stretches by 2 to 2"),
        ("1 0 0 0\n0 1 0 0\n0 0 -1 0\n0 0 0 1\n", "determinant -1"),
    ],
)
def test_a_pose_of_7_scenes_that_cannot_be_is_named(pose: str, says: str, tmp_path: Path) -> None:
    """Protects from a map that is scaled or mirrored by a pose of something else."""
    folder = rooms.seven_scenes(tmp_path / "a")
    (folder / "frame-000002.pose.txt").write_text(pose)
    with pytest.raises(InputError) as caught:
        _listing("7scenes", folder)
    assert says in str(caught.value)
    assert "frame-000002.pose.txt" in str(caught.value)


def test_images_that_cannot_be_are_named(tmp_path: Path) -> None:
    """Protects from pictures, previews and halves of images taken for depth."""
    from PIL import Image

    whole = tmp_path / "whole.png"
    rooms.png(whole, np.random.default_rng(1).uniform(0, 60000, (40, 50)))
    assert read_depth(whole).shape == (40, 50)
    (tmp_path / "cut.png").write_bytes(whole.read_bytes()[:1500])
    (tmp_path / "text.png").write_text("no image")
    Image.new("RGB", (50, 40)).save(tmp_path / "colour.png")
    Image.new("L", (50, 40)).save(tmp_path / "preview.png")
    Image.new("RGB", (50, 40)).save(tmp_path / "photo.png", format="JPEG")
    for name, says in (
        ("cut.png", "damaged"),
        ("text.png", "is no PNG image"),
        ("colour.png", "is a picture (RGB"),
        ("preview.png", "is a picture (L"),
        ("photo.png", "is no PNG image"),
        ("missing.png", "is not there, but listed"),
    ):
        with pytest.raises(InputError) as caught:
            read_depth(tmp_path / name)
        assert says in str(caught.value), name
        assert str(tmp_path / name) in str(caught.value)


def test_images_of_another_size_need_their_own_intrinsics(tmp_path: Path) -> None:
    """Protects from a room that is six times too wide: the format's focal length is for its own images."""
    listing = _listing("tum", rooms.tum(tmp_path / "a"))
    format_ = FORMATS["tum"]
    posed = PosedImages(listing.images, format_.intrinsics, False, 5000.0, (0,), 6.0, "z")
    with pytest.raises(
        InputError, match="is 96 x 72 px, the camera of this format has 640 x 480: say with --intrinsics"
    ):
        next(posed.frames())


def test_a_rotation_comes_back_from_its_angles() -> None:
    """Protects poses that look straight down, where yaw and roll are one, and quaternions of any length near 1."""
    rng = np.random.default_rng(4)
    angles = [*rng.uniform(-3.0, 3.0, (200, 3)).tolist(), [0.4, math.pi / 2.0, 0.9], [0.4, -math.pi / 2.0, 0.9]]
    for yaw_rad, pitch_rad, roll_rad in angles:
        matrix = rotation(yaw_rad, pitch_rad, roll_rad)
        assert np.abs(rotation(*angles_of_rotation(matrix)) - matrix).max() < 1e-9
        x, y, z, w = rooms.quaternion(matrix) * 1.2
        found = rotation_of((w, x, y, z))
        assert found is not None
        assert np.abs(found - matrix).max() < 1e-9
    assert rotation_of((math.nan, 0.0, 0.0, 1.0)) is None
    assert rotation_of((0.1, 0.0, 0.0, 0.1)) is None
    assert (flu_of_optical(np.eye(3)) == [[0, -1, 0], [0, 0, -1], [1, 0, 0]]).all()
