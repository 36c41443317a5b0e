"""How narrow and how low a place may be, by the settings; that it is flown so is in tests/sitl/sim/test_passages.py."""

from __future__ import annotations

from typing import Any

import pytest

from companion.config.load import load_settings, preset_names
from companion.config.settings import Settings
from companion.safety_case.passages import passages


def changed(**control: Any) -> Settings:
    return Settings.model_validate({"control": control})


def test_the_presets() -> None:
    assert str(passages(load_settings(None, "flight"))) == (
        "flies into places 1.92 m wide and 2.00 m high, or more; once inside it goes on down to 1.90 m and 1.00 m"
    )
    for preset in preset_names():
        found = passages(load_settings(None, preset))
        assert found.enters_width_m >= found.least_width_m
        assert found.enters_height_m >= found.least_height_m


@pytest.mark.parametrize(
    ("values", "wider_m", "least_wider_m"),
    [
        # What leads along a tangent has a corridor by d_s.
        ({"margin_m": 1.2}, 2.0 * (0.9 * 1.2 + 0.05) - 1.92, 0.0),
        ({"margin_m": 1.2, "critical_margin_m": 1.0}, 0.4, 0.4),
        ({"critical_margin_m": 0.7}, 1.9 - 1.92, -0.2),
        # The governor brakes before d_c, the paper's (12) at it.
        ({"speed_law": "paper"}, 1.9 - 1.92, -0.1),
        # The paper's law knows no middle between two walls.
        ({"law": "paper"}, 2.3 - 1.92, 0.0),
        # Just below d_s hardly anything is kept beyond d_c.
        ({"critical_margin_m": 0.99}, 2.0 * (0.993 + 0.11) - 1.92, 2.0 * (0.993 + 0.1) - 1.9),
    ],
)
def test_margins_decide_the_width(values: dict[str, Any], wider_m: float, least_wider_m: float) -> None:
    usual, other = passages(changed()), passages(changed(**values))
    assert other.enters_width_m - usual.enters_width_m == pytest.approx(wider_m)
    assert other.least_width_m - usual.least_width_m == pytest.approx(least_wider_m)
    assert (other.enters_height_m, other.least_height_m) == (usual.enters_height_m, usual.least_height_m)


def test_the_height_of_flight_and_the_body_decide_the_height() -> None:
    usual, lower = passages(changed()), passages(changed(height_m=1.0))
    assert usual.enters_height_m - lower.enters_height_m == pytest.approx(0.5)
    assert usual.least_height_m == lower.least_height_m
    flat = passages(Settings.model_validate({"vehicle": {"body_height_m": 0.1}}))
    assert usual.least_height_m - flat.least_height_m == pytest.approx(0.2)
    assert usual.enters_height_m - flat.enters_height_m == pytest.approx(0.1)
