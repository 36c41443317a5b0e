"""A signal ends a command wherever it strikes, and never as a crash."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.shared.compiled_work import COMPILED_WORK

SCRIPT = f"""
{COMPILED_WORK}
from companion.interruption import ENDS, signals_are_ctrl_c

signals_are_ctrl_c()
print("ended", interrupted(ENDS * 6))
"""


@pytest.mark.timeout(120)
def test_a_signal_in_compiled_code_ends_the_work_and_not_the_process() -> None:
    """Protects what was flown for: numba does not notice an exception while it gives back a named tuple."""
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False, timeout=110)
    assert (done.returncode, done.stdout) == (0, "ended 18\n"), done.stderr
