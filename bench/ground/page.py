"""The operator's page with a large map and five vehicles: ``python -m bench.ground.page [--voxels 10000000]``.

Each vehicle has mapped drifts beside each other, 3 m high, with so many occupied voxels in all. It then maps on, 0.8 m
a second, for as long as is measured. Printed are memory and processor time of the process that serves the page, how
long its turns take, and what Chromium needs: its memory, and the time from picture to picture while the camera turns.
Where there is no graphics card, Chromium draws with the processor, many times slower than a tablet does. The option
``--no-browser`` leaves it out.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import psutil
from numpy.typing import NDArray

from bench.common import Row, Usage, parser, quantiles, show
from companion.ground.page import PERIOD_S, GroundPage, serve
from companion.link.words import Answer, Command, Place, Telemetry
from companion.mapping.voxels.chunks import EDGE, OFFSETS
from companion.mapping.voxels.lookup import FREE, OCCUPIED, UNKNOWN
from companion.mapping.voxels.piece import MapSnapshot, MapSource
from companion.model import FloatArray
from companion.viewer.graphs import GraphLines
from sitl.launch.processes import free_tcp_port
from tests.shared.chromium import EXECUTABLE, Browser, browser

VOXEL_M = 0.1
VEHICLES = "Kobold", "Nix", "Gnom", "Wichtel", "Troll"
DRIFT_CHUNKS = 60
"""A drift is so long, and then another one begins beside it."""

HIGH = 2
"""Chunks above each other: 3.2 m."""

MEASURED_S = 20.0
COLUMNS = (
    *("occupied voxels", "points", "cubes, m", "voxels, MB", "RSS, MB", "first picture, s", "CPU idle, %", "CPU, %"),
    *("turn p50, ms", "turn p99, ms", "browser, MB", "picture p50, ms", "picture p99, ms"),
)


def section() -> NDArray[np.uint8]:
    """(2, 4096) the states of the two chunks over each other that 1.6 m of a drift are made of."""
    voxels = np.arange(HIGH)[:, None, None] * [0, 0, EDGE] + OFFSETS
    across, up = voxels[..., 1], voxels[..., 2]
    free = (across > 0) & (across < EDGE - 1) & (up > 0) & (up < 29)
    return np.where(free, FREE, np.where(up <= 29, OCCUPIED, UNKNOWN)).astype(np.uint8)


class Digging:
    """A vehicle whose map is a pattern; a `VehicleView`.

    Args:
        name: of the vehicle.
        number: of the vehicle.
        sections: how much it has mapped.
    """

    def __init__(self, name: str, number: int, sections: int) -> None:
        self.name = name
        self.age_s = self.map_age_s = 0.0
        self.map_number, self.doubt = 0, ""
        self.sections = sections
        self._number = number
        self._section = section()

    def chunks(self, first: int, last: int) -> NDArray[np.int32]:
        """(n, 3) of these sections."""
        numbers = np.arange(first, last)
        x, drift = numbers % DRIFT_CHUNKS, numbers // DRIFT_CHUNKS
        y = 2 * drift + self._number * 2 * (2 + 10_000 // DRIFT_CHUNKS)
        plan = np.stack([x, y], axis=1)
        return np.array([[x, y, z] for x, y in plan.tolist() for z in range(HIGH)], np.int32).reshape(-1, 3)

    @property
    def telemetry(self) -> Telemetry:
        """It flies at the end of what it has mapped."""
        x, y, _ = (self.chunks(self.sections - 1, self.sections)[0] * EDGE * VOXEL_M).tolist()
        return Telemetry(
            self.name,
            "bench",
            1,
            0.0,
            "exploring",
            x_m=x,
            y_m=y + 0.8,
            z_m=1.5,
            yaw_rad=0.0,
            d_m=0.7,
            margin_m=0.7,
            battery_percent=60.0,
            completeness=0.5,
        )

    def changed(self, revision: int) -> MapSnapshot:
        """The sections after the revision, which counts them."""
        sections = self.sections
        states = np.tile(self._section, (sections - revision, 1))
        return MapSnapshot(VOXEL_M, sections, self.chunks(revision, sections), states)

    def source(self) -> MapSource:
        """Nobody downloads it here."""
        raise NotImplementedError

    def way_m(self) -> FloatArray:
        """Through all drifts, a position each 1.6 m."""
        corners = self.chunks(0, self.sections)[::HIGH].astype(np.float64) * (EDGE * VOXEL_M)
        return np.asarray(corners + np.array([0.8, 0.8, 1.5]))

    def graph(self) -> Sequence[GraphLines]:
        """None."""
        return []

    def frontiers_m(self) -> Sequence[Place]:
        """None."""
        return []

    def ask(self, command: Command, on_answer: Callable[[Answer | None], None]) -> None:
        """Nobody commands it here."""
        del command
        on_answer(None)


class Station:
    """Five of them."""

    def __init__(self, voxels: int) -> None:
        each = int((section() == OCCUPIED).sum())
        sections = round(voxels / each / len(VEHICLES))
        self.known = [Digging(name, number, sections) for number, name in enumerate(VEHICLES)]
        self.occupied = sections * each * len(VEHICLES)

    def vehicles(self) -> Sequence[Digging]:
        """All."""
        return self.known


def turns_ms(page: GroundPage, station: Station, seconds: float, *, grows: bool) -> tuple[list[float], float]:
    """Turn after turn as `GroundPage.run` does it: how long each took, and the share of a core in percent."""
    before, took = Usage.of(psutil.Process().pid), []
    next_s = time.monotonic()
    while time.monotonic() < before.t_s + seconds:
        if grows and time.monotonic() >= next_s:
            next_s += 2.0
            for vehicle in station.known:
                vehicle.sections += 1
        began_s = time.perf_counter()
        page.turn()
        took.append(1000.0 * (time.perf_counter() - began_s))
        time.sleep(max(PERIOD_S - took[-1] / 1000.0, 0.01))
    after = Usage.of(psutil.Process().pid)
    return took, 100.0 * (after.cpu_s - before.cpu_s) / (after.t_s - before.t_s)


def pictures_ms(window: Browser, page: GroundPage) -> list[float]:
    """The time from picture to picture in the browser while everybody's camera turns around the map."""
    ends = threading.Event()

    def turn() -> None:
        turned = 0
        while not ends.wait(0.05):
            turned += 1
            for client in page.server.get_clients().values():
                middle = client.camera.look_at
                client.camera.position = middle + np.array(
                    [30.0 * np.cos(turned / 20), 30.0 * np.sin(turned / 20), 40.0]
                )
                client.camera.look_at = middle

    thread = threading.Thread(target=turn)
    thread.start()
    try:
        times = window.value(
            "new Promise((done) => { const times = []; const end = performance.now() + 15000;"
            " const next = (now) => { times.push(now); now < end ? requestAnimationFrame(next) : done(times); };"
            " requestAnimationFrame(next); })"
        )
    finally:
        ends.set()
        thread.join()
    return list(np.diff(times))


