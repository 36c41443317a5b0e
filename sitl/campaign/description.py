"""What somebody asks of a campaign, in a YAML file or by options: read here, and refused where it says nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from companion.config.load import preset_names
from companion.config.source import as_yaml
from companion.errors import InputError
from sitl.campaign import ranges
from sitl.campaign.given import Given, of_file
from sitl.campaign.mission import Site
from sitl.mines.placing import Reading

KEYS = ("worlds", "seeds", "preset", "config", "vehicles", "time_limit_s", "settings", "draws", "cases")

_Parsed = TypeVar("_Parsed")


@dataclass(frozen=True, slots=True)
class Draw:
    """A setting that is drawn anew for every world and seed, evenly from ``low`` to ``high``; both may come."""

    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Description:
    """A campaign as it was asked for; each part of it can be used by itself.

    Attributes:
        worlds: as for ``companion sim --world``, and what was said of each.
        seeds: of the missions in each world.
        presets: each is flown; empty for the one that ``config`` chooses.
        config: the vehicle's settings file above the presets, or None.
        vehicles: how many fly in a mission.
        time_limit_s: simulated time; None leaves it to the settings.
        settings: full names of settings, and the values, each of which is flown with each of the others.
        draws: full names of settings that are drawn.
        cases: names of sets of settings, each of which is flown.
        places: where each key, each setting, each setting of a case and each world was given.
    """

    worlds: Mapping[str, Site] = field(default_factory=lambda: {"complex": Site()})
    seeds: tuple[int, ...] = tuple(range(1, 21))
    presets: tuple[str, ...] = ()
    config: Path | None = None
    vehicles: int = 1
    time_limit_s: float | None = None
    settings: Mapping[str, tuple[object, ...]] = field(default_factory=dict)
    draws: Mapping[str, Draw] = field(default_factory=dict)
    cases: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    places: Mapping[str, str] = field(default_factory=dict)

    def place(self, name: str, case: str = "") -> str:
        """Where a key, a world or a setting was given: the setting in a case, if it is there."""
        return self.places.get(f"{case}: {name}") or self.places.get(name, name)


def read(file: Path | None, options: Mapping[str, Given]) -> Description:
    """The campaign that a file describes, with what options say above it.

    Args:
        file: YAML with `KEYS`; paths in it begin where it is.
        options: by the same keys; ``settings`` and ``draws`` are added to those of the file.

    Raises:
        InputError: it says nothing that can be flown; one line for each problem, with its file and line or its option.
    """
    below = {} if file is None else of_file(file, KEYS)
    given = below | dict(options)
    problems, places = list[str](), {key: one.place for key, one in given.items()}

    def of(key: str, parse: Callable[[Given], _Parsed], otherwise: _Parsed) -> _Parsed:
        try:
            return parse(given[key]) if key in given else otherwise
        except InputError as error:
            problems.append(str(error))
            return otherwise

    def settings_of(key: str, parse: Callable[[Given], _Parsed]) -> dict[str, _Parsed]:
        found = dict[str, _Parsed]()
        for layer in (below, options):
            try:
                for name, part in layer[key].settings(_EXAMPLES[key]) if key in layer else ():
                    found[name], places[name] = parse(part), part.place
            except InputError as error:
                problems.append(str(error))
        return found

    plain = Description()
    described = Description(
        worlds=of("worlds", lambda one: _worlds(one, places), plain.worlds),
        seeds=of("seeds", lambda one: ranges.seeds(one.value, one.place), plain.seeds),
        presets=of("preset", _presets, plain.presets),
        config=of("config", _config, plain.config),
        vehicles=of("vehicles", _vehicles, plain.vehicles),
        time_limit_s=of("time_limit_s", _time_limit_s, plain.time_limit_s),
        settings=settings_of("settings", _alternatives),
        draws=settings_of("draws", _draw),
        cases=of("cases", lambda one: _cases(one, places), plain.cases),
        places=places,
    )
    problems += _twice(described)
    if problems:
        raise InputError("\n".join(problems))
    return described


_EXAMPLES = {
    "settings": "control.margin_m: [0.8, 1.0]",
    "draws": "control.margin_m: [0.8, 1.2]",
    "cases": "drift: {sim.noise.pose_drift_share: 0.02}",
}


def _worlds(given: Given, places: dict[str, str]) -> dict[str, Site]:
    found = dict[str, Site]()
    for number in range(len(given.value) if isinstance(given.value, list) else 1):
        item = given.item(number)
        site = Site()
        if isinstance(item.value, dict):
            name, site = _with_site(item.value, item.place)
            names: tuple[str, ...] = (name,)
        else:
            names = ranges.names(item.value, item.place)
        for name in names:
            # Workers may have been started in other folders.
            world = str((given.beside / name).absolute()) if Path(name).suffix else name
            if world in found:
                raise InputError(f"{item.place}: {name} is there twice; no mission is flown twice")
            found[world], places[world] = site, item.place
    if not found:
        raise InputError(f"{given.place}: there is no world; give at least one")
    return found


def _with_site(item: Mapping[str, object], place: str) -> tuple[str, Site]:
    name, start, up = item.get("world"), item.get("start"), item.get("up")
    numbers = [_number(value) for value in start] if isinstance(start, list) else []
    scale, voxel_m = (_number(item.get(key)) for key in ("scale", "cloud_voxel"))
    unusable = (
        not isinstance(name, str)
        or not item.keys() <= {"world", "start", "scale", "up", "cloud_voxel"}
        or ("start" in item and (len(numbers) != 4 or None in numbers))
        or ("scale" in item and scale is None)
        or ("cloud_voxel" in item and voxel_m is None)
        or up not in (None, "y", "z")
    )
    if unusable:
        raise InputError(
            f"{place}: {as_yaml(item)} cannot be used; give a name, or {{world: NAME|MESH, start: [x, y, z, yaw]}} in "
            "m and rad, with scale: FACTOR, up: y|z and cloud_voxel: M where a file needs them"
        )
    try:
        reading = Reading(scale, "y" if up == "y" else "z" if up == "z" else None, voxel_m or Reading().cloud_voxel_m)
    except InputError as error:
        raise InputError(f"{place}: {error}") from None
    x_m, y_m, z_m, yaw_rad = (value or 0.0 for value in numbers) if numbers else (0.0,) * 4
    return str(name), Site((x_m, y_m, z_m, yaw_rad) if numbers else None, reading)


def _presets(given: Given) -> tuple[str, ...]:
    found = ranges.names(given.value, given.place)
    for name in found:
        if name not in preset_names():
            known = ", ".join(preset_names())
            raise InputError(f"{given.place}: no preset is called {as_yaml(name)}; known: {known}")
    return found


def _config(given: Given) -> Path:
    if not isinstance(given.value, str):
        raise InputError(f"{given.place}: {as_yaml(given.value)} is no file; give the path of a settings file")
    return given.beside / given.value


def _vehicles(given: Given) -> int:
    if not isinstance(given.value, int) or isinstance(given.value, bool) or given.value < 1:
        raise InputError(f"{given.place}: {as_yaml(given.value)} vehicles; give a whole number from 1 on")
    return given.value


def _time_limit_s(given: Given) -> float:
    value = _number(given.value)
    if value is None or value <= 0.0:
        raise InputError(f"{given.place}: {as_yaml(given.value)}: must be a time above 0, in s")
    return value


def _alternatives(given: Given) -> tuple[object, ...]:
    values = tuple(given.value) if isinstance(given.value, list) else (given.value,)
    if not values:
        raise InputError(f"{given.place}: an empty list; give at least one value")
    if twice := next((value for i, value in enumerate(values) if value in values[:i]), None):
        raise InputError(f"{given.place}: {as_yaml(twice)} is there twice; no mission is flown twice")
    return values


def _draw(given: Given) -> Draw:
    ends = [_number(value) for value in given.value] if isinstance(given.value, list) else []
    if len(ends) == 2 and ends[0] is not None and ends[1] is not None and ends[0] < ends[1]:
        return Draw(ends[0], ends[1])
    raise InputError(
        f"{given.place}: {as_yaml(given.value)} cannot be drawn from; give the least and the greatest value, as in "
        "[0.8, 1.2]"
    )


def _cases(given: Given, places: dict[str, str]) -> dict[str, dict[str, object]]:
    found = dict[str, dict[str, object]]()
    for case, part in given.mapping(_EXAMPLES["cases"]):
        found[case] = {}
        if part.value is None:
            continue
        for name, value in part.settings(_EXAMPLES["cases"]):
            found[case][name], places[f"{case}: {name}"] = value.value, value.place
    if not found:
        raise InputError(f"{given.place}: there is no case; give at least one: {_EXAMPLES['cases']}")
    return found


def _twice(described: Description) -> list[str]:
    """What is wrong with settings that are given in two ways."""
    in_cases = {name: case for case, values in described.cases.items() for name in values}
    ways = (("settings", set(described.settings)), ("draws", set(described.draws)), ("cases", set(in_cases)))
    return [
        f"{described.place(name, in_cases.get(name, ''))}: {name} is under {one} and under {other}; leave one"
        for i, (one, names) in enumerate(ways)
        for other, others in ways[:i]
        for name in sorted(names & others)
    ]


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
