"""Settings with some of them changed, as whoever compares vehicles needs them: the same rules, the same messages."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import ValidationError

from companion.config.load import bad_value, merge, unknown_key
from companion.config.settings import Settings
from companion.config.source import Key
from companion.errors import InputError


def vary(settings: Settings, values: Mapping[str, object], place: Callable[[str], str]) -> Settings:
    """The settings with some of them changed.

    Args:
        settings: what is changed.
        values: full names of settings, as in ``control.margin_m``, and what they are to be.
        place: where the value of a name was given, for the message that refuses it.

    Raises:
        InputError: they cannot be used. One line for each problem: ``PLACE: what is wrong: value, bound; what to do``.
    """
    merged = settings.model_dump(mode="json")
    for name, value in values.items():
        merged = merge(merged, _nested(name, value))
    try:
        return Settings.model_validate_json(json.dumps(merged), strict=True)
    except ValidationError as error:
        said = dict.fromkeys(_told(found, values, place) for found in error.errors(include_url=False))
        raise InputError("\n".join(said)) from None


def value_of(settings: Settings, name: str) -> object:
    """The value of a setting by its full name; None where there is no such setting."""
    value: Any = settings.model_dump(mode="json")
    for part in name.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return value


def _nested(name: str, value: object) -> dict[str, Any]:
    nested: Any = value
    for part in reversed(name.split(".")):
        nested = {part: nested}
    return dict(nested)


def _told(error: Any, values: Mapping[str, object], place: Callable[[str], str]) -> str:
    if error["type"] == "settings":
        names = [name for name in error["ctx"]["keys"] if name in values]
        where = ", ".join(dict.fromkeys(map(place, names))) or "default"
        return f"{where}: {error['msg']}"
    key: Key = tuple(str(part) for part in error["loc"])
    found = ".".join(key)
    # What is wrong may be an element of the list that was given, or the number in which a section was given.
    name = next((name for name in values if f"{found}.".startswith(f"{name}.") or name.startswith(f"{found}.")), found)
    said = unknown_key(key) if error["type"] == "extra_forbidden" else bad_value(key, error)
    return f"{place(name)}: {said}"
