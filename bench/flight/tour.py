"""A good inspection tour through a known mine, to compare explorations with: one line a world and seed.

python -m bench.flight.tour                                          # complex and slope, seed 1
python -m bench.flight.tour --worlds complex,random:1,path/to/mine.ply --seeds 1,2,3 --speed 1.0
"""

from __future__ import annotations

import time
from pathlib import Path

from bench.common import Row, parser, say, show


def main() -> None:
    """Plan, print the table."""
    made = parser(__doc__)
    made.add_argument("--preset", default="flight")
    made.add_argument("--config", type=Path, help="settings file of the vehicle, above the preset")
    made.add_argument("--worlds", default="complex,slope", help="names or mesh files, separated by commas")
    made.add_argument("--seeds", type=_numbers, default=(1,), metavar="N,N,...", help="of the missions: their starts")
    made.add_argument("--speed", type=float, metavar="M/S", help="else control.speed_mps")
    arguments = made.parse_args()
    if arguments.speed is not None and not 0.0 < arguments.speed < float("inf"):
        made.error(f"--speed {arguments.speed:g}: must be above 0, in m/s")
    from companion.config.load import load_settings
    from sitl.mines import load_world
    from sitl.tour.inspection import inspection

    settings = load_settings(arguments.config, arguments.preset)
    speed_mps = settings.control.speed_mps if arguments.speed is None else arguments.speed
    rows: list[Row] = []
    for world in arguments.worlds.split(","):
        for seed in arguments.seeds:
            began = time.perf_counter()
            tour = inspection(load_world(world, seed), settings, seed, speed_mps)
            rows.append(
                {
                    "world": world,
                    "seed": seed,
                    "t_tour_s": round(tour.time_s, 1),
                    "length_m": round(tour.length_m, 1),
                    "turned_rad": round(tour.turned_rad, 1),
                    "looks": tour.looks,
                    "share": round(tour.share, 4),
                    "least_d_m": round(tour.least_d_m, 2),
                    "speed_mps": speed_mps,
                    "runtime_s": round(time.perf_counter() - began, 1),
                }
            )
            say(f"{world} seed {seed}: {tour.time_s:.0f} s")
    show(rows, list(rows[0]), arguments.json)


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(number) for number in text.split(","))


if __name__ == "__main__":
    main()
