"""Settings of the map that would make a map which means nothing are refused, with the number and the bound."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import ValidationError

from companion.config.mapping import MapSettings


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
