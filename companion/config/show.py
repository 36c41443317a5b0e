"""The configuration shown: all settings as commented YAML for people, as JSON Schema for editors."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from companion.config.load import DEFAULT_PRESET, preset_names
from companion.config.settings import Settings

LINE_WIDTH = 120


def dump_yaml(settings: Settings) -> str:
    """Every setting as YAML that `load_settings` reads back unchanged, each key with its description."""
    return "\n".join(_dump(settings, indent="")).lstrip("\n") + "\n"


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a settings file, for editors that check YAML while it is typed."""
    schema = Settings.model_json_schema()
    preset = {"description": "the settings below this file", "enum": list(preset_names()), "default": DEFAULT_PRESET}
    schema["properties"] = {"preset": preset, **schema["properties"]}
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _dump(model: BaseModel, indent: str) -> Iterator[str]:
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        text = f"{indent}{name}:"
        if isinstance(value, BaseModel):
            yield from ("",) if not indent else ()
            yield from _commented(text, field.description, indent)
            yield from _dump(value, indent + "  ")
        else:
            plain = model.model_dump(mode="json", include={name})[name]
            yield from _commented(f"{text} {_as_yaml(plain)}", field.description, indent)


def _as_yaml(value: object) -> str:
    """The value as JSON, which is YAML 1.2, with YAML's escapes for what cannot stand in a file or be seen in it."""
    return "".join(
        character if character.isprintable() else f"\\U{ord(character):08x}"
        for character in json.dumps(value, ensure_ascii=False)
    )


def _commented(text: str, comment: str | None, indent: str) -> Iterator[str]:
    """The line with its comment behind it, or above it where that would be too long."""
    one_line = f"{text}  # {comment}"
    if comment is None:
        yield text
    elif len(one_line) <= LINE_WIDTH:
        yield one_line
    else:
        mark = f"{indent}# "
        yield from textwrap.wrap(comment, LINE_WIDTH, initial_indent=mark, subsequent_indent=mark)
        yield text
