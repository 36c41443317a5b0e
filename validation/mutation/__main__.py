"""``scripts/mutants [--quick] [MODULE...]``: see docs/safety-mutants.md."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from validation.mutation.running import Mutation

MODULES = """
gate.gate
gate.fault_monitor
gate.failsafe_actions
gate.escalation
gate.setpoint_limits
gate.vehicle
gate.motion
gate.geofence
gate.protocol
gate.allowlist
gate.plan
gate.outgoing
mavlink.codec
mavlink.position_jump
mavlink.signing
mavlink.mode_monitor
mavlink.modes
mavlink.estimator
safety_case.stopping_budget
"""
FOLDER = Path(__file__).parents[2]
TESTS = """
gate/test_allowlist gate/test_escalation gate/test_failsafe_actions gate/test_fault_monitor gate/test_gate_faults
gate/test_gate_flight gate/test_gate_hearing gate/test_gate_setpoints gate/test_gate_stages gate/test_handover
gate/test_motion
gate/test_outgoing gate/test_protocol_and_plan gate/test_setpoint_limits gate/test_vehicle mavlink/test_codec
mavlink/test_mode_monitor mavlink/test_readings mavlink/test_signing safety_case/test_stopping_budget
"""


def main(arguments: list[str]) -> int:
    """Try all changes of the modules; gives the exit code: 0 when none survives that is not argued for."""
    modules = [word for word in arguments if word != "--quick"]
    mutation = Mutation(FOLDER, modules or MODULES.split(), quick="--quick" in arguments)
    tests = [str(FOLDER / f"tests/{name}.py") for name in TESTS.split()]
    options = ["-qq", "-n0", "--tb=no", "--timeout=30", "-p", "no:cacheprovider"]
    code = pytest.main([*options, f"--rootdir={FOLDER}", *tests], plugins=[mutation])
    return code or mutation.exit_code


if __name__ == "__main__":
    sys.dont_write_bytecode = True
    sys.exit(main(sys.argv[1:]))
