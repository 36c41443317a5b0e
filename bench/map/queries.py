"""What it costs to ask a map what is known: ``python -m bench.map.queries [--km 0.1,1,10] [--json FILE]``.

A straight tunnel, 4 m wide and 3 m high, voxels of 0.1 m, made of 16 slices of a chunk with noise: 2 % of the free
voxels unknown, walls rough by a voxel. The vehicle has flown through all of it. Then it flies on, slice by slice of
1.6 m, which takes it longer than a second: each time the last 8 m are seen with other noise, in which nearly every
column is different, ten places are added, and a survey is asked for. Nearest and sight are asked from places flown:
one batch divided by its length, so without what a call from Python costs, which is given apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bench.common import Row, parser, show
from companion.config.load import load_settings
from companion.flight.warm_up import reach
from companion.mapping import FREE, OCCUPIED, UNKNOWN, MapSnapshot
from companion.mapping.frontiers.nearest import nearest_not_free_m, nearest_obstacle_m
from companion.mapping.frontiers.sight import sights
from companion.mapping.frontiers.surveyor import Surveyor
from companion.mapping.voxels.chunks import EDGE, OFFSETS
from companion.model import FloatArray

VOXEL_M = 0.1
SLICE_M = EDGE * VOXEL_M
SLICES = 16
STEPS = 20
QUESTIONS = 20_000
BATCH = 20
SIGHT_M = 10.0
MOST_M = 3.0

REACH = reach(load_settings(None, "flight"))


def tunnel_slices() -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """(n, 3) chunks of a slice at x = 0, and (16, n, 4096) their states in each of the slices."""
    random = np.random.default_rng(0)
    # From y = -3.2 m and z = -1.6 m.
    dense = np.full((SLICES, EDGE, 64, 64), UNKNOWN, np.uint8)
    dense[:, :, 10:54, 14:49] = OCCUPIED
    dense[:, :, 12:52, 16:46] = FREE
    dense[(random.random(dense.shape) < 0.02) & (dense == FREE)] = UNKNOWN
    walls = (random.random(dense.shape) < 0.2) & (dense == FREE)
    walls[:, :, 13:51, 17:45] = False
    dense[walls] = OCCUPIED
    chunks = np.array([[0, y, z] for y in range(4) for z in range(4)], np.int32)
    places = EDGE * chunks[:, np.newaxis, :] + OFFSETS[np.newaxis]
    states = dense[:, places[..., 0], places[..., 1], places[..., 2]]
    return chunks + np.array([0, -2, -1], np.int32), states


class Tunnel:
    """The tunnel, as far as it was seen."""

    def __init__(self) -> None:
        self._chunks, self._states = tunnel_slices()
        self._random = np.random.default_rng(1)

    def seen(self, first: int, last: int) -> MapSnapshot:
        """Slices ``first`` up to ``last``, each with a noise of its own."""
        count = last - first
        chunks = np.repeat(self._chunks[np.newaxis], count, axis=0)
        chunks[:, :, 0] = np.arange(first, last)[:, np.newaxis]
        states = self._states[self._random.integers(0, SLICES, count)]
        return MapSnapshot(VOXEL_M, 1, chunks.reshape(-1, 3), states.reshape(-1, 4096))


def flown_m(from_m: float, to_m: float, step_m: float = 0.1) -> FloatArray:
    """(n, 3) places."""
    x_m = np.arange(from_m, to_m, step_m)
    return np.stack([x_m, 0.4 * np.sin(0.3 * x_m), np.full(len(x_m), 1.5)], axis=1)


def measured(length_km: float) -> Row:
    """All figures for a tunnel of one length."""
    tunnel, surveyor = Tunnel(), Surveyor(VOXEL_M, REACH)
    slices = round(1000.0 * length_km / SLICE_M)
    began_s = time.perf_counter()
    for first in range(0, slices, 16):
        last = min(first + 16, slices)
        surveyor.update(tunnel.seen(first, last))
        surveyor.flew(flown_m(max(first * SLICE_M, 1.0), last * SLICE_M - 1.0, 0.4))
    found = surveyor.survey((slices * SLICE_M - 1.0, 0.0, 1.5))
    built_s = time.perf_counter() - began_s
    update_ms, survey_ms = [], []
    for step in range(STEPS):
        last = slices + step + 1
        change = tunnel.seen(last - 5, last)
        places_m = flown_m(last * SLICE_M - 2.0, last * SLICE_M - 1.0)
        x_m, y_m, z_m = places_m[-1].tolist()
        start_s = time.perf_counter()
        surveyor.update(change)
        middle_s = time.perf_counter()
        surveyor.flew(places_m)
        found = surveyor.survey((x_m, y_m, z_m))
        survey_ms.append(1000.0 * (time.perf_counter() - middle_s))
        update_ms.append(1000.0 * (middle_s - start_s))
    assert len(found.frontiers) > 0
    row: Row = {
        "km": length_km,
        "chunks": surveyor.known.chunk_count,
        "build, s": built_s,
        "update, ms": float(np.median(update_ms)),
        "survey, ms": float(np.median(survey_ms)),
        "both p99, ms": float(np.percentile(np.add(update_ms, survey_ms), 99)),
        "states, MB": surveyor.known.memory_bytes / 1e6,
        "all, MB": surveyor.memory_bytes / 1e6,
        "free, m2": found.free_m2,
        "frontiers": len(found.frontiers),
    }
    return row | questions(surveyor, length_km)


def questions(surveyor: Surveyor, length_km: float) -> Row:
    """The time of one question each."""
    random = np.random.default_rng(2)
    x_m = random.uniform(1.0, 1000.0 * length_km - SIGHT_M - 1.0, QUESTIONS)
    points_m = np.stack([x_m, random.uniform(-1.5, 1.5, QUESTIONS), random.uniform(0.5, 2.5, QUESTIONS)], axis=1)
    ends_m = points_m + np.array([SIGHT_M - 0.1, 0.0, 0.0])
    ends_m[:, 1:] = np.stack([random.uniform(-1.5, 1.5, QUESTIONS), random.uniform(0.5, 2.5, QUESTIONS)], axis=1)
    row: Row = {}
    asked: dict[str, Callable[[slice], object]] = {
        "nearest": lambda part: nearest_obstacle_m(surveyor.known, points_m[part], MOST_M),
        "not free": lambda part: nearest_not_free_m(surveyor.known, points_m[part], MOST_M),
        "sight": lambda part: sights(surveyor.known, points_m[part], ends_m[part]),
    }
    for name, ask in asked.items():
        ask(slice(0, 1))
        nothing_s = _times_s(ask, 0)
        batch_s = _times_s(ask, BATCH)
        each_us = 1e6 * np.maximum(batch_s - np.median(nothing_s), 0.0) / BATCH
        row[f"{name}, us"] = float(np.median(each_us))
        row[f"{name} p99, us"] = float(np.percentile(each_us, 99))
        row[f"{name} call, us"] = 1e6 * float(np.median(nothing_s))
    return row


def _times_s(ask: Callable[[slice], object], size: int) -> FloatArray:
    times_s = []
    for first in range(0, QUESTIONS, BATCH):
        start_s = time.perf_counter()
        ask(slice(first, first + size))
        times_s.append(time.perf_counter() - start_s)
    return np.array(times_s)


def main() -> None:
    """Measure and print the table."""
    made = parser(__doc__)
    made.add_argument("--km", default="0.1,1,10", help="lengths of tunnel, separated by commas")
    arguments = made.parse_args()
    rows = []
    measured(0.1)  # compiles
    for text in arguments.km.split(","):
        rows.append(measured(float(text)))
        print(f"{text} km done", flush=True)
    columns = list(rows[0])
    show(rows, columns[:10], None)
    show(rows, ["km", *columns[10:]], arguments.json)


if __name__ == "__main__":
    main()
