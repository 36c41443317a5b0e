"""For all tests."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Generator

import pytest
from hypothesis import HealthCheck, settings

# How long an example takes says something of the machine: it may be flying a vehicle beside this test.
settings.register_profile("busy machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("busy machine")

# Whoever starts the tests in the background (`nohup make test &`) lets these be ignored, and our children inherit it.
for _number, _usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, _usual)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes long first: each worker takes from the end of another's share when it has none left."""
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


def pytest_collection_finish() -> None:
    """What was imported stays: nobody has to search it for garbage again."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Generator[None]:
    """What the tests of a file have left open fails the last of them, and not any test in which it is collected."""
    yield
    if nextitem is not None and nextitem.path == item.path:
        return
    left: list[str] = []
    before, sys.unraisablehook = sys.unraisablehook, lambda one: left.append(f"{one.exc_value!r} of {one.object!r}")
    try:
        gc.collect()
    finally:
        sys.unraisablehook = before
    if left:
        pytest.fail(f"the tests of {item.path.name} left behind: {'; '.join(left)}")
