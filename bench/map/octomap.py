"""OctoMap beside which our map is put: with its own rays and nodes, and with rays that end where ours end."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.map import frames as map_frames
from companion.compiled import compiled
from companion.model import DepthFrame

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

OCTOMAP_KEY = 2**15
"""OctoMap counts voxels from the lowest corner of its cube; ours count from the middle of it."""

LEVELS = 16
"""Of OctoMap's tree."""


def octree(voxel_m: float) -> Any:
    """An empty OctoMap with its default sensor model."""
    import octomap

    tree = octomap.OcTree(voxel_m)
    settings = map_frames.octomap_model(voxel_m)
    tree.setProbHit(settings.hit_probability)
    tree.setProbMiss(settings.miss_probability)
    tree.setClampingThresMin(settings.clamp_min_probability)
    tree.setClampingThresMax(settings.clamp_max_probability)
    tree.setOccupancyThres(settings.occupied_probability)
    return tree


def voxels_of(points_m: Floats, voxel_m: float) -> Integers:
    """(n, 3) the voxel of each point as OctoMap finds it: points are of single precision there."""
    return np.floor(points_m.astype(np.float32).astype(np.float64) / voxel_m).astype(np.int64)


def packed(voxels: Integers) -> Integers:
    """(n,) one number for each voxel."""
    return np.asarray(((voxels[:, 0] + 2**20) << 42) | ((voxels[:, 1] + 2**20) << 21) | (voxels[:, 2] + 2**20))


class ExactOctoMap:
    """OctoMap's ``insertPointCloud``, step by step, so that each ray may end where it should.

    ``insertPointCloud`` knows a limit along the ray only, the same for all rays; a depth camera has one along its axis.
    So: a tree for one frame casts all rays. First those that end on a surface; then those that do not, in groups of
    nearly the same length, which is the limit given for each: they end less than an eighth of a voxel early. Voxels in
    which a ray ends on a surface are occupied, all others of this tree are free; each gets one update in the tree that
    stays. Where no ray reaches the limit this is what ``insertPointCloud`` does, and `check` sees to it.
    """

    def __init__(self, voxel_m: float) -> None:
        self.tree, self._voxel_m = octree(voxel_m), voxel_m

    def put(self, points: Floats, origin: Floats, hits: NDArray[np.bool_]) -> None:
        """Insert one frame."""
        rays = octree(self._voxel_m)
        rays.insertPointCloud(points[hits], origin)
        ways = points[~hits] - origin
        group = np.floor(np.linalg.norm(ways, axis=1) / (self._voxel_m / 8.0)).astype(np.int64)
        for length in np.unique(group).tolist():
            # Twice as far as they go: beyond the limit, which cuts them.
            rays.insertPointCloud(origin + 2.0 * ways[group == length], origin, length * self._voxel_m / 8.0)
        crossed = leaves_of(rays)[0]
        occupied = np.unique(voxels_of(points[hits], self._voxel_m), axis=0)
        free = crossed[~np.isin(packed(crossed), packed(occupied))]
        self.tree.updateNodes((free + 0.5) * self._voxel_m, False)
        self.tree.updateNodes((occupied + 0.5) * self._voxel_m, True)

    def check(self, frame: DepthFrame) -> None:
        """Compare with the real ``insertPointCloud`` on the surfaces of one frame.

        Raises:
            AssertionError: they differ.
        """
        points, origin = map_frames.ends_m(frame)
        points = points[map_frames.hits_of(frame)]
        here, real = ExactOctoMap(self._voxel_m), octree(self._voxel_m)
        here.put(points, origin, np.ones(len(points), np.bool_))
        real.insertPointCloud(points, origin)
        assert _sorted(leaves_of(here.tree)) == _sorted(leaves_of(real)), "not the voxels of insertPointCloud"


def leaves_of(tree: Any) -> tuple[Integers, NDArray[np.float32]]:
    """(n, 3) voxels of an octree and (n,) their log-odds in thousandths; those drawn together are taken apart."""
    if tree.size() == 0:
        return np.empty((0, 3), np.int64), np.empty(0, np.float32)
    data = tree.write().partition(b"\ndata\n")[2]
    nodes = np.frombuffer(data, np.dtype([("value", "<f4"), ("children", "u1")]))
    return _leaves(nodes["value"].copy(), nodes["children"].copy())


@compiled
def _leaves(values: NDArray[np.float32], children: NDArray[np.uint8]) -> tuple[Integers, NDArray[np.float32]]:
    """The leaves of OctoMap's ``.ot``: nodes depth first, each with a bit for each of its children."""
    count = 0
    # First how many voxels, then which ones.
    voxels, log_odds = np.empty((0, 3), np.int64), np.empty(0, np.float32)
    for fills in (False, True):
        if fills:
            voxels, log_odds = np.empty((count, 3), np.int64), np.empty(count, np.float32)
        count, level = 0, 0
        keys = np.zeros((LEVELS + 2, 3), np.int64)
        todo = np.zeros(LEVELS + 2, np.int64)
        for node in range(len(values)):
            if children[node] == 0:
                edge = 1 << (LEVELS - level)
                for n in range(edge * edge * edge):
                    if fills:
                        voxels[count, 0] = keys[level, 0] * edge + n % edge - OCTOMAP_KEY
                        voxels[count, 1] = keys[level, 1] * edge + n // edge % edge - OCTOMAP_KEY
                        voxels[count, 2] = keys[level, 2] * edge + n // (edge * edge) - OCTOMAP_KEY
                        log_odds[count] = 1000.0 * values[node]
                    count += 1
            todo[level] = children[node]
            while level > 0 and todo[level] == 0:
                level -= 1
            child = 0
            while child < 8 and not todo[level] >> child & 1:
                child += 1
            todo[level] &= ~(1 << child)
            for axis in range(3):
                keys[level + 1, axis] = 2 * keys[level, axis] + (child >> axis & 1)
            level += 1
    return voxels, log_odds


def _sorted(leaves: tuple[Integers, NDArray[np.float32]]) -> list[tuple[int, float]]:
    return sorted(zip(packed(leaves[0]).tolist(), leaves[1].tolist(), strict=True))
