"""The surface in one chunk, by surface nets: a vertex in every cell that the surface passes, a quad for every crossing.

A cell is the cube between the centres of eight neighbouring voxels, known by the lowest of them; it belongs to the
chunk of that voxel. A crossing is an edge between two neighbouring voxels of which one is free and the other occupied.
The vertex of a cell is the mean of the crossings on its twelve edges, and the four cells around a crossing make a quad.
So where free meets unknown, or occupied meets unknown, there is no crossing and no surface, and it needs no special
rule: marching cubes would need all eight voxels of a cell known, and the far side of a wall never is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled, compiled_unchecked
from companion.mapping.voxels.chunks import EDGE, NOTHING, PLACES, VOLUME, bits_in
from companion.model import FloatArray

SIDE = EDGE + 2
"""Voxels along an edge of a chunk with one more on each side."""

CELLS = EDGE + 1
"""Cells along an edge of a chunk with those of the chunk before."""

WORDS = VOLUME // 64
"""64-bit words with one bit for each cell of a chunk."""

_MARGIN = 0.02
"""Vertices keep this share of a cell's edge from its sides, so that those of two cells are never one."""


@compiled
def gather(stored: NDArray[np.int16], rows: NDArray[np.int32], values: NDArray[np.int16]) -> None:
    """Fill ``values`` (18, 18, 18) with a chunk's voxels and one more on each side.

    Args:
        stored: (n, 4096) chunks in Morton order.
        rows: (27,) the rows of the chunk and its neighbours, x slowest and z fastest; -1 for one that is unknown.
        values: the voxel (0, 0, 0) of the chunk goes to [1, 1, 1].
    """
    for x in range(SIDE):
        for y in range(SIDE):
            at_xy = 9 * ((x + EDGE - 1) // EDGE) + 3 * ((y + EDGE - 1) // EDGE)
            for z in range(SIDE):
                row = rows[at_xy + (z + EDGE - 1) // EDGE]
                if row < 0:
                    values[x, y, z] = NOTHING
                else:
                    values[x, y, z] = stored[row, PLACES[(x - 1) % EDGE, (y - 1) % EDGE, (z - 1) % EDGE]]


@compiled
def _crosses(a: int, b: int, threshold: int) -> bool:
    """Whether the surface is between two voxels: one is free, the other occupied."""
    return bool((a < 0 and a != NOTHING and b >= threshold) or (b < 0 and b != NOTHING and a >= threshold))


@compiled_unchecked
def vertex_of(
    values: NDArray[np.int16], cell: tuple[int, int, int], threshold: int, shift: float, vertex: FloatArray
) -> bool:
    """Whether the surface passes a cell; if so ``vertex`` (3,) is its vertex, from 0 to 1 in the cell.

    Args:
        values: (18, 18, 18) from `gather`.
        cell: index in ``values`` of the lowest voxel.
        threshold: a voxel is occupied from this on.
        shift: of the crossings, towards the occupied voxel.
        vertex: is filled.
    """
    crossings = 0
    vertex[:] = 0.0
    x, y, z = cell
    for axis in range(3):
        for k in range(4):
            u, w = k & 1, k >> 1
            dx, dy, dz = (0, u, w) if axis == 0 else ((u, 0, w) if axis == 1 else (u, w, 0))
            a = values[x + dx, y + dy, z + dz]
            b = values[x + dx + (axis == 0), y + dy + (axis == 1), z + dz + (axis == 2)]
            if _crosses(a, b, threshold):
                crossings += 1
                share = (threshold - a) / (b - a)
                share += shift if a < b else -shift
                vertex[0] += dx
                vertex[1] += dy
                vertex[2] += dz
                vertex[axis] += share
    for axis in range(3):
        vertex[axis] = min(max(vertex[axis] / max(crossings, 1), _MARGIN), 1.0 - _MARGIN)
    return crossings > 0


@compiled
def mark_cells(
    stored: NDArray[np.int16], rows: NDArray[np.int32], threshold: int, bits: NDArray[np.uint64]
) -> NDArray[np.int64]:
    """Set the bits of the cells that the surface passes, and count them.

    Args:
        stored: (n, 4096) chunks.
        rows: (m, 27) for each chunk to do, as in `gather`.
        threshold: a voxel is occupied from this on.
        bits: (m, 64) filled: cell (x, y, z) is bit 256 x + 16 y + z.

    Returns:
        (m,) how many cells.
    """
    values = np.empty((SIDE, SIDE, SIDE), np.int16)
    vertex = np.empty(3)
    counts = np.zeros(rows.shape[0], np.int64)
    for n in range(rows.shape[0]):
        gather(stored, rows[n], values)
        bits[n] = 0
        for number in range(VOLUME):
            cell = number // (EDGE * EDGE) + 1, number // EDGE % EDGE + 1, number % EDGE + 1
            if vertex_of(values, cell, threshold, 0.0, vertex):
                bits[n, number >> 6] |= np.uint64(1) << np.uint64(number & 63)
                counts[n] += 1
    return counts


@compiled
def _number_of(
    cell: tuple[int, int, int], owners: NDArray[np.int32], bits: NDArray[np.uint64], first: NDArray[np.int64]
) -> int:
    """The number in the file of the vertex of a cell, whose coordinates are from -1 to 15 in the chunk."""
    x, y, z = cell
    owner = owners[4 * (x >= 0) + 2 * (y >= 0) + (z >= 0)]
    at = EDGE * EDGE * (x % EDGE) + EDGE * (y % EDGE) + z % EDGE
    number = first[owner]
    for word in range(at >> 6):
        number += bits_in(bits[owner, word])
    below = (np.uint64(1) << np.uint64(at & 63)) - np.uint64(1)
    return int(number + bits_in(bits[owner, at >> 6] & below))


@compiled
def _area_squared(a: NDArray[np.float32], b: NDArray[np.float32], c: NDArray[np.float32]) -> float:
    """Four times the square of a triangle's area."""
    ux, uy, uz = float(b[0]) - a[0], float(b[1]) - a[1], float(b[2]) - a[2]
    vx, vy, vz = float(c[0]) - a[0], float(c[1]) - a[1], float(c[2]) - a[2]
    return float((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2)


@compiled
def make_surface(
    stored: NDArray[np.int16],
    rows: NDArray[np.int32],
    chunks: NDArray[np.int32],
    threshold: int,
    voxel_m: float,
    shift: float,
    owners: NDArray[np.int32],
    bits: NDArray[np.uint64],
    first: NDArray[np.int64],
    vertices: NDArray[np.float32],
    triangles: NDArray[np.int32],
) -> tuple[int, int]:
    """The vertices and the triangles of some chunks.

    Args:
        stored: (n, 4096) chunks.
        rows: (m, 27) for each chunk to do, as in `gather`.
        chunks: (m, 3) coordinates of the chunks to do.
        threshold: a voxel is occupied from this on.
        voxel_m: edge of a voxel.
        shift: of the surface, towards the occupied side, in voxels.
        owners: (m, 8) rows in ``bits`` and ``first`` of the chunk, last, and those before it, x slowest, z fastest.
        bits: (k, 64) from `mark_cells`, of all chunks.
        first: (k,) number of the first vertex of each chunk.
        vertices: (4096 m, 3) filled from its beginning, in m.
        triangles: (6 * 4096 m, 3) filled from its beginning; the free side is where they turn counter-clockwise.

    Returns:
        How many vertices, how many triangles.
    """
    values = np.empty((SIDE, SIDE, SIDE), np.int16)
    corners = np.empty((CELLS, CELLS, CELLS, 3), np.float32)
    vertex = np.empty(3)
    around = np.empty((4, 3), np.int64)
    numbers = np.empty(4, np.int64)
    n_vertices = n_triangles = 0
    for n in range(rows.shape[0]):
        gather(stored, rows[n], values)
        for x in range(CELLS):
            for y in range(CELLS):
                for z in range(CELLS):
                    if vertex_of(values, (x, y, z), threshold, shift, vertex):
                        for axis, at in enumerate((x, y, z)):
                            voxel = EDGE * chunks[n, axis] + at - 1
                            corners[x, y, z, axis] = (voxel + 0.5 + vertex[axis]) * voxel_m
                        if x > 0 and y > 0 and z > 0:
                            vertices[n_vertices] = corners[x, y, z]
                            n_vertices += 1
        for x in range(1, CELLS):
            for y in range(1, CELLS):
                for z in range(1, CELLS):
                    a = values[x, y, z]
                    if a == NOTHING:
                        continue
                    for axis in range(3):
                        b = values[x + (axis == 0), y + (axis == 1), z + (axis == 2)]
                        if not _crosses(a, b, threshold):
                            continue
                        # Counter-clockwise seen from the far end of the edge: that is right when the far end is free.
                        for k in range(4):
                            side = k if b < 0 else 3 - k
                            around[k, 0], around[k, 1], around[k, 2] = x, y, z
                            around[k, (axis + 1) % 3] -= side in (0, 3)
                            around[k, (axis + 2) % 3] -= side in (0, 1)
                            numbers[k] = _number_of(
                                (around[k, 0] - 1, around[k, 1] - 1, around[k, 2] - 1), owners[n], bits, first
                            )
                        n_triangles = _split(corners, around, numbers, triangles, n_triangles)
    return n_vertices, n_triangles


@compiled
def _split(
    corners: NDArray[np.float32],
    around: NDArray[np.int64],
    numbers: NDArray[np.int64],
    triangles: NDArray[np.int32],
    n_triangles: int,
) -> int:
    """Add the two triangles of a quad, along the diagonal that leaves the larger of the smaller ones."""
    best, best_area = 0, -1.0
    for turn in range(2):
        p = corners[around[turn, 0], around[turn, 1], around[turn, 2]]
        q = corners[around[turn + 1, 0], around[turn + 1, 1], around[turn + 1, 2]]
        r = corners[around[turn + 2, 0], around[turn + 2, 1], around[turn + 2, 2]]
        last = (turn + 3) % 4
        s = corners[around[last, 0], around[last, 1], around[last, 2]]
        area = min(_area_squared(p, q, r), _area_squared(p, r, s))
        if area > best_area:
            best, best_area = turn, area
    if best_area <= 0.0:
        return n_triangles
    for k in (1, 2):
        triangles[n_triangles, 0] = numbers[best]
        triangles[n_triangles, 1] = numbers[(best + k) % 4]
        triangles[n_triangles, 2] = numbers[(best + k + 1) % 4]
        n_triangles += 1
    return n_triangles
