"""What is seen from where: patches of the visible surface, and looks of the real camera at them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.geometry import camera_to_world
from companion.model import Camera, Pose
from sitl.scene.raycast import RayCaster
from sitl.scene.visibility import Truth

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

HEADINGS = 16
"""A look points into one of so many directions."""

_PATCH_M = 0.4
"""The surface is planned with in patches of this size, one point each; the result is checked with every point."""

_BATCH = 256
_STOP_M = 0.02
"""A look ends this far before the surface, as for the truth."""


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """The visible surface in pieces: (p, 3) a point in the middle of each, and (p,) its share of the whole area."""

    points_m: Array
    shares: Array

    @classmethod
    def of(cls, truth: Truth) -> Patches:
        """Those of a truth; each is stood for by that of its samples which is nearest to its middle."""
        samples, areas = truth.samples_m.astype(np.float64), truth.sample_areas_m2.astype(np.float64)
        _, patch = np.unique(np.floor(samples / _PATCH_M).astype(np.int64), axis=0, return_inverse=True)
        patch = patch.reshape(-1)
        area = np.bincount(patch, areas)
        middles = np.column_stack([np.bincount(patch, areas * samples[:, axis]) / area for axis in range(3)])
        off_m = np.linalg.norm(samples - middles[patch], axis=1)
        order = np.lexsort((off_m, patch))
        first = order[np.unique(patch[order], return_index=True)[1]]
        return cls(samples[first], area / area.sum())


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """What looks see: place by place, and in each `HEADINGS` headings, from 0 counter-clockwise.

    Attributes:
        begins: (looks + 1,) where in ``seen`` the patches of each look begin.
        seen: the patches of all looks, one after the other.
        seen_begins: (patches + 1,) where in ``looks`` the looks that see each patch begin.
        looks: the looks that see each patch, one patch after the other.
    """

    begins: Indices
    seen: Indices
    seen_begins: Indices
    looks: Indices

    @classmethod
    def of_counts(cls, counts: Indices, seen: Indices, patches: int) -> Views:
        """From the number of patches that each look sees, and all of these."""
        order = np.argsort(seen, kind="stable")
        seen_begins = np.concatenate([[0], np.cumsum(np.bincount(seen, minlength=patches))])
        begins = np.concatenate([[0], np.cumsum(counts)])
        return cls(begins, seen, seen_begins, np.repeat(np.arange(len(counts)), counts)[order])

    @property
    def visible(self) -> NDArray[np.bool_]:
        """(patches,) whether any look sees it."""
        return np.asarray(np.diff(self.seen_begins) > 0)

    def of(self, place: int, heading: int) -> Indices:
        """The patches that one look sees."""
        row = place * HEADINGS + heading
        return self.seen[self.begins[row] : self.begins[row + 1]]

    def shares_of(self, shares: Array) -> Array:
        """(looks,) the sum of the shares (patches,) of all that each look sees; quick where most of them are 0."""
        sums: Array = _sums(np.flatnonzero(shares), shares, self.seen_begins, self.looks, len(self.begins) - 1)
        return sums


def frustum(camera: Camera, headings_rad: Array) -> tuple[Array, Array]:
    """Rotations (n, 3, 3) from camera to world of a level vehicle, and the tangents (left, right, up, down) in view."""
    turns = np.stack([camera_to_world(camera, Pose(0.0, 0.0, 0.0, 0.0, float(yaw)))[0] for yaw in headings_rad])
    tangents = [
        (camera.cx_px + 0.5) / camera.fx_px,
        (camera.width_px - 0.5 - camera.cx_px) / camera.fx_px,
        (camera.cy_px + 0.5) / camera.fy_px,
        (camera.height_px - 0.5 - camera.cy_px) / camera.fy_px,
    ]
    return turns, np.array(tangents)


def looks_at(caster: RayCaster, camera: Camera, patches: Patches, places_m: Array, range_m: float) -> Views:
    """What looks from (k, 3) places see: what is in the picture and in range, with nothing between."""
    turns, tangents = frustum(camera, np.linspace(0.0, 2.0 * np.pi, HEADINGS, endpoint=False))
    counts, seen = [], []
    for begin in range(0, len(places_m), _BATCH):
        part = places_m[begin : begin + _BATCH]
        place, patch = _pairs(part, patches.points_m, range_m, turns, tangents)
        ways = patches.points_m[patch] - part[place]
        free = ~caster.blocked(part[place], patches.points_m[patch] - _last_piece(ways))
        count, found = _in_pictures(patch[free], place[free], ways[free], len(part), turns, tangents)
        counts.append(count)
        seen.append(found)
    return Views.of_counts(np.concatenate(counts), np.concatenate(seen), len(patches.shares))


def seen_share(
    truth: Truth, caster: RayCaster, camera: Camera, poses: Sequence[Pose], range_m: float, voxel_m: float
) -> float:
    """The share, by area, of all that is visible that a camera maps from these poses.

    Seen is what the truth calls visible, from there; mapped is what lies within one voxel of it, as in a mission.
    """
    samples, areas = truth.samples_m.astype(np.float64), truth.sample_areas_m2.astype(np.float64)
    _, tangents = frustum(camera, np.zeros(1))
    seen = np.zeros(len(samples), np.bool_)
    for pose in poses:
        turn, at_m = camera_to_world(camera, pose)
        near = _unseen_in_picture(samples, seen, at_m, range_m, turn, tangents)
        ways = samples[near] - at_m
        seen[near] = ~caster.blocked(at_m, samples[near] - _last_piece(ways)) if len(near) else False
    mapped = _within_a_voxel(samples, seen, voxel_m)
    return float(areas[mapped].sum() / areas.sum())


def _within_a_voxel(points_m: Array, seen: NDArray[np.bool_], voxel_m: float) -> NDArray[np.bool_]:
    """(n,) whether the voxel of each point, or one beside it, holds one that is seen."""
    voxels = np.floor(points_m / voxel_m).astype(np.int64)
    voxels -= voxels.min(axis=0) - 1
    _, ny, nz = voxels.max(axis=0) + 2
    keys = (voxels[:, 0] * ny + voxels[:, 1]) * nz + voxels[:, 2]
    held = np.unique(keys[seen])
    found = seen.copy()
    for dx, dy, dz in itertools.product((-1, 0, 1), repeat=3):
        rest = np.flatnonzero(~found)
        found[rest] = np.isin(keys[rest] + (dx * ny + dy) * nz + dz, held)
    return found


def _last_piece(ways: Array) -> Array:
    """The end of each way (n, 3), which lies on the very surface that would stop it."""
    return np.asarray(ways * (_STOP_M / np.maximum(np.linalg.norm(ways, axis=1), _STOP_M))[:, None])


@compiled
def _is_in_picture(x: float, y: float, z: float, turn: Array, tangents: Array) -> bool:
    """Whether what lies in that direction from the camera is in its picture."""
    ahead = x * turn[0, 0] + y * turn[1, 0] + z * turn[2, 0]
    left = x * turn[0, 1] + y * turn[1, 1] + z * turn[2, 1]
    up = x * turn[0, 2] + y * turn[1, 2] + z * turn[2, 2]
    return bool(
        ahead > 0.0
        and -tangents[1] * ahead <= left <= tangents[0] * ahead
        and -tangents[3] * ahead <= up <= tangents[2] * ahead
    )


@compiled
def _pairs(places_m: Array, points_m: Array, range_m: float, turns: Array, tangents: Array) -> tuple[Indices, Indices]:
    """Places and points that are within range of each other, and in the picture of some heading, place by place."""
    room = 4096
    place, point = np.empty(room, np.int64), np.empty(room, np.int64)
    size = 0
    for i in range(len(places_m)):
        for k in range(len(points_m)):
            x, y, z = points_m[k, 0] - places_m[i, 0], points_m[k, 1] - places_m[i, 1], points_m[k, 2] - places_m[i, 2]
            if x * x + y * y + z * z > range_m * range_m:
                continue
            for turn in turns:
                if _is_in_picture(x, y, z, turn, tangents):
                    if size == room:
                        place, point = np.append(place, place), np.append(point, point)
                        room *= 2
                    place[size], point[size] = i, k
                    size += 1
                    break
    return place[:size], point[:size]


@compiled
def _in_pictures(
    patch: Indices, place: Indices, ways: Array, places: int, turns: Array, tangents: Array
) -> tuple[Indices, Indices]:
    """For each place and heading how many patches are in the picture, and which; the pairs come place by place."""
    headings = turns.shape[0]
    counts = np.zeros(places * headings, np.int64)
    found = np.empty(len(patch) * headings, np.int64)
    total, begin = 0, 0
    for here in range(places):
        end = begin
        while end < len(patch) and place[end] == here:
            end += 1
        for h in range(headings):
            for k in range(begin, end):
                if _is_in_picture(ways[k, 0], ways[k, 1], ways[k, 2], turns[h], tangents):
                    found[total] = patch[k]
                    total += 1
                    counts[here * headings + h] += 1
        begin = end
    return counts, found[:total]


@compiled
def _unseen_in_picture(
    points_m: Array, seen: NDArray[np.bool_], at_m: Array, range_m: float, turn: Array, tangents: Array
) -> Indices:
    found = np.empty(len(points_m), np.int64)
    size = 0
    for k in range(len(points_m)):
        if seen[k]:
            continue
        x, y, z = points_m[k, 0] - at_m[0], points_m[k, 1] - at_m[1], points_m[k, 2] - at_m[2]
        if x * x + y * y + z * z <= range_m * range_m and _is_in_picture(x, y, z, turn, tangents):
            found[size] = k
            size += 1
    return found[:size]


@compiled
def _sums(patches: Indices, shares: Array, seen_begins: Indices, looks: Indices, size: int) -> Array:
    sums = np.zeros(size)
    for patch in patches:
        for k in range(seen_begins[patch], seen_begins[patch + 1]):
            sums[looks[k]] += shares[patch]
    return sums
