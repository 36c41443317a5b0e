"""What surfaces that are no plain rock give back to cameras and rangefinders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from companion.geometry import camera_to_world
from companion.model import Camera, Pose
from sitl.mines.conditions import NONE, Surface
from sitl.mines.model import World
from sitl.scene.raycast import RayCaster
from sitl.scene.render import DepthRenderer

Image = NDArray[np.float32]
Array = NDArray[np.float64]

RETURNED = {Surface.DARK: (0.0, 0.0), Surface.SHINY: (0.3, 0.1), Surface.WATER: (0.3, 0.2)}
"""The share of what falls on a surface that comes back from itself, and from what is mirrored in it; the rest is lost.

How much truly is depends on wavelength, angle and roughness; these are bad cases, not measured ones.
"""

IN_WATER = (0.0, 1.0)
"""The same for a camera over still water: it sees what is mirrored."""

_SAME_M = 1e-3
_LEAVING_M = 1e-3
_PATCH_PX = 8


class Echoes:
    """Images and ranges as they are where some triangles are no plain rock.

    Args:
        world: the world.
        surfaces: (m,) a `Surface` for each of its triangles.
        caster: casts rays in it.
        camera: takes the images.
    """

    def __init__(self, world: World, surfaces: NDArray[np.uint8], caster: RayCaster, camera: Camera) -> None:
        self._surfaces = surfaces
        self._caster = caster
        self._camera = camera
        kinds = [kind for kind in RETURNED if (surfaces == kind).any()]
        self._only = [
            (kind, DepthRenderer(replace(world, triangles=world.triangles[surfaces == kind], conditions=NONE), camera))
            for kind in kinds
        ]

    def image(self, pose: Pose, depth_m: Image, rng: np.random.Generator) -> Image:
        """The depth image from ``pose``; ``depth_m`` (height, width) is what plain rock would give."""
        seen = depth_m.copy()
        for kind, renderer in self._only:
            rows, columns = np.nonzero(renderer.render(pose) <= depth_m + _SAME_M)
            rows, columns = (part[np.isfinite(depth_m[rows, columns])] for part in (rows, columns))
            if len(rows) == 0:
                continue
            patches = rng.random((depth_m.shape[0] // _PATCH_PX + 1, depth_m.shape[1] // _PATCH_PX + 1))
            itself, mirrored = IN_WATER if kind is Surface.WATER else RETURNED[kind]
            drawn = patches[rows // _PATCH_PX, columns // _PATCH_PX]
            seen[rows[drawn >= itself], columns[drawn >= itself]] = np.nan
            by_mirror = (drawn >= itself) & (drawn < itself + mirrored)
            rows, columns = rows[by_mirror], columns[by_mirror]
            seen[rows, columns] = self._mirrored(pose, rows, columns, depth_m[rows, columns])
        return seen

    def ranges(self, origins_m: Array, directions: Array, ranges_m: Array, rng: np.random.Generator) -> Array:
        """Ranges (n,) along rays whose ranges in plain rock are ``ranges_m``; NaN where nothing comes back."""
        triangles, normals = self._caster.triangles_hit(origins_m, directions)
        hit = triangles < len(self._surfaces)
        kinds = np.where(hit, self._surfaces[np.where(hit, triangles, 0)], Surface.ROCK)
        seen = ranges_m.copy()
        for kind, (itself, mirrored) in RETURNED.items():
            of_kind = np.flatnonzero(kinds == kind)
            drawn = rng.random(len(of_kind))
            seen[of_kind[drawn >= itself]] = np.nan
            by_mirror = of_kind[(drawn >= itself) & (drawn < itself + mirrored)]
            seen[by_mirror] = ranges_m[by_mirror] + self._beyond(
                origins_m[by_mirror], directions[by_mirror], ranges_m[by_mirror], normals[by_mirror]
            )
        return seen

    def _mirrored(self, pose: Pose, rows: NDArray[np.int64], columns: NDArray[np.int64], depth_m: Image) -> Image:
        """Depths of what is seen in a mirror: as far behind it as it is before it."""
        axes, place = camera_to_world(self._camera, pose)
        camera = self._camera
        left = (camera.cx_px - columns) / camera.fx_px
        up = (camera.cy_px - rows) / camera.fy_px
        # Of length 1 along the optical axis, so that ranges in units of them are depths.
        directions = np.column_stack([np.ones(len(rows)), left, up]) @ axes.T
        origins = np.broadcast_to(place, directions.shape)
        _, normals = self._caster.triangles_hit(origins, directions)
        beyond = self._beyond(origins, directions, depth_m.astype(np.float64), normals)
        return np.asarray(depth_m + beyond, np.float32)

    def _beyond(self, origins_m: Array, directions: Array, ranges_m: Array, normals: Array) -> Array:
        """How far rays fly on after they were mirrored."""
        turned = directions - 2.0 * np.sum(directions * normals, axis=1, keepdims=True) * normals
        return np.asarray(
            self._caster.cast(origins_m + directions * ranges_m[:, None] + _LEAVING_M * turned, turned), np.float64
        )
