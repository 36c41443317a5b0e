"""Exact depth images of a world, fast enough to fly many times faster than real time on one core.

A z-buffer in numba: casting a ray for every pixel gives the same image and takes ten to a hundred times as long
(``python -m bench.flight.render``). The work is kept small by looking only at the chunks of the mesh that are within
range and in view, and by writing rows of pixels in a loop that the compiler turns into vector instructions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled_unchecked
from companion.geometry import camera_to_world
from companion.model import Camera, Pose
from sitl.mines.model import World

Array = NDArray[np.float64]
Lens = tuple[float, float, float, float]
"""fx, fy, cx, cy in pixels."""

CHUNK_M = 4.0
NEAR_M = 0.02
FAR_SHARE = 1.05
"""Surfaces are drawn out to this multiple of the camera's range."""

_EDGE_PX = 1e-6
"""Pixel centres this close to an edge belong to it, so that rounding cannot open a gap between two triangles."""


class DepthRenderer:
    """Renders the depth images that ``camera`` would see in ``world`` if it were perfect.

    One renderer may be used from several threads; rendering releases the interpreter's lock.
    """

    def __init__(self, world: World, camera: Camera) -> None:
        self.camera = camera
        self._chunks = _Chunks.of(world)

    def render(self, pose: Pose) -> NDArray[np.float32]:
        """The depth image from ``pose``.

        Returns:
            (height, width) distance in m along the optical axis to the nearest surface, seen from either side; inf
            where there is none within `FAR_SHARE` of the camera's range. Nothing nearer than `NEAR_M` is seen.
        """
        camera = self.camera
        lens = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
        far_m = camera.max_range_m * FAR_SHARE
        view = _View(*camera_to_world(camera, pose), camera.width_px, camera.height_px, lens, far_m)
        image: NDArray[np.float32] = _rendered(self._chunks, view)
        return image


class _View(NamedTuple):
    """From where an image is seen: the camera's axes (3, 3) and place (3,) in the world, its pixels, and how far."""

    axes: Array
    place: Array
    width: int
    height: int
    lens: Lens
    far: float


class _Chunks(NamedTuple):
    """A mesh sorted into cubes, each with the sphere around it and vertices of its own.

    Attributes:
        vertices_m: (n, 3), those of chunk c from ``vertex_starts[c]`` to ``vertex_starts[c + 1]``.
        triangles: (m, 3) indices that count from the chunk's first vertex.
        centres_m: (c, 3) and ``radii_m`` (c,): the spheres.
    """

    vertices_m: Array
    vertex_starts: NDArray[np.int64]
    triangles: NDArray[np.int64]
    triangle_starts: NDArray[np.int64]
    centres_m: Array
    radii_m: Array

    @classmethod
    def of(cls, world: World) -> _Chunks:
        vertices = world.vertices_m.astype(np.float64)
        corners = vertices[world.triangles]
        low, high = corners.min(axis=1), corners.max(axis=1)
        # Large triangles go into larger cubes, lest one of them inflate the sphere of a hundred small ones.
        size_m = CHUNK_M * 2.0 ** np.ceil(np.log2(np.maximum((high - low).max(axis=1) / CHUNK_M, 1.0)))
        keys = np.column_stack([size_m, np.floor((low + high) / 2 / size_m[:, None])])
        _, chunk, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        order = np.argsort(chunk, kind="stable")
        triangle_starts = np.concatenate([[0], np.cumsum(counts)])

        owner = np.repeat(chunk[order], 3)
        pairs, local = np.unique(owner * len(vertices) + world.triangles[order].ravel(), return_inverse=True)
        vertex_starts = np.searchsorted(pairs, np.arange(len(counts) + 1) * len(vertices))
        own = vertices[pairs % len(vertices)]

        first = vertex_starts[:-1]
        centres = (np.minimum.reduceat(own, first) + np.maximum.reduceat(own, first)) / 2
        away = np.linalg.norm(own - np.repeat(centres, np.diff(vertex_starts), axis=0), axis=1)
        radii = np.maximum.reduceat(away, first)
        return cls(own, vertex_starts, (local - vertex_starts[owner]).reshape(-1, 3), triangle_starts, centres, radii)


