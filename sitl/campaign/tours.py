"""The good inspection tours that the missions of a campaign are compared with: one for each world, camera and speed.

The speed is that which the simulated vehicle reaches when v_c is commanded: one that the vehicle cannot fly at,
whatever chooses its way, would compare the vehicle with another one and not the choice with a good one.

They are planned by the same workers as fly, and kept as the missions are.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path

from companion.config.settings import Settings
from sitl.campaign import ledger
from sitl.campaign.mission import FAILED, Campaign, Mission, Row, failure
from sitl.mines import load_world
from sitl.report.cards import number
from sitl.tour.inspection import depends_on, inspection

NAME = "tours.jsonl"

PLANNED = "planned"


def representatives(campaign: Campaign) -> dict[int, Mission]:
    """Of each mission, by its number, that mission whose tour is the one to compare it with: the first of its kind.

    Seeds of one world share the tour from the start of the first: starts differ, tours by a few per cent. The world
    ``random`` is another one for every seed.
    """
    first: dict[object, Mission] = {}
    kinds: dict[str, object] = {}
    found = {}
    for mission in campaign.missions:
        if mission.settings_json not in kinds:
            settings = mission.settings
            kinds[mission.settings_json] = (_reached_mps(settings), depends_on(settings))
        drawn_by = mission.seed if mission.world == "random" else None
        found[mission.number] = first.setdefault(
            (mission.world, drawn_by, mission.site, kinds[mission.settings_json]), mission
        )
    return found


def plan_tour(mission: Mission) -> Row:
    """The figures of the tour of a mission; one that raises is told as one that failed, with its error."""
    began_s = time.perf_counter()
    try:
        world = load_world(mission.world, mission.seed, mission.site.start, mission.site.reading)
        speed_mps = _reached_mps(mission.settings)
        tour = inspection(world, mission.settings, mission.seed, speed_mps)
    except Exception as error:  # noqa: BLE001 - a mine for which there is no tour must not end the campaign
        return failure(f"{type(error).__name__}: {error}", traceback.format_exc())
    return {
        "ended_because": PLANNED,
        "tour_time_s": round(tour.time_s, 2),
        "tour_length_m": round(tour.length_m, 2),
        "tour_turned_rad": round(tour.turned_rad, 2),
        "tour_share": round(tour.share, 5),
        "tour_least_d_m": round(tour.least_d_m, 3),
        "tour_speed_mps": round(speed_mps, 3),
        "wall_time_s": round(time.perf_counter() - began_s, 2),
    }


def _reached_mps(settings: Settings) -> float:
    """The speed that the simulated vehicle reaches when v_c is commanded."""
    return settings.control.speed_mps * settings.sim.dynamics.speed_gain


def there(folder: Path) -> dict[int, Row]:
    """The tours in the folder of a campaign, by the number of the mission that each was planned for.

    Raises:
        InputError: their file is damaged.
    """
    return ledger.read(folder, NAME)


def planned(rows: Sequence[Row]) -> str:
    """What became of tours."""
    failed = sum(row["ended_because"] == FAILED for row in rows)
    return f"{len(rows) - failed} planned, {failed} failed"


def compared(campaign: Campaign, rows: Sequence[Row], tours: Mapping[int, Row]) -> list[Row]:
    """The rows with the tour of each and how much more the mission took, where there is a tour.

    ``time_ratio`` is t_f over the time of the tour, ``way_ratio`` the way flown over its length; both only where the
    map became complete.
    """
    if not tours:
        return list(rows)
    of = representatives(campaign)
    return [{**row, **_columns(row, tours.get(of[int(str(row["mission"]))].number, {}))} for row in rows]


def _columns(row: Row, tour: Row) -> Row:
    time_s, length_m = number(tour, "tour_time_s"), number(tour, "tour_length_m")
    t_f_s, way_m = number(row, "completed_at_s"), number(row, "path_length_m")
    return {
        "tour_time_s": time_s,
        "tour_length_m": length_m,
        "tour_share": number(tour, "tour_share"),
        "tour_speed_mps": number(tour, "tour_speed_mps"),
        "time_ratio": _ratio(t_f_s, time_s),
        "way_ratio": _ratio(None if t_f_s is None else way_m, length_m),
    }


def _ratio(value: float | None, to: float | None) -> float | None:
    return round(value / to, 3) if value is not None and to else None
