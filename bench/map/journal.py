"""What the journal of the map costs: ``python -m bench.map.journal [--json FILE]``.

The chunks are those of the flight through the tunnel of `bench.map.frames`, at 1 m/s with depth noise and holes.
Larger journals hold the same chunks again and again, further along. Times are medians: processor
time of the one thread where `cpu` stands or nothing is said, time on the clock for a flush, whose sync is the disk's,
and for opening, which reads files that the system still has in its memory.
"""

from __future__ import annotations

import os
import platform
import shutil
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from bench import common
from bench.map.frames import ROUGH, TUNNEL, camera_of, spoilt
from bench.map.frames import flight as flight_of
from companion.config.mapping import MapSettings
from companion.mapping import VoxelMap
from companion.mapping.journal import Header, Journal
from companion.mapping.journal.coding import MOST_BYTES, decode, encode
from companion.mapping.journal.paging import PagedMap
from companion.mapping.journal.segment import packed
from companion.mapping.voxels.chunks import VOLUME
from companion.mapping.voxels.piece import MapPiece
from companion.model import DepthFrame

VOXELS_M = (0.1, 0.05)
CHUNKS = (1_000, 10_000, 90_000)
FRAMES, FRAMES_A_FLUSH = 100, 3
REPEATS = 9
TESTS = 100


def tunnel_frames() -> list[DepthFrame]:
    """The images of one flight."""
    return spoilt(flight_of(TUNNEL, FRAMES, camera_of(160, 120)), ROUGH)


def cpu_ms(work: Callable[[], object]) -> float:
    """Median processor time of a few calls, without the first, which compiles."""
    work()
    times_s = []
    for _ in range(REPEATS):
        start_s = time.thread_time()
        work()
        times_s.append(time.thread_time() - start_s)
    return 1000.0 * float(np.median(times_s))


def tunnel_piece(settings: MapSettings) -> MapPiece:
    """All chunks of the map of that flight."""
    voxels = VoxelMap(settings)
    for frame in tunnel_frames():
        voxels.integrate(frame)
    return voxels.piece(voxels.changed())


def coding(voxel_m: float) -> common.Row:
    """Encoding and decoding 300 chunks, and what zlib would make of the bytes."""
    held = tunnel_piece(MapSettings(voxel_m=voxel_m))
    rows = np.resize(np.arange(len(held.chunks)), 300)
    chunks, values = held.chunks[rows], held.values[rows]
    out = np.empty(300 * MOST_BYTES, np.uint8)
    starts = np.append(0, np.cumsum(encode(values, out, 0)))
    data, back = out[: starts[-1]].copy(), np.empty((300, VOLUME), np.int16)
    parts = [data[start:end].tobytes() for start, end in pairwise(starts)]
    return {
        "voxel_m": voxel_m,
        "encode_ms": cpu_ms(lambda: encode(values, out, 0)),
        "records_ms": cpu_ms(lambda: packed(chunks, values)),
        "decode_ms": cpu_ms(lambda: decode(data, starts, back)),
        "bytes": len(data) / 300,
        "zlib_ms": cpu_ms(lambda: [zlib.compress(part, 1) for part in parts]),
        "zlib_bytes": sum(len(zlib.compress(part, 1)) for part in parts) / 300,
        "zlib_8_ms": cpu_ms(lambda: [zlib.compress(b"".join(parts[n : n + 8]), 1) for n in range(0, 300, 8)]),
        "zlib_8_bytes": sum(len(zlib.compress(b"".join(parts[n : n + 8]), 1)) for n in range(0, 300, 8)) / 300,
    }