@compiled_unchecked
def _rendered(chunks: _Chunks, view: _View) -> NDArray[np.float32]:
    """The depth image. 1/depth is linear over the pixels that a plane covers, and its greatest value is the nearest."""
    vertices, vertex_starts, triangles, triangle_starts, _, _ = chunks
    axes, place, width, height, lens, far = view
    fx, fy, cx, cy = lens
    background = np.float32(1.0 / far)
    inverse = np.full((height, width), background, dtype=np.float32)
    most = np.max(np.diff(vertex_starts))
    seen = np.empty((most, 3))  # a chunk's vertices along the axes of the camera: forward, left, up
    pixel = np.empty((most, 2))
    polygon = np.empty((4, 2))

    for chunk in _chunks_in_view(chunks, view):
        first = vertex_starts[chunk]
        for i in range(vertex_starts[chunk + 1] - first):
            x = vertices[first + i, 0] - place[0]
            y = vertices[first + i, 1] - place[1]
            z = vertices[first + i, 2] - place[2]
            forward = x * axes[0, 0] + y * axes[1, 0] + z * axes[2, 0]
            seen[i, 0] = forward
            seen[i, 1] = x * axes[0, 1] + y * axes[1, 1] + z * axes[2, 1]
            seen[i, 2] = x * axes[0, 2] + y * axes[1, 2] + z * axes[2, 2]
            if forward >= NEAR_M:
                pixel[i, 0] = cx - fx * seen[i, 1] / forward
                pixel[i, 1] = cy - fy * seen[i, 2] / forward
        for t in range(triangle_starts[chunk], triangle_starts[chunk + 1]):
            a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            nearest = min(seen[a, 0], seen[b, 0], seen[c, 0])
            farthest = max(seen[a, 0], seen[b, 0], seen[c, 0])
            if farthest < NEAR_M or nearest > far:
                continue
            count = 3
            if nearest >= NEAR_M:
                polygon[0, 0], polygon[0, 1] = pixel[a, 0], pixel[a, 1]
                polygon[1, 0], polygon[1, 1] = pixel[b, 0], pixel[b, 1]
                polygon[2, 0], polygon[2, 1] = pixel[c, 0], pixel[c, 1]
            else:
                count = _clipped(polygon, seen, pixel, triangles[t], lens)
            if not _covers_a_pixel(polygon, count, width, height):
                continue
            along_u, along_v, at_zero = _inverse_depth(
                (seen[a, 0], seen[a, 1], seen[a, 2]),
                (seen[b, 0], seen[b, 1], seen[b, 2]),
                (seen[c, 0], seen[c, 1], seen[c, 2]),
                lens,
            )
            if not np.isfinite(at_zero):  # seen exactly edge-on, or a line or a point to begin with
                continue
            low, high = np.float32(1.0 / farthest), np.float32(1.0 / max(nearest, NEAR_M))
            for k in range(1, count - 1):
                _fill(
                    inverse,
                    *(polygon[0, 0], polygon[0, 1], polygon[k, 0], polygon[k, 1], polygon[k + 1, 0], polygon[k + 1, 1]),
                    *(along_u, along_v, at_zero, low, high),
                )

    for v in range(height):
        for u in range(width):
            inverse[v, u] = np.float32(1.0) / inverse[v, u] if inverse[v, u] > background else np.float32(np.inf)
    return inverse


@compiled_unchecked
def _chunks_in_view(chunks: _Chunks, view: _View) -> NDArray[np.int64]:
    """The chunks whose sphere reaches into the pyramid that the image covers out to ``far``."""
    centres, radii = chunks.centres_m, chunks.radii_m
    axes, place, width, height, lens, far = view
    fx, fy, cx, cy = lens
    left_slope, right_slope = (cx + 0.5) / fx, (width - 0.5 - cx) / fx
    up_slope, down_slope = (cy + 0.5) / fy, (height - 0.5 - cy) / fy
    left_stretch, right_stretch = np.sqrt(1.0 + left_slope**2), np.sqrt(1.0 + right_slope**2)
    up_stretch, down_stretch = np.sqrt(1.0 + up_slope**2), np.sqrt(1.0 + down_slope**2)
    found = np.empty(len(radii), dtype=np.int64)
    count = 0
    for chunk in range(len(radii)):
        x, y, z = centres[chunk, 0] - place[0], centres[chunk, 1] - place[1], centres[chunk, 2] - place[2]
        radius = radii[chunk]
        forward = x * axes[0, 0] + y * axes[1, 0] + z * axes[2, 0]
        if forward + radius < NEAR_M or forward - radius > far:
            continue
        left = x * axes[0, 1] + y * axes[1, 1] + z * axes[2, 1]
        if (
            left - left_slope * forward > radius * left_stretch
            or -left - right_slope * forward > radius * right_stretch
        ):
            continue
        up = x * axes[0, 2] + y * axes[1, 2] + z * axes[2, 2]
        if up - up_slope * forward > radius * up_stretch or -up - down_slope * forward > radius * down_stretch:
            continue
        found[count] = chunk
        count += 1
    return found[:count]


