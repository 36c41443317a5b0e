"""What a campaign is made of: its missions, and the rows that they leave."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from companion.config.settings import Settings
from sitl.mines.placing import Reading
from sitl.mines.start_beside import Start

Row = dict[str, object]
"""Names of figures and their values, as JSON holds them: None where something is not known."""

FAILED = "failed"
"""Why a mission has ended that raised an error, or whose processes died."""


@dataclass(frozen=True, slots=True)
class Site:
    """What a campaign says of a world beside its name.

    Attributes:
        start: x, y, z in m and yaw in rad, or None for the world's own.
        reading: how its file is read, where it is a mesh or a cloud.
    """

    start: Start | None = None
    reading: Reading = field(default_factory=Reading)


@dataclass(frozen=True, slots=True)
class Mission:
    """Everything that decides how a mission goes: flown anywhere, in any order, it leaves the same row.

    Attributes:
        number: its place in the campaign, from 0.
        world: as for ``companion sim --world``.
        site: where in it, and how its file is read.
        seed: draws start, noise and every choice.
        preset: name of the preset below all settings.
        case: name of the case that it belongs to; empty where there are none.
        values: full names of the settings that the campaign changes, and their values here.
        settings_json: all settings.
        vehicles: how many fly.
        time_limit_s: simulated time.
    """

    number: int
    world: str
    site: Site
    seed: int
    preset: str
    case: str
    values: Mapping[str, object]
    settings_json: str
    vehicles: int
    time_limit_s: float

    @property
    def settings(self) -> Settings:
        """All settings."""
        return Settings.model_validate_json(self.settings_json, strict=True)

    def given(self) -> Row:
        """The columns that say which mission it was; those of settings have their full names."""
        return {
            "mission": self.number,
            "given_world": self.world,
            "world": self.world,
            "seed": self.seed,
            "preset": self.preset,
            "case": self.case,
            "vehicles": self.vehicles,
            "time_limit_s": self.time_limit_s,
            **{name: plain(value) for name, value in self.values.items()},
        }


@dataclass(frozen=True, slots=True)
class Campaign:
    """What is flown.

    Attributes:
        missions: in the order in which they are begun: of every group of missions the first seed comes first, so that a
            campaign that is ended early still compares them.
        identity: what decides about the missions, as JSON: two campaigns are the same where this is.
        several: what is compared: ``preset``, ``case`` and full names of settings, where there is more than one value.
    """

    missions: tuple[Mission, ...]
    identity: Mapping[str, object]
    several: tuple[str, ...]


def failure(error: str, details: str | None = None) -> Row:
    """The figures of a mission that has none."""
    return {"ended_because": FAILED, "error": error, "error_details": details}


def plain(value: object) -> object:
    """The value as JSON holds it: what is not finite is not known."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Mapping):
        return {str(name): plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
