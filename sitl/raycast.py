"""Rays and distances in a world: the exact and slow way to measure it (Embree, through Open3D)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.worlds.model import World


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
        rays = np.concatenate(np.broadcast_arrays(*np.atleast_2d(origins, directions)), axis=1, dtype=np.float32)
        hits = self._scene.cast_rays(self._tensor(rays), nthreads=self._threads)
        ranges: NDArray[np.float32] = hits["t_hit"].numpy()
        return ranges

    def distance(self, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """The distance in m of each point (n, 3) to the nearest point of the surface: (n,), never negative."""
        query = self._tensor(np.ascontiguousarray(points, dtype=np.float32))
        distances: NDArray[np.float32] = self._scene.compute_distance(query, nthreads=self._threads).numpy()
        return distances
