"""Settings of the map that would make a map which means nothing are refused, with the number and the bound."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from companion.config.load import load_settings
from companion.config.mapping import MapSettings
from companion.config.show import dump_yaml
from companion.mapping.voxels.sensor_model import steps_of


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"voxel_m": 0.01}, "greater than or equal to 0.02"),
        ({"voxel_m": math.nan}, "finite"),
        ({"max_range_m": 31.0}, "less than or equal to 30"),
        ({"hit_probability": 0.5}, "mapping.hit_probability = 0.5 must be above 0.5"),
        ({"miss_probability": 0.5}, "mapping.miss_probability = 0.5 must be below 0.5"),
        ({"clamp_min_probability": 0.6}, "mapping.clamp_min_probability = 0.6 must be below 0.5"),
        ({"clamp_max_probability": 0.7}, "= 0.7 must be above mapping.occupied_probability = 0.7"),
        ({"occupied_probability": 0.49}, "greater than or equal to 0.5"),
        ({"voxel_size": 0.1}, "Extra inputs are not permitted"),
        ({"model": "octo"}, "'robust' or 'octomap'"),
        ({"model": "octomap", "clamp_max_probability": 0.5}, "= 0.5 must be above mapping.occupied_probability = 0.5"),
        ({"saturated_m": 5.9}, "mapping.saturated_m = 5.9 m must be at least mapping.max_range_m = 6 m"),
        ({"memory_mb": 63}, "greater than or equal to 64"),
        ({"journal_period_s": 0.05}, "greater than or equal to 0.1"),
        ({"journal_period_s": 11.0}, "less than or equal to 10"),
    ],
)
def test_refused(wrong: dict[str, Any], message: str) -> None:
    """Protects from a map that no look could change: each message names the value and the bound."""
    with pytest.raises(ValidationError) as refusal:
        MapSettings(**wrong)
    assert message in str(refusal.value)


def test_settings_do_not_change() -> None:
    """Protects a map from settings that change while it is built."""
    with pytest.raises(ValidationError, match="frozen"):
        MapSettings().voxel_m = 0.2  # type: ignore[misc]


def test_every_setting_is_described() -> None:
    """Protects the page of settings, which is made from the descriptions."""
    assert all(field.description for field in MapSettings.model_fields.values())


def test_the_octomap_model_is_octomap_s() -> None:
    """Protects comparisons with OctoMap: the numbers are those of its OcTree, whatever ours become."""
    model = MapSettings(model="octomap")
    assert (model.hit_probability, model.miss_probability) == (0.7, 0.4)
    assert (model.clamp_min_probability, model.clamp_max_probability) == (0.1192, 0.971)
    assert (model.occupied_probability, model.margin_m) == (0.5, 0.0)
    steps = steps_of(model)
    # OctoMap's log-odds: 0.85, -0.4, clamps of -2 and 3.5, and occupied from 0 on. Its hits count alike at every depth.
    assert set(steps.hits.tolist()) == {847}
    assert (steps.miss, steps.lowest, steps.highest, steps.threshold) == (-405, -2000, 3511, 0)


def test_a_key_that_is_given_is_not_the_model_s(tmp_path: Path) -> None:
    """Protects who compares with OctoMap at another threshold, and settings.yaml, which has to give the same map."""
    file = tmp_path / "settings.yaml"
    file.write_text("mapping: {model: octomap, occupied_probability: 0.6}", encoding="utf-8")
    settings = load_settings(file)
    assert (settings.mapping.occupied_probability, settings.mapping.clamp_max_probability) == (0.6, 0.971)
    file.write_text(dump_yaml(settings), encoding="utf-8")
    assert load_settings(file).mapping == settings.mapping
    assert MapSettings().occupied_probability == 0.7, "the robust model is the default"