def flight(voxel_m: float, folder: Path) -> common.Row:
    """A flight with a flush after every 0.6 s: what the map's process pays for its journal."""
    settings = MapSettings(voxel_m=voxel_m)
    flush_ms, flush_cpu_ms, chunks, written, near_us = [], [], [], [], []
    with Journal.open(folder / f"flight-{voxel_m}", Header.of(settings)) as journal:
        paged = PagedMap(settings, journal)
        frames = tunnel_frames()
        paged.integrate(frames[0])
        paged.flush()
        for number, frame in enumerate(frames[1:], 1):
            paged.integrate(frame)
            start_s = time.thread_time()
            for _ in range(TESTS):
                paged._bring(frame.pose, paged._reach)  # noqa: SLF001 - the test alone, without the frame
            near_us.append(1e6 * (time.thread_time() - start_s) / TESTS)
            if number % FRAMES_A_FLUSH == 0:
                start_s, start_cpu_s = time.perf_counter(), time.thread_time()
                flushed = paged.flush()
                flush_cpu_ms.append(1000.0 * (time.thread_time() - start_cpu_s))
                flush_ms.append(1000.0 * (time.perf_counter() - start_s))
                chunks.append(flushed.chunks)
                written.append(flushed.bytes_written)
        return {
            "voxel_m": voxel_m,
            "flush_ms": float(np.median(flush_ms)),
            "flush_cpu_ms": float(np.median(flush_cpu_ms)),
            "flush_max_ms": float(np.max(flush_ms)),
            "chunks": int(np.median(chunks)),
            "kB": float(np.median(written)) / 1000.0,
            "B_per_chunk": sum(written) / sum(chunks),
            "near_test_us": float(np.median(near_us)),
        }


def repeated(piece: MapPiece, chunks: int) -> Iterator[MapPiece]:
    """The same chunks again and again, further along, until there are so many."""
    for number in range(-(-chunks // len(piece.chunks))):
        left = chunks - number * len(piece.chunks)
        yield MapPiece((piece.chunks + np.array([1000 * number, 0, 0], np.int32))[:left], piece.values[:left])


def opening(chunks: int, folder: Path) -> common.Row:
    """Opening a journal, and bringing back one region of it."""
    settings = MapSettings()
    piece = tunnel_piece(settings)
    path = folder / f"opening-{chunks}"
    start_s = time.perf_counter()
    with Journal.open(path, Header.of(settings)) as journal:
        for part in repeated(piece, chunks):
            journal.append(part)
        journal.commit()
        wrote_s = time.perf_counter() - start_s
    row: common.Row = {"chunks": chunks, "append_us": 1e6 * wrote_s / chunks}
    resident_mb = common.Usage.of(os.getpid()).rss_mb
    start_s, start_cpu_s = time.perf_counter(), time.thread_time()
    with Journal.read_only(path) as journal:
        row["open_s"] = time.perf_counter() - start_s
        row["open_cpu_s"] = time.thread_time() - start_cpu_s
        row |= {"MB": journal.bytes_on_disk / 1e6, "index_MB": journal.memory_bytes / 1e6}
        start_s = time.perf_counter()
        paged = PagedMap(settings, journal)
        row["resume_s"] = time.perf_counter() - start_s
        row["paged_MB"] = paged.memory_bytes / 1e6
        row["resident_MB"] = common.Usage.of(os.getpid()).rss_mb - resident_mb
        region = np.indices((8, 8, 8), np.int32).reshape(3, -1).T - np.array([0, 4, 4], np.int32)
        row["region_chunks"] = len(journal.read(region).chunks)
        row["region_ms"] = cpu_ms(lambda: journal.read(region))
    shutil.rmtree(path)
    return row


def main() -> None:
    """Measure all, print three tables, and write the figures down if asked."""
    parser = common.parser(__doc__)
    parser.add_argument("--folder", type=Path, help="measure on this disk instead of that of temporary files")
    arguments = parser.parse_args()
    print(f"{platform.machine()}, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f} at the start")
    with tempfile.TemporaryDirectory(dir=arguments.folder) as name:
        folder = Path(name)
        print(
            "\n300 chunks: encoded; as records with their sums; decoded; zlib of the same, each chunk and eight at once"
        )
        codings = [coding(voxel_m) for voxel_m in VOXELS_M]
        common.show(codings, list(codings[0]))
        print("\nflushes of 0.6 s of flight, and the test whether a frame needs anything")
        flights = [flight(voxel_m, folder) for voxel_m in VOXELS_M]
        common.show(flights, list(flights[0]))
        print("\nopening journals")
        openings = [opening(chunks, folder) for chunks in CHUNKS]
        common.show(openings, list(openings[0]))
    if arguments.json is not None:
        common.write(codings + flights + openings, arguments.json)


if __name__ == "__main__":
    main()
