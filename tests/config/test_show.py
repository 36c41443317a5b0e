"""What the settings look like from outside: the commented YAML and the JSON Schema."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from pydantic import BaseModel

from companion.config.load import load_settings, preset_names
from companion.config.settings import Settings
from companion.config.show import LINE_WIDTH, dump_yaml, json_schema
from companion.config.source import Source


def descriptions(model: type[BaseModel]) -> Iterator[tuple[str, str | None]]:
    for name, field in model.model_fields.items():
        yield f"{model.__name__}.{name}", field.description
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from descriptions(field.annotation)


@pytest.mark.parametrize("preset", preset_names())
def test_what_is_shown_loads_as_the_same_settings(tmp_path: Path, preset: str) -> None:
    file = tmp_path / "shown.yaml"
    shown = load_settings(preset=preset)
    file.write_text(dump_yaml(shown), encoding="utf-8")
    for below in preset_names():
        assert load_settings(file, below) == shown


def test_every_key_is_shown_with_its_description() -> None:
    shown = dump_yaml(Settings())
    unwrapped = " ".join(line.strip().removeprefix("# ") for line in shown.splitlines())
    for name, description in descriptions(Settings):
        assert description, f"{name} needs a description"
        assert description in unwrapped
    assert max(map(len, shown.splitlines())) <= LINE_WIDTH


def test_schema_accepts_what_is_shown_and_refuses_an_unknown_key() -> None:
    schema = json_schema()
    Draft202012Validator.check_schema(schema)
    validator = Draft202012Validator(schema)
    shown = yaml.safe_load(dump_yaml(Settings()))
    assert validator.is_valid({"preset": "table_i", **shown})
    assert validator.is_valid({})
    assert not validator.is_valid({"preset": "none"})
    assert not validator.is_valid({"controll": {}})
    assert not validator.is_valid({"control": {"tangent_probability": 0}})


@given(
    drivers=st.lists(st.text(st.characters(exclude_categories=["Cs"]), max_size=20), max_size=4),
    pause_s=st.floats(0.0, 120.0),
    largest=st.integers(1, 5),
    forward=st.booleans(),
)
def test_any_settings_shown_load_as_the_same(drivers: list[str], pause_s: float, largest: int, forward: bool) -> None:
    """Protects recordings and run folders: text of any kind, and numbers to their last digit."""
    settings = Settings.model_validate(
        {
            "sensors": {"drivers": drivers},
            "control": {"pause_s": pause_s, "climb_feed_forward": forward},
            "fleet": {"largest_group": largest, "tunnel_height_m": 10.0},
        }
    )
    source = Source("shown.yaml", dump_yaml(settings))
    source.raise_problems()
    assert Settings.model_validate_json(json.dumps(source.data), strict=True) == settings
