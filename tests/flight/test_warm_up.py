"""Nothing may compile in flight: it would be seconds without a setpoint."""

from __future__ import annotations

import subprocess
import sys

import pytest

# In a process of its own: what other tests have compiled before would hide what the warm-up leaves out.
SCRIPT = """
import importlib, pkgutil
from numba.core.dispatcher import Dispatcher
import companion.control, companion.perception
from companion.config.load import load_settings
from companion.flight.warm_up import warm_up

warm_up(load_settings(None, "flight"))
for room in (companion.control, companion.perception):
    for found in pkgutil.iter_modules(room.__path__, room.__name__ + "."):
        if not found.ispkg:
            module = importlib.import_module(found.name)
            for name, value in vars(module).items():
                if isinstance(value, Dispatcher) and value.__module__ == found.name and not value.signatures:
                    print(found.name, name)
"""


@pytest.mark.timeout(300)
def test_the_warm_up_leaves_nothing_of_the_tick_to_compile() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True, timeout=280)
    assert set(done.stdout.splitlines()) <= {
        # Compiled as parts of others, never called from Python.
        "companion.control.known_ground _has_room",
        "companion.perception.ground _line_was_seen",
        "companion.perception.scan_memory _is_seen_through",
        "companion.perception.scan_memory _looked_range",
        # Larger images only: these settings' camera has none to reduce.
        "companion.perception.depth _pool_nearest",
    }
