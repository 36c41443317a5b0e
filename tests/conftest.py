"""For all tests."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, settings

# How long an example takes says something of the machine: it may be flying a vehicle beside this test.
settings.register_profile("busy machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy machine")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whole flights first: one worker flies, and mostly waits, while another computes.

    Each worker begins with its share in this order, and takes from the end of another's when it has none left. So no
    two flights need the computer at the same time, and none is left to be waited for at the end.
    """
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)