@compiled_unchecked
def _clipped(polygon: Array, seen: Array, pixel: Array, corners: NDArray[np.int64], lens: Lens) -> int:
    """Writes the part of a triangle beyond the near plane to ``polygon``, in pixels; returns its number of corners."""
    fx, fy, cx, cy = lens
    count = 0
    for k in range(3):
        a, b = corners[k], corners[(k + 1) % 3]
        if seen[a, 0] >= NEAR_M:
            polygon[count, 0], polygon[count, 1] = pixel[a, 0], pixel[a, 1]
            count += 1
        if (seen[a, 0] >= NEAR_M) != (seen[b, 0] >= NEAR_M):
            if seen[a, 0] < NEAR_M:  # always from the far end, so that both triangles of an edge get the same point
                a, b = b, a
            share = (seen[a, 0] - NEAR_M) / (seen[a, 0] - seen[b, 0])
            polygon[count, 0] = cx - fx * (seen[a, 1] + share * (seen[b, 1] - seen[a, 1])) / NEAR_M
            polygon[count, 1] = cy - fy * (seen[a, 2] + share * (seen[b, 2] - seen[a, 2])) / NEAR_M
            count += 1
    return count


@compiled_unchecked
def _covers_a_pixel(polygon: Array, count: int, width: int, height: int) -> bool:
    """Whether the rectangle around a polygon holds the centre of any pixel."""
    low_u = high_u = polygon[0, 0]
    low_v = high_v = polygon[0, 1]
    for k in range(1, count):
        low_u, high_u = min(low_u, polygon[k, 0]), max(high_u, polygon[k, 0])
        low_v, high_v = min(low_v, polygon[k, 1]), max(high_v, polygon[k, 1])
    low_u, high_u = max(np.ceil(low_u - _EDGE_PX), 0.0), min(np.floor(high_u + _EDGE_PX), width - 1.0)
    low_v, high_v = max(np.ceil(low_v), 0.0), min(np.floor(high_v), height - 1.0)
    return bool(low_u <= high_u and low_v <= high_v)


@compiled_unchecked
def _inverse_depth(
    a: tuple[float, float, float], b: tuple[float, float, float], c: tuple[float, float, float], lens: Lens
) -> tuple[float, float, float]:
    """1/depth over the pixels of the plane through three points: growth along u, growth along v, value at (0, 0).

    From the plane itself and not from its corners' pixels, so that thin and clipped triangles are as exact as others.
    Not finite if the camera lies in the plane.
    """
    fx, fy, cx, cy = lens
    e0, e1, e2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    f0, f1, f2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    n0, n1, n2 = e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0
    distance = n0 * a[0] + n1 * a[1] + n2 * a[2]
    along_u, along_v = -n1 / (fx * distance), -n2 / (fy * distance)
    return along_u, along_v, n0 / distance - along_u * cx - along_v * cy


@compiled_unchecked
def _fill(
    inverse: NDArray[np.float32],
    ua: float,
    va: float,
    ub: float,
    vb: float,
    uc: float,
    vc: float,
    along_u: float,
    along_v: float,
    at_zero: float,
    low: np.float32,
    high: np.float32,
) -> None:
    """Raises ``inverse`` to the 1/depth of a triangle wherever the centre of a pixel lies in it or on its edge.

    Every edge is followed downwards from its upper end, so two triangles that share it compute the same columns to the
    last bit: no pixel between them is left out. ``low`` and ``high`` bound what the plane gives beyond an edge.
    """
    if vb < va:
        ua, va, ub, vb = ub, vb, ua, va
    if vc < va:
        ua, va, uc, vc = uc, vc, ua, va
    if vc < vb:
        ub, vb, uc, vc = uc, vc, ub, vb
    if va == vc:
        return
    height, width = inverse.shape
    step = np.float32(along_u)
    whole = (uc - ua) / (vc - va)
    upper = (ub - ua) / (vb - va)  # not finite, and not used, where this edge or the next lies along a row
    lower = (uc - ub) / (vc - vb)
    for v in range(int(max(np.ceil(va), 0.0)), int(min(np.floor(vc), height - 1.0)) + 1):
        one = ua + (v - va) * whole
        if v < vb:
            other = ua + (v - va) * upper
        elif v > vb:
            other = ub + (v - vb) * lower
        else:
            other = ub
        first = int(max(np.ceil(min(one, other) - _EDGE_PX), 0.0))
        last = int(min(np.floor(max(one, other) + _EDGE_PX), width - 1.0))
        begin = np.float32(at_zero + along_v * v + along_u * first)
        row, column = np.uint32(v), np.uint32(first)  # a signed index might count from the end, which costs the vectors
        for k in range(last - first + 1):
            value = min(max(begin + step * np.float32(k), low), high)
            inverse[row, column + np.uint32(k)] = max(inverse[row, column + np.uint32(k)], value)
