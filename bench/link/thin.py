"""The bandwidth that a map takes, and its age behind a thin link: ``python -m bench.link.thin``.

The tunnel of `bench.map.growth` is flown through at 0.5 m/s, ten images a second, with the map that is flown; its
journal is written each half second, as in flight. Vehicle's and ground's side of the link are the real ones, and
answers are signed; between them is a link that carries so many kbit/s and takes 20 ms each way; time is virtual.
Telemetry takes its part besides.
``age`` is that of the ground's map, asked each half second of the flight; ``coarse`` the share of the chunks of which
the ground showed the coarse picture only when the flight ended; ``caught up`` how long after the flight the maps were
equal, bit for bit. A link that carries 0 has no bound: what went over then is what the map takes.
"""

from __future__ import annotations

import tempfile
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.common import Row, parser, say, show
from bench.link.answers import both_ends
from bench.map.frames import camera_of
from bench.map.growth import BEND_M, HEIGHT_M, PERIOD_M, tunnel
from companion.config.link import LinkSettings
from companion.config.mapping import MapSettings
from companion.link.answering import opened_answer, sealed_answer
from companion.link.ground.sync import MapSync
from companion.link.map_wire import answer, asked, read_answer, read_ask
from companion.link.vehicle.bandwidth import OVERHEAD_BYTES
from companion.link.vehicle.map_teller import MapTeller
from companion.mapping.journal import Header, Journal
from companion.mapping.journal.paging import PagedMap
from companion.model import Camera, DepthFrame, Pose
from sitl.scene.render import DepthRenderer

SPEED_MPS, IMAGES_HZ = 0.5, 10.0
ONE_WAY_S = 0.02
TELEMETRY_BYTES = 800
POLL_S = FLUSH_S = 0.5
NONCE = "b" * 16
COLUMNS = (
    *("kbit/s", "flown, s", "map, kB", "sent, kB", "map, kbit/s", "age p50, s", "age p99, s", "coarse, %"),
    "caught up, s",
)


class VirtualClock:
    """Stands still until it is moved."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now_s(self) -> float:
        """The time."""
        return self.time_s

    async def sleep(self, time_s: float) -> None:
        """Nobody sleeps here."""
        raise NotImplementedError


class Flight:
    """A vehicle that flies and maps, as far as the time has come."""

    def __init__(self, folder: Path, camera: Camera) -> None:
        settings = MapSettings()
        self.journal = Journal.open(folder / "flight" / "map.journal", Header.of(settings))
        self._map = PagedMap(settings, self.journal)
        self._renderer = DepthRenderer(tunnel(), camera)
        self._camera = camera
        self._images = 0

    def until(self, t_s: float) -> None:
        """Take the images up to this time, and write what changed."""
        while self._images / IMAGES_HZ <= t_s:
            self._map.integrate(self._image(self._images / IMAGES_HZ))
            self._images += 1
        self._map.flush()

    def _image(self, t_s: float) -> DepthFrame:
        x_m = SPEED_MPS * t_s
        phase = 2.0 * np.pi * (x_m % PERIOD_M) / PERIOD_M
        slope = 2.0 * np.pi * BEND_M / PERIOD_M * np.cos(phase)
        heading_rad = float(np.arctan(slope) + 0.5 * np.sin(0.4 * t_s))
        inside = Pose(t_s, x_m % PERIOD_M, float(BEND_M * np.sin(phase)), 0.5 * HEIGHT_M, heading_rad)
        depth_m = self._renderer.render(inside)
        pose = Pose(t_s, x_m, inside.y_m, inside.z_m, heading_rad)
        return DepthFrame(t_s, depth_m, self._camera, pose)


def flown(kbps: float, seconds: float, camera: Camera) -> Row:
    """One flight over one link."""
    with tempfile.TemporaryDirectory(prefix="bench-link-") as name:
        folder, clock = Path(name), VirtualClock()
        flight = Flight(folder / "vehicle", camera)
        teller = MapTeller("0" * 16, flight.journal.folder, clock)
        seal, proofs = both_ends(folder / "keys")
        sync = MapSync(folder / "ground", "ground", clock)
        sync.follow("flight")
        ages_s: list[float] = []
        sent, next_flush_s, next_age_s, coarse, caught_up_s = 0, 0.0, 1.0, 0.0, 0.0
        while True:
            if clock.time_s >= next_flush_s:
                # Once more when it has landed, and then never.
                next_flush_s = np.inf if clock.time_s >= seconds else clock.time_s + FLUSH_S
                flight.until(min(clock.time_s, seconds))
                while teller.follow():
                    pass
            while next_age_s <= min(clock.time_s, seconds):
                ages_s.append(sync.age_s)
                next_age_s += 0.5
            if clock.time_s >= seconds and not coarse and sync.copy is not None:
                coarse = 100.0 * (1.0 - sync.copy.chunk_count / max(1, len(flight.journal.chunks)))
            ask = sync.next_ask()
            question = asked(replace(ask, nonce=NONCE))
            data = sealed_answer(seal, question, answer(*teller.tell(read_ask(question))))
            sent += len(data)
            took_s = 2.0 * ONE_WAY_S + _carried_s(len(data), kbps)
            clock.time_s += took_s
            opened = opened_answer(proofs, "drone1", question, data)
            assert opened is not None
            sync.take(ask, *read_answer(opened), len(data), took_s)
            if sync.has_all and ask.what == "chunks":
                if clock.time_s > seconds and next_flush_s == np.inf:
                    caught_up_s = clock.time_s - seconds
                    break
                clock.time_s += POLL_S
        assert sync.copy is not None
        assert sync.copy.sum == teller.sum
        sync.close()
        map_kb = flight.journal.live_bytes / 1e3
        flight.journal.close()
    return {
        "kbit/s": kbps or None,
        "flown, s": seconds,
        "map, kB": map_kb,
        "sent, kB": sent / 1e3,
        "map, kbit/s": 8e-3 * sent / clock.time_s,
        "age p50, s": float(np.percentile(ages_s, 50)),
        "age p99, s": float(np.percentile(ages_s, 99)),
        "coarse, %": coarse,
        "caught up, s": caught_up_s,
    }


def _carried_s(size_bytes: int, kbps: float) -> float:
    """How long a link needs for a message, beside the telemetry that it carries too."""
    if not kbps:
        return 0.0
    rate_hz = min(LinkSettings().telemetry_hz, 0.25 * 125.0 * kbps / TELEMETRY_BYTES)
    return (size_bytes + OVERHEAD_BYTES) / (125.0 * kbps - rate_hz * TELEMETRY_BYTES)


def measured(arguments: Namespace) -> list[Row]:
    """A flight for each link."""
    camera = camera_of(320, 240)
    rows = []
    for kbps in arguments.kbps:
        say(f"{arguments.seconds:g} s over {kbps:g} kbit/s")
        rows.append(flown(kbps, arguments.seconds, camera))
    return rows


def main() -> None:
    """Fly over each link, and print a row of it."""
    made = parser(__doc__)
    made.add_argument("--kbps", type=float, nargs="+", default=[0.0, 1000.0, 300.0, 100.0], metavar="N")
    made.add_argument("--seconds", type=float, default=120.0, metavar="S")
    arguments = made.parse_args()
    show(measured(arguments), COLUMNS, arguments.json)


if __name__ == "__main__":
    main()
