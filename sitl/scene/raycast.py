"""Rays and distances in a world: the exact and slow way to measure it (Embree, through Open3D)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sitl.mines.model import World

if TYPE_CHECKING:
    from open3d.core import Tensor


class RayCaster:
    """Casts rays against the surface of a world. Triangles are hit from both sides.

    Args:
        world: the world; its mesh is copied.
        threads: how many threads one call may use.
    """

    def __init__(self, world: World, threads: int = 1) -> None:
        import open3d  # takes 3 s: only those wait who cast rays

        self._threads = threads
        self._tensor = open3d.core.Tensor.from_numpy
        self._scene = open3d.t.geometry.RaycastingScene(nthreads=threads)
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(world.vertices_m, dtype=np.float32)),
            self._tensor(np.ascontiguousarray(world.triangles, dtype=np.uint32)),
        )

    def cast(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.float32]:
        """How far each ray flies before it meets the surface.

        Args:
            origins: (n, 3) or (3,) where the rays begin, in m; a single point serves all directions.
            directions: (n, 3) or (3,) where they go; need not be of length 1.

        Returns:
            (n,) ranges in units of the length of the direction; inf where nothing is hit.
        """
        hits = self._scene.cast_rays(self._rays(origins, directions), nthreads=self._threads)
        ranges: NDArray[np.float32] = hits["t_hit"].numpy()
        return ranges

    def triangles_hit(
        self, origins: NDArray[np.floating], directions: NDArray[np.floating]
    ) -> tuple[NDArray[np.uint32], NDArray[np.float64]]:
        """What each ray, as for `cast`, meets first.

        Returns:
            (n,) which triangle, a number beyond all of them where none is met, and (n, 3) its normal of length 1.
        """
        hits = self._scene.cast_rays(self._rays(origins, directions), nthreads=self._threads)
        return hits["primitive_ids"].numpy(), hits["primitive_normals"].numpy().astype(np.float64)

    def crossings(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.int32]:
        """How often each ray, as for `cast`, crosses the surface on its way to infinity: (n,)."""
        rays = self._rays(origins, directions)
        counts: NDArray[np.int32] = self._scene.count_intersections(rays, nthreads=self._threads).numpy()
        return counts

    def blocked(self, starts: NDArray[np.floating], ends: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Whether the surface crosses the straight way from each start to its end, (n, 3) or (3,) both: (n,)."""
        rays = self._rays(starts, np.subtract(ends, starts))
        crossed: NDArray[np.bool_] = self._scene.test_occlusions(rays, tfar=1.0, nthreads=self._threads).numpy()
        return crossed

    def distance(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """The distance in m of each point (n, 3) to the nearest point of the surface: (n,), never negative.

        To about 1 mm: beside triangles a hundred times as long as wide, single precision gives no more.
        """
        query = self._tensor(np.ascontiguousarray(points, dtype=np.float32))
        distances: NDArray[np.float32] = self._scene.compute_distance(query, nthreads=self._threads).numpy()
        return distances

    def _rays(self, origins: NDArray[np.floating], directions: NDArray[np.floating]) -> Tensor:
        """(n, 6) float32 as Embree wants them."""
        pairs = np.broadcast_arrays(*np.atleast_2d(origins, directions))
        return self._tensor(np.concatenate(pairs, axis=1, dtype=np.float32))
