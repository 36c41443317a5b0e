"""Loading the configuration: one YAML file over a preset over the defaults.

Everything that is wrong is reported at once, in words for people: the line that holds it, what is wrong, what to do.
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from companion.config.settings import Settings
from companion.config.source import MAX_SHOWN, Key, Source, as_yaml, printable, read_text
from companion.errors import InputError

DEFAULT_PRESET = "flight"

_EXPECTED = {
    "bool_type": "true or false",
    "finite_number": "a finite number",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "model_type": "keys and values, indented below it",
    "string_type": "text",
    "tuple_type": "a list",
}
_BOUNDS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
_OUT_OF_RANGE = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")


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
        _explain(error.errors(include_url=False), source, below)
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
        section = _section_of(model.model_fields.get(key))
        if section is not None and isinstance(value, dict):
            kept[key] = _without_empty_sections(value, section)
        elif section is None or value is not None:
            kept[key] = value
    return kept


def _unknown_preset(name: object) -> str:
    return f"no preset is called {as_yaml(name)}; known: {', '.join(preset_names())}"


def _explain(errors: Iterable[ErrorDetails], source: Source, below: Source) -> None:
    """Record what pydantic found in the merged settings, each at the place that its value comes from.

    Args:
        errors: of `Settings`, validated from the file merged over its preset.
        source: the file, which takes the messages.
        below: the preset.
    """

    def origin(key: Key) -> str:
        if key in source.lines:
            return f"{source.name}:{source.line(key)}"
        return below.name if key in below.lines else "default"

    for error in errors:
        key = tuple(str(part) for part in error["loc"])
        if error["type"] == "settings":
            keys = [tuple(name.split(".")) for name in error["ctx"]["keys"]]
            if ("preset",) not in source.refused:  # else the numbers below the file are not the intended ones
                source.refuse_together(keys, error["msg"], origin)
        elif error["type"] == "extra_forbidden":
            source.refuse(key, unknown_key(key))
        else:
            source.refuse(key, bad_value(key, error), origin(key))


def _section_of(field: FieldInfo | None) -> type[BaseModel] | None:
    """The model of a field that is a section of its own."""
    kind = field.annotation if field is not None else None
    return kind if isinstance(kind, type) and issubclass(kind, BaseModel) else None


def unknown_key(key: Key) -> str:
    """What may have been meant: the same name in another section, or a similar one in this."""
    *section, name = key
    model = _walk(tuple(section))[0]
    elsewhere = [path for path in _paths(Settings) if path.rpartition(".")[2] == name]
    similar = difflib.get_close_matches(name[:MAX_SHOWN], model.model_fields, n=1)
    if elsewhere or similar:
        return f"unknown key; did you mean {elsewhere[0] if elsewhere else '.'.join((*section, similar[0]))}?"
    return f"unknown key; known here: {', '.join(model.model_fields)}"


def bad_value(key: Key, error: ErrorDetails) -> str:
    """What is wrong with a value: the value, the bound or what is expected, and what the key means."""
    field = _walk(key)[1]
    value = as_yaml(error["input"])
    meaning = f". Meaning: {field.description}" if field is not None and field.description else ""
    if field is not None and error["type"] in _OUT_OF_RANGE:
        bounds = (
            f"{sign} {getattr(limit, name):g}"
            for limit in field.metadata
            for name, sign in _BOUNDS.items()
            if hasattr(limit, name)
        )
        return f"out of range: value {value}, bound {' and '.join(bounds)}; choose a value within it{meaning}"
    expected = _EXPECTED.get(error["type"], error["msg"].removeprefix("Input should be "))
    return f"not usable: value {value}, expected {expected}; correct it{meaning}"


def _walk(key: Key) -> tuple[type[BaseModel], FieldInfo | None]:
    """The innermost section on the way to a key, and the key's field if there is one."""
    model: type[BaseModel] = Settings
    field = None
    for part in key:
        section = _section_of(field)
        if field is not None and section is None:
            break  # an element of a list: its list is the field
        model = section or model
        field = model.model_fields.get(part)
    return (_section_of(field) or model), field


def _paths(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, field in model.model_fields.items():
        section = _section_of(field)
        if section is None:
            yield prefix + name
        else:
            yield from _paths(section, f"{prefix}{name}.")
