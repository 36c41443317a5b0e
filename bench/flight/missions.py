"""Whole missions, many seeds: how complete, how near to the walls, how fast. One line a world, the worst in it.

python -m bench.flight.missions                                       # flight: six worlds, 20 seeds each
python -m bench.flight.missions --preset table_i --seeds 5
python -m bench.flight.missions --worlds complex --vehicles 3
python -m bench.flight.missions --worlds path/to/mine.ply --seeds 1
python -m bench.flight.missions --worlds path/to/small.ply --config vehicle.yaml   # another vehicle
"""

from __future__ import annotations

import statistics
from argparse import Namespace
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import TYPE_CHECKING

from bench.common import Row, camera_rate, parser, say, show, with_camera, write

if TYPE_CHECKING:
    from sitl.sim.simulation import Simulation

SLOW_MPS = 0.1
"""Below this a vehicle stands, or turns on the spot."""

WORLDS = ("complex", "slope", "room", "random:1", "random:2", "random:3")


def mission(
    world: str,
    seed: int,
    config: Path | None,
    preset: str,
    vehicles: int,
    limit_s: float,
    camera: tuple[int, int, float],
) -> Row:
    """Fly one mission and return its summary."""
    import numpy as np

    from companion.config.load import load_settings
    from sitl.mines import load_world
    from sitl.sim.simulation import Simulation

    settings = load_settings(config, preset)
    width_px, height_px, rate_hz = camera
    if width_px:
        settings = with_camera(settings, width_px=width_px, height_px=height_px, rate_hz=rate_hz)
    simulation = Simulation(load_world(world, seed), settings, seed, vehicles)
    simulation.run(limit_s)
    speeds_mps = np.concatenate([np.abs(flight.log.column("speed_mps")) for flight in simulation.flights])
    return {
        "preset": preset,
        **simulation.score(),
        "speed_mps": round(float(speeds_mps.mean()), 3),
        "slow_share": round(float(np.mean(speeds_mps < SLOW_MPS)), 3),
        "in_d_c_share": _share_below(simulation, settings.control.critical_margin_m),
    }


def _share_below(simulation: Simulation, critical_margin_m: float) -> float:
    import numpy as np

    true_d_m = np.concatenate([flight.log.column("true_d_m") for flight in simulation.flights])
    return round(float(np.mean(true_d_m[np.isfinite(true_d_m)] < critical_margin_m)), 5)


def flown(arguments: Namespace) -> Iterator[Row]:
    """Every mission that was asked for, as they end."""
    with ProcessPoolExecutor(arguments.jobs) as pool:
        jobs = [
            pool.submit(
                *(mission, world, seed, arguments.config, arguments.preset),
                *(arguments.vehicles, arguments.time_limit, arguments.camera),
            )
            for seed in range(1, arguments.seeds + 1)
            for world in arguments.worlds.split(",")
        ]
        for done, job in enumerate(as_completed(jobs), start=1):
            row = job.result()
            say(
                f"{done}/{len(jobs)} {row['world']} seed {row['seed']}: {row['ended_because']}, "
                f"completeness {row['completeness']}, least d {row['least_d_m']}"
            )
            yield row


def summary(world: str, rows: list[Row], critical_margin_m: float) -> Row:
    """One line of the table: worst values first, since the worst flight is what counts."""
    times = [float(str(row["completed_at_s"])) for row in rows if row["completed_at_s"] is not None]
    least = [float(str(row["least_d_m"])) for row in rows]
    low = [float(str(row["time_below_d_s_minus_15cm_fraction"])) for row in rows]
    time_s = [float(str(row["sim_time_s"])) for row in rows]
    gaps = [row["least_time_between_extensions_s"] for row in rows]
    line: Row = {
        "world": world,
        "missions": len(rows),
        "complete": sum(row["ended_because"] == "complete" for row in rows),
        "contacts": sum(int(str(row["contacts"])) for row in rows),
        "least compl.": min(float(str(row["completeness"])) for row in rows),
        "least d, m": min(least),
        "least clear., m": min(float(str(row["least_clearance_m"])) for row in rows),
        "below d_c": sum(d < critical_margin_m for d in least),
        "time in d_c": max(float(str(row["in_d_c_share"])) for row in rows),
        "v, m/s": statistics.mean(float(str(row["speed_mps"])) for row in rows),
        "slow share": max(float(str(row["slow_share"])) for row in rows),
        "most ext.": max(int(str(row["extensions"])) for row in rows),
        "least time betw., s": min((float(str(gap)) for gap in gaps if gap is not None), default=None),
        "worst low share": max(low),
        "low share": sum(share * t for share, t in zip(low, time_s, strict=True)) / sum(time_s),
        "t_f median, s": statistics.median(times) if times else None,
        "t_f worst, s": max(times) if times else None,
        "precision": statistics.median(float(str(row["precision"])) for row in rows),
        "accuracy, m": statistics.median(float(str(row["accuracy_m"])) for row in rows),
        "x real time": statistics.median(float(str(row["times_real_time"])) for row in rows),
    }
    apart = [row["least_distance_between_vehicles_m"] for row in rows]
    if any(value is not None for value in apart):
        line["least apart, m"] = min(float(str(value)) for value in apart if value is not None)
    return line


def main() -> None:
    """Fly, print the table, write the summaries of all missions."""
    made = parser(__doc__)
    made.add_argument("--preset", default="flight")
    made.add_argument("--config", type=Path, help="settings file of the vehicle, above the preset")
    made.add_argument("--worlds", default=",".join(WORLDS), help="names or mesh files, separated by commas")
    made.add_argument("--seeds", type=int, default=20, help="seeds 1 to N in each world")
    made.add_argument("--vehicles", type=int, default=1)
    made.add_argument("--time-limit", type=float, default=3600.0, help="simulated seconds")
    made.add_argument("--jobs", type=int, default=2, help="missions at a time")
    made.add_argument("--camera", type=camera_rate, default=(0, 0, 0.0), help="WIDTHxHEIGHT@HZ; else the preset's")
    arguments = made.parse_args()
    from companion.config.load import load_settings

    critical_margin_m = load_settings(arguments.config, arguments.preset).control.critical_margin_m
    rows: list[Row] = []
    for row in flown(arguments):
        rows.append(row)
        if arguments.json is not None:
            # Hours may go by: what has been flown is kept from now on.
            write(rows, arguments.json)
    rows.sort(key=lambda row: (str(row["world"]), int(str(row["seed"]))))
    worlds = dict.fromkeys(str(row["world"]) for row in rows)
    lines = [summary(world, [row for row in rows if row["world"] == world], critical_margin_m) for world in worlds]
    print(f"preset {arguments.preset}, {arguments.vehicles} vehicle(s), camera {rows[0]['camera']}")
    print(
        "low share: of the time below d_s - 0.15 m; below d_c: missions that ever were; time in d_c, slow share (below "
        f"{SLOW_MPS:g} m/s) and extensions: of the worst mission"
    )
    show(lines, max((list(line) for line in lines), key=len))
    if arguments.json is not None:
        write(rows, arguments.json)


if __name__ == "__main__":
    main()
