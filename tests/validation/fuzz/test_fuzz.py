"""Garbage, old and foreign messages, bytes and files: nothing crashes, nothing moves. Longer: `__main__`."""

from __future__ import annotations

import pytest

from validation.fuzz.targets import TARGETS, run


@pytest.mark.parametrize("name", TARGETS)
def test_it_survives(name: str) -> None:
    """The same cases every time; one that fails names its seed: `python -m validation.fuzz --only NAME --seed SEED`."""
    for seed in range(TARGETS[name].count):
        try:
            run(name, seed)
        except Exception as error:
            error.add_note(f"python -m validation.fuzz --only {name} --seed {seed} --seconds 0")
            raise
