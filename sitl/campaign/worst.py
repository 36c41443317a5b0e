"""The missions of a campaign at which somebody should look, and how each is flown again."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from companion.config.show import dump_yaml
from companion.mapping.files.whole import whole_file
from sitl.campaign.mission import FAILED, Campaign, Mission, Row
from sitl.mines.placing import Reading
from sitl.report.cards import number

AGAIN = "again"
"""The folder with the settings of these missions."""

WORST = 3
"""How many are named in each respect."""


@dataclass(frozen=True, slots=True)
class Worst:
    """A mission, and in which respects it is among the worst."""

    row: Row
    mission: Mission
    why: Sequence[str]


@dataclass(frozen=True, slots=True)
class _Respect:
    """What can be bad about a mission: ``badness`` is None where it is not, and grows the worse it is."""

    badness: Callable[[Row], float | None]
    why: Callable[[Row], str]


def _failed(row: Row) -> float | None:
    return 0.0 if row["ended_because"] == FAILED else None


def _contact(row: Row) -> float | None:
    return number(row, "contacts") or None


def _collision(row: Row) -> float | None:
    return number(row, "collisions") or None


def _incomplete(row: Row) -> float | None:
    return None if number(row, "completed_at_s") is not None else _negative(row, "completeness")


def _negative(row: Row, name: str) -> float | None:
    value = number(row, name)
    return None if value is None else -value


_RESPECTS = (
    _Respect(_contact, lambda row: f"contact, least distance {row['least_d_m']} m"),
    _Respect(_collision, lambda row: f"collision, {row['least_distance_between_vehicles_m']} m from middle to middle"),
    _Respect(_failed, lambda row: str(row.get("error", "failed"))),
    _Respect(_incomplete, lambda row: f"{row['ended_because']}, completeness {row['completeness']}"),
    _Respect(lambda row: _negative(row, "least_d_m"), lambda row: f"least distance {row['least_d_m']} m"),
    _Respect(lambda row: number(row, "completed_at_s"), lambda row: f"t_f {row['completed_at_s']} s"),
    _Respect(lambda row: number(row, "path_length_m"), lambda row: f"way of {row['path_length_m']} m"),
)


def worst_of(campaign: Campaign, rows: Sequence[Row]) -> list[Worst]:
    """The worst missions, the gravest respect first; each is named once."""
    found: dict[int, list[str]] = {}
    by_number = {int(str(row["mission"])): row for row in rows}
    for respect in _RESPECTS:
        bad = [(badness, which) for which, row in by_number.items() if (badness := respect.badness(row)) is not None]
        for _, which in sorted(bad, key=lambda one: (-one[0], one[1]))[:WORST]:
            found.setdefault(which, []).append(respect.why(by_number[which]))
    return [Worst(by_number[which], campaign.missions[which], why) for which, why in found.items()]


def again(folder: Path, mission: Mission) -> str:
    """The command that flies a mission again, with its map and its own report."""
    words = ["companion", "sim", "--world", mission.world, "--seed", str(mission.seed)]
    if mission.site.start is not None:
        words += ["--start", *map(repr, mission.site.start)]
    if mission.site.reading != Reading():
        words += mission.site.reading.options()
    words += ["--preset", mission.preset, "--config", str(folder / settings_file(mission))]
    words += ["--time-limit", repr(mission.time_limit_s)]
    if mission.vehicles > 1:
        words += ["--vehicles", str(mission.vehicles)]
    return shlex.join(words)


def settings_file(mission: Mission) -> Path:
    """Where the settings of a mission lie in the folder of its campaign."""
    return Path(AGAIN) / f"{mission.number}.yaml"


def write_settings(folder: Path, worst: Sequence[Worst]) -> None:
    """Write what the commands of `again` read.

    Raises:
        OSError: it cannot be written.
    """
    (folder / AGAIN).mkdir(exist_ok=True)
    for one in worst:
        if not (folder / settings_file(one.mission)).exists():
            with whole_file(folder / settings_file(one.mission)) as file:
                file.write(dump_yaml(one.mission.settings).encode())
