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
from pathlib import Path

from bench.common import Row, camera_rate, parser, say, show, write
from companion.errors import CompanionError
from sitl.campaign.description import read
from sitl.campaign.flight import SLOW_MPS, fly
from sitl.campaign.given import Given
from sitl.campaign.mission import FAILED
from sitl.campaign.plan import plan
from sitl.campaign.run import run
from sitl.campaign.workers import LocalWorkers

WORLDS = ("complex", "slope", "room", "random:1", "random:2", "random:3")


LEFT_OUT = ("settings", "error", "error_details")
"""Columns of a campaign that are not written to the JSON file."""


def flown(arguments: Namespace) -> list[Row]:
    """Every mission that was asked for that did not fail; written as they end, since hours may go by."""
    given = {
        "worlds": Given(arguments.worlds, "--worlds"),
        "seeds": Given(arguments.seeds, "--seeds"),
        "preset": Given(arguments.preset, "--preset"),
        "vehicles": Given(arguments.vehicles, "--vehicles"),
        "time_limit_s": Given(arguments.time_limit, "--time-limit"),
    }
    if arguments.config is not None:
        given["config"] = Given(str(arguments.config), "--config")
    if arguments.camera is not None:
        camera = zip(("width_px", "height_px", "rate_hz"), arguments.camera, strict=True)
        given["settings"] = Given({f"sensors.camera.{name}": value for name, value in camera}, "--camera")
    missions = plan(read(None, given)).missions
    rows: list[Row] = []
    ended = 0

    def keep(row: Row) -> None:
        nonlocal ended
        ended += 1
        place = f"{ended}/{len(missions)} {row['world']} seed {row['seed']}"
        if row["ended_because"] == FAILED:
            say(f"{place}: {FAILED}: {row['error_details'] or row['error']}")
            return
        say(f"{place}: {row['ended_because']}, completeness {row['completeness']}, least d {row['least_d_m']}")
        rows.append({name: value for name, value in row.items() if name not in LEFT_OUT})
        if arguments.json is not None:
            write(rows, arguments.json)

    with LocalWorkers(arguments.jobs) as workers:
        run(missions, workers, fly, keep)
    return sorted(rows, key=lambda row: (str(row["world"]), int(str(row["seed"]))))


def summary(world: str, rows: list[Row]) -> Row:
    """One line of the table: worst values first, since the worst flight is what counts."""
    times = [float(str(row["completed_at_s"])) for row in rows if row["completed_at_s"] is not None]
    least = [float(str(row["least_d_m"])) for row in rows]
    low = [float(str(row["time_below_d_s_minus_15cm_fraction"])) for row in rows]
    time_s = [float(str(row["sim_time_s"])) for row in rows]
    ways_m = [float(str(row["path_length_m"])) for row in rows]
    gaps = [row["least_time_between_extensions_s"] for row in rows]
    whole = [float(str(row["completeness_when_done"])) for row in rows if row["completeness_when_done"] is not None]
    errors = [float(str(row["estimate_error"])) for row in rows if row["estimate_error"] is not None]
    line: Row = {
        "world": world,
        "missions": len(rows),
        "complete": len(times),
        "contacts": sum(int(str(row["contacts"])) for row in rows),
        "least compl.": min(float(str(row["completeness"])) for row in rows),
        "least d, m": min(least),
        "least clear., m": min(float(str(row["least_clearance_m"])) for row in rows),
        "below d_c": sum(d < float(str(row["critical_margin_m"])) for d, row in zip(least, rows, strict=True)),
        "time in d_c": max(float(str(row["in_d_c_share"])) for row in rows),
        "v, m/s": statistics.mean(float(str(row["speed_mps"])) for row in rows),
        "slow share": max(float(str(row["slow_share"])) for row in rows),
        "most ext.": max(int(str(row["extensions"])) for row in rows),
        "least time betw., s": min((float(str(gap)) for gap in gaps if gap is not None), default=None),
        "worst low share": max(low),
        "low share": sum(share * t for share, t in zip(low, time_s, strict=True)) / sum(time_s),
        "t_f median, s": statistics.median(times) if times else None,
        "t_f worst, s": max(times) if times else None,
        "done": len(whole),
        "least when done": min(whole, default=None),
        "est. error median": statistics.median(errors) if errors else None,
        "est. error worst": max(errors, key=abs, default=None),
        "way median, m": statistics.median(ways_m),
        "way worst, m": max(ways_m),
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
    made.add_argument("--camera", type=camera_rate, help="WIDTHxHEIGHT@HZ; else the preset's")
    arguments = made.parse_args()
    try:
        rows = flown(arguments)
    except CompanionError as error:
        raise SystemExit(str(error)) from None
    if not rows:
        raise SystemExit("every mission failed")
    worlds = dict.fromkeys(str(row["world"]) for row in rows)
    lines = [summary(world, [row for row in rows if row["world"] == world]) for world in worlds]
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
