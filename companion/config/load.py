"""Loading the configuration: one YAML file over a preset over the defaults.

Everything that is wrong is reported at once, each problem with the line that holds it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from companion.config.explain import explain, section_of
from companion.config.settings import Settings
from companion.config.source import Source, as_yaml, printable, read_text
from companion.errors import InputError

DEFAULT_PRESET = "flight"


@dataclass(frozen=True, slots=True)
class Loaded:
    """Effective settings, and the preset that lies below the file."""

    settings: Settings
    preset: str


def preset_names() -> tuple[str, ...]:
    """The presets that ship with the package, sorted."""
    names = (entry.name for entry in (files("companion.config") / "presets").iterdir())
    return tuple(sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml")))


def load_settings(file: Path | None = None, preset: str | None = None) -> Settings:
    """The effective settings: defaults < preset < file. See `load`."""
    return load(file, preset).settings


def load(file: Path | None = None, preset: str | None = None) -> Loaded:
    """The effective settings and the preset they rest on.

    Args:
        file: a YAML file; an empty one changes nothing. Its top-level key ``preset`` chooses the preset.
        preset: name of a preset; overrides the file's choice. Without any choice it is `DEFAULT_PRESET`.

    Raises:
        InputError: the file cannot be read or used. One line for each problem:
            ``FILE:LINE: key: what is wrong: value, bound; what to do``.
    """
    if preset is not None and preset not in preset_names():
        raise InputError(_unknown_preset(preset))
    source = Source("", "") if file is None else Source(printable(str(file)), read_text(file))
    own_preset = source.data.pop("preset", None)
    if own_preset is not None and own_preset not in preset_names():
        source.refuse(("preset",), _unknown_preset(own_preset))
        own_preset = None  # the rest of the file is still checked, over another preset
    name = preset or own_preset or DEFAULT_PRESET
    below = Source(
        f"preset {name}", (files("companion.config") / "presets" / f"{name}.yaml").read_text(encoding="utf-8")
    )

    merged = merge(below.data, _without_empty_sections(source.data, Settings))
    try:
        # Strict: "0.5" is no number and 1 is no bool. JSON, because strict Python input wants tuples and enum members.
        settings = Settings.model_validate_json(json.dumps(merged), strict=True)
    except ValidationError as error:
        explain(error.errors(include_url=False), source, below)
    source.raise_problems()
    return Loaded(settings, name)


def merge(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Both mappings, section by section; where both have a value, the upper one's."""
    merged = dict(below)
    for key, value in above.items():
        lower = merged.get(key)
        merged[key] = merge(lower, value) if isinstance(lower, Mapping) and isinstance(value, Mapping) else value
    return merged


def _without_empty_sections(data: dict[str, Any], model: type[BaseModel]) -> dict[str, Any]:
    """A section whose keys are all commented out is null in YAML; it means that nothing is changed there."""
    kept = {}
    for key, value in data.items():
        section = section_of(model.model_fields.get(key))
        if section is not None and isinstance(value, dict):
            kept[key] = _without_empty_sections(value, section)
        elif section is None or value is not None:
            kept[key] = value
    return kept


def _unknown_preset(name: object) -> str:
    return f"no preset is called {as_yaml(name)}; known: {', '.join(preset_names())}"