def measure(voxels: int, most_points: int, *, in_browser: bool) -> Row:
    """One map."""
    station = Station(voxels)
    with serve(station, "bench", "127.0.0.1", free_tcp_port(), most_points) as page:
        began_s = time.perf_counter()
        page.turn()
        while page.waiting:
            page.turn()
        first_s = time.perf_counter() - began_s
        _, idle = turns_ms(page, station, MEASURED_S, grows=False)
        took, growing = turns_ms(page, station, MEASURED_S, grows=True)
        row: Row = {
            "occupied voxels": station.occupied,
            "points": page.points,
            "cubes, m": page.cubes_m,
            "voxels, MB": round(page.memory_bytes / 1e6),
            "RSS, MB": round(Usage.of(psutil.Process().pid).rss_mb),
            "first picture, s": round(first_s, 1),
            "CPU idle, %": round(idle, 1),
            "CPU, %": round(growing, 1),
            **quantiles("turn", took),
        }
        if in_browser:
            with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, browser(Path(folder)) as window:
                window.size(1440, 900)
                window.open(f"http://127.0.0.1:{page.port}")
                window.wait_for("document.querySelector('canvas') !== null")
                time.sleep(20.0)
                pictures = quantiles("picture", pictures_ms(window, page))
                memory = sum(
                    process.memory_info().rss / 1e6
                    for process in psutil.Process().children(recursive=True)
                    if "--type=renderer" in process.cmdline()
                )
                row |= {"browser, MB": round(memory), **pictures}
        return row


def main() -> None:
    """Measure and print."""
    options = parser(__doc__)
    options.add_argument("--voxels", type=int, action="append", metavar="N", help="occupied, in all; may be repeated")
    options.add_argument("--points", type=int, default=1_000_000, metavar="N", help="most points shown")
    options.add_argument("--no-browser", action="store_true", help="without Chromium")
    given = options.parse_args()
    in_browser = EXECUTABLE is not None and not given.no_browser
    rows = [measure(voxels, given.points, in_browser=in_browser) for voxels in given.voxels or [1_000_000, 10_000_000]]
    show(rows, COLUMNS, given.json)


if __name__ == "__main__":
    main()
