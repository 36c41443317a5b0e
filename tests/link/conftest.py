"""For the tests of the link."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.link.exchange import Mine


@pytest.fixture
def mine(tmp_path: Path) -> Mine:
    """A map of some size, at the vehicle."""
    made = Mine(tmp_path / "vehicle")
    for _ in range(10):
        made.grow()
    return made
