"""From what was asked to missions: every combination, and every one of them is known to be flyable before the first."""

from __future__ import annotations

import hashlib
import itertools
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import partial

import numpy as np

from companion.config.load import load
from companion.config.settings import Settings
from companion.config.source import MAX_PROBLEMS
from companion.config.vary import value_of, vary
from companion.errors import InputError
from sitl.campaign import ranges
from sitl.campaign.description import Description, Draw
from sitl.campaign.mission import Campaign, Mission, plain
from sitl.campaign.software import software
from sitl.mines import World, load_world
from sitl.scene.raycast import RayCaster
from sitl.sim.start import check_room, start_poses

MOST_MISSIONS = 100_000
"""A campaign of more is a typing error: a hundred computers would need weeks."""


@dataclass(frozen=True, slots=True)
class _Variant:
    """One combination of preset, case and values."""

    preset: str
    case: str
    values: Mapping[str, object]
    settings: Settings


def plan(described: Description) -> Campaign:
    """All missions of a campaign.

    Raises:
        InputError: some of it cannot be flown; one line for each problem.
    """
    problems = dict[str, None]()
    variants = list(_variants(described, problems))
    _raise(problems)
    count = len(variants) * len(described.worlds) * len(described.seeds)
    if count > MOST_MISSIONS:
        raise InputError(f"{count} missions are more than {MOST_MISSIONS}; make several campaigns of them")
    worlds = {name: _world(name, described, variants, problems) for name in described.worlds}
    _raise(problems)
    missions = tuple(_missions(described, variants, problems))
    _raise(problems)
    shown = asdict(described) | {
        "presets": sorted({variant.preset for variant in variants}),
        "seeds": ranges.listed(described.seeds),
        "config": None if described.config is None else _digest(described.config.read_bytes()),
        "worlds": {name: _world_stamp(world) for name, world in worlds.items()},
        "software": software(),
    }
    del shown["places"]
    several = ["preset"] * (len(described.presets) > 1) + ["case"] * (len(described.cases) > 1)
    several += [name for name, values in described.settings.items() if len(values) > 1]
    return Campaign(missions, {key: plain(value) for key, value in shown.items()}, tuple(several))


def _variants(described: Description, problems: dict[str, None]) -> Iterator[_Variant]:
    cases = described.cases or {"": {}}
    for preset, case in itertools.product(described.presets or (None,), cases):
        loaded = load(described.config, preset)
        largest = loaded.settings.fleet.largest_group
        if described.vehicles > largest:
            problems[
                f"{described.place('vehicles')} {described.vehicles}: fleet.largest_group = {largest} is the most "
                "that the height layers have room for; allow more there, with control.vertical_margin_m small enough"
            ] = None
        for chosen in itertools.product(*described.settings.values()):
            values = dict(zip(described.settings, chosen, strict=True)) | dict(cases[case])
            try:
                settings = vary(loaded.settings, values, partial(described.place, case=case))
                for name, draw in described.draws.items():
                    # Both ends, so that what is out of bounds is found whatever the seeds draw.
                    for end in (draw.low, draw.high):
                        vary(settings, {name: _drawn_value(settings, name, end)}, described.place)
            except InputError as error:
                problems.update(dict.fromkeys(str(error).splitlines()))
            else:
                yield _Variant(loaded.preset, case, values, settings)


def _missions(described: Description, variants: list[_Variant], problems: dict[str, None]) -> Iterator[Mission]:
    texts = [variant.settings.model_dump_json() for variant in variants]
    numbers = itertools.count()
    for seed, (world, site), (variant, text) in itertools.product(
        described.seeds, described.worlds.items(), list(zip(variants, texts, strict=True))
    ):
        settings, values = variant.settings, dict(variant.values)
        if described.draws:
            drawn = {name: _drawn(draw, settings, name, world, seed) for name, draw in described.draws.items()}
            values |= drawn
            try:
                settings = vary(settings, drawn, described.place)
                text = settings.model_dump_json()
            except InputError as error:
                problems.update(dict.fromkeys(str(error).splitlines()))
                continue
        limit_s = settings.sim.time_limit_s if described.time_limit_s is None else described.time_limit_s
        yield Mission(
            number=next(numbers),
            world=world,
            site=site,
            seed=seed,
            preset=variant.preset,
            case=variant.case,
            values=values,
            settings_json=text,
            vehicles=described.vehicles,
            time_limit_s=limit_s,
        )


def _drawn(draw: Draw, settings: Settings, name: str, world: str, seed: int) -> object:
    """The same for all variants: what is compared flies under the same conditions."""
    rng = np.random.default_rng([seed, zlib.crc32(world.encode()), zlib.crc32(name.encode())])
    if isinstance(value_of(settings, name), int):
        return int(rng.integers(round(draw.low), round(draw.high), endpoint=True))
    return float(f"{rng.uniform(draw.low, draw.high):.6g}")


def _drawn_value(settings: Settings, name: str, end: float) -> object:
    return int(end) if isinstance(value_of(settings, name), int) and end.is_integer() else end


def _world(name: str, described: Description, variants: list[_Variant], problems: dict[str, None]) -> World | None:
    """The world, so that one in which nothing can start is found now; none for ``random``, which every seed draws."""
    if name == "random":
        return None
    try:
        site = described.worlds[name]
        world = load_world(name, described.seeds[0], site.start, site.reading)
        caster = RayCaster(world)
        for variant in variants:
            rng = np.random.default_rng(described.seeds[0])
            first = start_poses(world, caster, variant.settings, described.vehicles, rng)[0]
            check_room(world, caster, first, variant.settings)
    except InputError as error:
        problems[f"{described.place(name)}: {error}"] = None
        return None
    return world


def _world_stamp(world: World | None) -> str:
    if world is None:
        return "drawn by the seed"
    return _digest(world.vertices_m.tobytes(), world.triangles.tobytes(), repr(world.start).encode())


def _digest(*parts: bytes) -> str:
    stamp = hashlib.sha256()
    for part in parts:
        stamp.update(part)
    return stamp.hexdigest()[:16]


def _raise(problems: Mapping[str, None]) -> None:
    if problems:
        listed = list(problems)
        more = [f"and {len(listed) - MAX_PROBLEMS} more"] if len(listed) > MAX_PROBLEMS else []
        raise InputError("\n".join(listed[:MAX_PROBLEMS] + more))
