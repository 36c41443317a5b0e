"""Settings with some of them changed: by the rules of a settings file, and told where they were given."""

from __future__ import annotations

import pytest

from companion.config.load import load_settings
from companion.config.vary import value_of, vary
from companion.errors import InputError


def place(name: str) -> str:
    return f"--set {name}"


def test_only_what_is_named_changes() -> None:
    before = load_settings(None, "flight")
    after = vary(before, {"control.margin_m": 1.2, "sim.noise.pose_drift_share": 0.01}, place)
    assert (after.control.margin_m, after.sim.noise.pose_drift_share) == (1.2, 0.01)
    assert vary(after, {name: value_of(before, name) for name in ("control.margin_m", "sim.noise.pose_drift_share")},
                place) == before  # fmt: skip


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("control.margin_m", 0.1, "out of range: value 0.1, bound >= 0.3"),
        ("control.margin_m", "wide", 'not usable: value "wide", expected a number'),
        ("control.margn_m", 1.0, "did you mean control.margin_m?"),
        ("margin_m", 1.0, "did you mean control.margin_m?"),
        ("control", 1.0, "expected keys and values"),
        ("control.margin_m.x", 1.0, "expected a number"),
        ("vehicle.body_radius_m", 0.9, "must be smaller than control.critical_margin_m"),
    ],
)
def test_what_cannot_be_is_refused_where_it_was_given(name: str, value: object, said: str) -> None:
    with pytest.raises(InputError) as refused:
        vary(load_settings(None, "flight"), {name: value}, place)
    assert str(refused.value).startswith(f"--set {name}: ")
    assert said in str(refused.value)


def test_the_value_of_what_is_no_setting_is_none() -> None:
    assert value_of(load_settings(None, "flight"), "control.nothing.here") is None
