"""Depth images in 16-bit PNG files, and the pose at which each was taken, as depth frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.errors import InputError
from companion.frames import flu_of_optical, z_up
from companion.geometry import angles_of_rotation
from companion.model import Camera, DepthFrame, FloatArray, Pose

_DEEP = ("I;16", "I;16B", "I")
"""What Pillow calls the images of 16 bits without colours."""


class Intrinsics(NamedTuple):
    """A pinhole camera: pixel (u, v) looks along ((u - cx) / fx, (v - cy) / fy, 1); all in px."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


class PosedImage(NamedTuple):
    """A depth image and where its camera was.

    Attributes:
        path: of the image.
        t_s: when it was taken.
        rotation: (3, 3) from the camera's optical frame (x right, y down, z forward) to the world.
        position_m: (3,) of the camera in the world.
    """

    path: Path
    t_s: float
    rotation: NDArray[np.float64]
    position_m: FloatArray


class Listing(NamedTuple):
    """The images of a data set.

    Attributes:
        images: in their order.
        left_out: why images were left out, and how many; empty when none was.
    """

    images: list[PosedImage]
    left_out: dict[str, int]


@dataclass(frozen=True, slots=True)
class PosedImages:
    """A data set as depth frames.

    Attributes:
        images: what it holds.
        intrinsics: of the camera.
        any_size: whether they hold for images of every size, since somebody gave them for these.
        units_per_m: what the images count in.
        no_return: readings that say that nothing was measured.
        max_range_m: depth from which on a reading only says that it is free up to there.
        up: the axis of the data set's world that points up: x, y, z, -x, -y or -z. It becomes z.
    """

    images: list[PosedImage]
    intrinsics: Intrinsics
    any_size: bool
    units_per_m: float
    no_return: tuple[int, ...]
    max_range_m: float
    up: str

    def frames(self) -> Iterator[DepthFrame]:
        """The images one after the other, each read when it is asked for.

        Raises:
            InputError: one cannot be read, is no depth image, or of another size than the camera's.
            ModuleNotFoundError: Pillow is not installed.
        """
        turn = z_up(self.up)
        for image in self.images:
            units = read_depth(image.path)
            depth_m = units.astype(np.float32) / np.float32(self.units_per_m)
            depth_m[np.isin(units, self.no_return)] = np.nan
            x_m, y_m, z_m = (turn @ image.position_m).tolist()
            yaw_rad, pitch_rad, roll_rad = angles_of_rotation(flu_of_optical(turn @ image.rotation))
            pose = Pose(image.t_s, x_m, y_m, z_m, yaw_rad, roll_rad, pitch_rad)
            yield DepthFrame(image.t_s, depth_m, self._camera(image.path, units), pose)

    def _camera(self, path: Path, units: NDArray[np.uint16]) -> Camera:
        (height, width), optics = units.shape, self.intrinsics
        if not self.any_size and (width, height) != (optics.width, optics.height):
            raise InputError(
                f"{path}: is {width} x {height} px, the camera of this format has {optics.width} x {optics.height}: "
                "say with --intrinsics FX FY CX CY what these images were taken with, in px"
            )
        # What is too near the sensor says itself, by a reading of 0.
        return Camera(width, height, optics.fx, optics.fy, optics.cx, optics.cy, 0.0, self.max_range_m)


def read_depth(path: Path) -> NDArray[np.uint16]:
    """(height, width) of a 16-bit PNG.

    Raises:
        InputError: it cannot be read, or is none.
        ModuleNotFoundError: Pillow is not installed.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path, formats=["PNG"]) as image:
            if image.mode not in _DEEP:
                raise InputError(
                    f"{path}: is a picture ({image.mode}, as Pillow calls it) and no depth image, which has 16 bits "
                    "and no colours: a preview? Give the images as they were recorded"
                )
            return np.asarray(image).astype(np.uint16)
    except FileNotFoundError:
        raise InputError(
            f"{path}: is not there, but listed: get the data set again, or take it out of the list"
        ) from None
    except (UnidentifiedImageError, SyntaxError, ValueError, Image.DecompressionBombError):
        raise InputError(f"{path}: is no PNG image, or damaged; get it again") from None
    except OSError as error:
        # Pillow has no other word for a file that ends too early.
        why = error.strerror or "it is damaged or cut off"
        raise InputError(f"{path}: cannot be read: {why}; get it again") from None
