"""What vehicles tell each other: its size, the bandwidth that it takes, and what sealing, opening and learning cost.

python -m bench.link.fleet
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from bench.common import say
from companion.clock import MonotonicClock
from companion.config.load import load
from companion.config.vary import vary
from companion.control.fleet import Report
from companion.control.sharing import MOST_TILES, TILE_CELLS, Claim, Frame, GroundNews, Tile
from companion.flight.company import REPORT_PERIOD_S, SHARING_PERIOD_S, Company
from companion.link.authority import Authority
from companion.link.certificates import Certificates
from companion.link.fleet_messages import FleetMessage
from companion.link.vehicle.bandwidth import OVERHEAD_BYTES
from companion.link.vehicle.fleet_guard import FleetGuard
from companion.model import Pose
from companion.pipeline import Explorer

TIMES = 300


def main() -> None:
    """Print it."""
    report, claim = Report(1234.567890123, 12.3456789012, -3.4567890123, 1.2345678901, 1.5), Claim(1.2, 3.4, 0.1, 20.0)
    near = FleetMessage(1, 10_000, report, claim).encode()
    ground = FleetMessage(1, 10_000, report, claim, _news()).encode()
    with tempfile.TemporaryDirectory() as folder:
        authority = Authority.make(Path(folder) / "authority")
        for number in (1, 2):
            authority.issue(f"drone{number}", "vehicle", Path(folder) / f"drone{number}", number)
        given = [Certificates(Path(folder) / f"drone{number}") for number in (1, 2)]
        for signed in (False, True):
            _print(signed, near, ground, given if signed else [None, None])
    _print_learning(near, ground)


def _print(signed: bool, near: bytes, ground: bytes, given: list[Certificates] | list[None]) -> None:
    one, two = (FleetGuard(f"drone{k + 1}", k + 1, f"{k:016x}", given[k]) for k in range(2))
    now_s, sizes, sealing_s, opening_s = 0.0, list[int](), list[float](), list[float]()
    while now_s < 60.0:
        now_s += REPORT_PERIOD_S
        began_s = time.perf_counter()
        data = one.sealed(near, now_s)
        sealing_s.append(time.perf_counter() - began_s)
        sizes.append(len(data))
        began_s = time.perf_counter()
        two.opened("drone1", data, now_s)
        opening_s.append(time.perf_counter() - began_s)
        one.opened("drone2", two.sealed(FleetMessage(2, 1, Report(now_s, 0.0, 0.0, 0.0)).encode(), now_s), now_s)
    least, most = min(sizes), max(sizes)
    near_kbps = 8e-3 * (sum(sizes) + len(sizes) * OVERHEAD_BYTES) / now_s
    ground_kbps = 8e-3 * (len(ground) + least - len(near) + OVERHEAD_BYTES) / SHARING_PERIOD_S
    say(
        f"{'signed' if signed else 'unsigned'}: where it is {least} to {most} bytes, {near_kbps:.0f} kbit/s to each "
        f"other vehicle; with {MOST_TILES + 1} tiles of ground {len(ground)} bytes, {ground_kbps:.0f} kbit/s more; "
        f"sealing {_ms(sealing_s, 0.5)} ms, opening {_ms(opening_s, 0.5)} ms"
    )


def _print_learning(near: bytes, ground: bytes) -> None:
    base = load(None, "flight").settings
    settings = vary(base, {"fleet.number": 2, "link.enabled": True}, lambda name: name)
    company = Company(settings, Explorer(settings, np.random.default_rng(1)), MonotonicClock())
    for flies in (False, True):
        company.see(1.0, Pose(1.0, 0.0, 0.0, 1.5, 0.0), 1.5, flies)
    for what, message in (("where another one is", near), (f"{MOST_TILES + 1} tiles of ground", ground)):
        took_s = []
        for _ in range(TIMES):
            began_s = time.perf_counter()
            company.on_message(message)
            took_s.append(time.perf_counter() - began_s)
        took_s = took_s[TIMES // 10 :]
        say(f"hearing {what}: {_ms(took_s, 0.5)} ms, 99 % {_ms(took_s, 0.99)} ms")


def _ms(values_s: list[float], share: float) -> str:
    return f"{1e3 * float(np.quantile(values_s, share)):.2f}"


def _news() -> GroundNews:
    """Ground as a tunnel leaves it: a stripe of each tile is known."""
    tiles = []
    for k in range(MOST_TILES + 1):
        cells = np.zeros((1, TILE_CELLS, TILE_CELLS), np.uint8)
        cells[:, 8:20] = 1
        cells[:, (7, 20)] = 2
        ground_dm = np.zeros((1, TILE_CELLS, TILE_CELLS), np.int16)
        ground_dm[:, 8:20] = np.random.default_rng(k).integers(-2, 3, (12, TILE_CELLS))
        tiles.append(Tile(k // 3, k % 3, cells, ground_dm))
    return GroundNews(Frame(1.0, 2.0, 3.0, 0.5), 0.5, -64.0, -32.0, tuple(tiles))


if __name__ == "__main__":
    main()
