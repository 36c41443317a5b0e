"""``scripts/mutants [--quick] [MODULE...]``: see docs/safety-mutants.md."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.safety.mutation.running import Mutation

MODULES = """
gate watch answer ladder setpoint vehicle motion fence beat permits plan voice mavlink signing budget
"""
FOLDER = Path(__file__).parents[3]
TESTS = """
answer beat_and_plan budget fence gate_faults gate_flight gate_hearing gate_notices gate_orders gate_permits
gate_requests gate_setpoint_places gate_setpoints gate_stages ladder mavlink motion permits setpoint
signing vehicle voice watch
"""


def main(arguments: list[str]) -> int:
    """Try all changes of the modules; gives the exit code: 0 when none survives that is not argued for."""
    modules = [word for word in arguments if word != "--quick"]
    mutation = Mutation(FOLDER, modules or MODULES.split(), quick="--quick" in arguments)
    tests = [str(FOLDER / f"tests/safety/unit/test_{name}.py") for name in TESTS.split()]
    options = ["-qq", "-n0", "--tb=no", "--timeout=30", "-p", "no:cacheprovider"]
    code = pytest.main([*options, f"--rootdir={FOLDER}", *tests], plugins=[mutation])
    return code or mutation.exit_code


if __name__ == "__main__":
    sys.dont_write_bytecode = True
    sys.exit(main(sys.argv[1:]))
