"""A second sortie, after one that had to turn back: against one that begins anew, and put back beside its place.

python -m bench.flight.sorties                                       # complex, seeds 1 to 3, 200 s, 0.3 m and 5 degrees
python -m bench.flight.sorties --worlds complex,slope --seeds 1 --first 300 --off 0.5 --turned 10
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bench.common import Row, parser, say, show
from companion.config.load import load_settings
from companion.model import Pose
from sitl.mines import World, load_world
from sitl.sim.earlier import Earlier
from sitl.sim.simulation import Simulation

SECOND = 100
"""The seed of a second sortie is so much larger: it has other noise and other draws."""


def main() -> None:
    """Fly, print the table."""
    made = parser(__doc__)
    made.add_argument("--worlds", default="complex", help="names, separated by commas")
    made.add_argument("--seeds", default="1,2,3", metavar="N,N,...", help="of the first sorties")
    made.add_argument("--first", type=float, default=200.0, metavar="SECONDS", help="when the first one turns back")
    made.add_argument("--off", type=float, default=0.3, metavar="M", help="put back so far beside")
    made.add_argument("--turned", type=float, default=5.0, metavar="DEGREES", help="and so far turned, to either side")
    made.add_argument("--voxel", type=float, default=0.2, metavar="M", help="of the map")
    arguments = made.parse_args()
    settings = load_settings()
    settings = settings.model_copy(
        update={
            "sim": settings.sim.model_copy(update={"ends": "done"}),
            "mapping": settings.mapping.model_copy(update={"voxel_m": arguments.voxel}),
        }
    )
    rows: list[Row] = []

    def fly(name: str, mine: World, seed: int, limit_s: float, earlier: Earlier | None = None) -> Simulation:
        say(f"{mine.name} seed {seed}: {name}")
        mission = Simulation(mine, settings, seed, earlier=earlier)
        mission.run(limit_s)
        mission.come_home()
        rows.append(_row(name, mission))
        return mission

    for world in arguments.worlds.split(","):
        for seed in map(int, arguments.seeds.split(",")):
            mine = load_world(world, seed)
            first = fly("first", mine, seed, arguments.first)
            log, left = first.flights[0].log, left_by(first)
            began = (float(log.column(name)[0]) for name in ("x_m", "y_m", "z_m", "yaw_rad"))
            mine = replace(mine, start=Pose(0.0, *began))
            limit_s = settings.sim.time_limit_s
            fly("second, anew", mine, seed + SECOND, limit_s)
            fly("second, goes on", mine, seed + SECOND, limit_s, left)
            for turned_deg in (-arguments.turned, arguments.turned):
                beside = put_back(mine, arguments.off, math.radians(turned_deg))
                fly(f"second, {arguments.off:g} m and {turned_deg:g} deg off", beside, seed + SECOND, limit_s, left)
    show(rows, list(rows[0]), arguments.json)


def left_by(mission: Simulation) -> Earlier:
    """What a mission of one vehicle leaves to the next."""
    flight = mission.flights[0]
    return Earlier(flight.navigator.known_ground.seen(), flight.map)


def put_back(mine: World, off_m: float, turned_rad: float) -> World:
    """The mine as a vehicle has it that stands so far beside where it takes itself to be, and turned."""
    start = mine.start
    assert start is not None
    cos, sin = math.cos(turned_rad), math.sin(turned_rad)
    vertices_m = mine.vertices_m.astype(np.float64)
    x_m, y_m = (vertices_m[:, :2] - (start.x_m, start.y_m)).T
    vertices_m[:, 0] = cos * x_m - sin * y_m + start.x_m + off_m
    vertices_m[:, 1] = sin * x_m + cos * y_m + start.y_m
    start = replace(start, x_m=start.x_m + off_m, yaw_rad=start.yaw_rad + turned_rad)
    return replace(mine, vertices_m=vertices_m.astype(np.float32), start=start)


def _row(name: str, mission: Simulation) -> Row:
    score = mission.score()
    home = mission.coming_home[0].score() if mission.coming_home else {}
    return {
        "world": mission.world.name,
        "seed": mission.seed,
        "sortie": name,
        "ended": mission.ended_because,
        "t_s": score["sim_time_s"],
        "99 % at, s": score["completed_at_s"],
        "share before": round(mission.progress[0][1], 3),
        "share": round(mission.completeness, 3),
        "off home, m": home.get("off_m"),
        "elsewhere": mission.flights[0].navigator.homing.lands_elsewhere,
        "least d, m": score["least_d_m"],
        "contacts": score["contacts"],
    }


if __name__ == "__main__":
    main()
