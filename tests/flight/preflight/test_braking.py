"""Law and gate must not count on more braking than was measured of the autopilots."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from companion.config.load import load
from companion.config.settings import Settings
from companion.flight.preflight.checks import braking
from companion.mavlink.firmware import MEASURED_BRAKE_MPS2, MEASURED_HOLD_CREEP_M, AutopilotKind
from companion.safety_case.gate_plan import stopping_lines
from validation.fault_matrix.faults import FAULTS
from validation.fault_matrix.scene import write_config

ABOVE_MPS2 = MEASURED_BRAKE_MPS2 + 0.001
LEAST_LEFT_M = 0.1
"""Between body and wall after any fault: a voxel, and what positions are wrong by."""


def with_brake(brake_mps2: float, speed_law: str = "governor") -> Settings:
    """Settings whose law and gate count on so much."""
    return Settings.model_validate({"control": {"speed_law": speed_law, "governor": {"brake_mps2": brake_mps2}}})


@pytest.mark.parametrize("speed_law", ["governor", "paper"])
@pytest.mark.parametrize(
    ("brake_mps2", "ok"),
    [(0.2, True), (MEASURED_BRAKE_MPS2, True), (ABOVE_MPS2, False), (Settings().control.governor.brake_mps2, True)],
)
def test_an_autopilot_may_be_counted_on_for_what_was_measured_and_no_more(
    brake_mps2: float, ok: bool, speed_law: str
) -> None:
    """Protects the stopping budget; the gate counts on the number whatever law sets the speed."""
    result = braking(AutopilotKind.PX4, with_brake(brake_mps2, speed_law))
    assert (result.name, result.ok, result.skipped) == ("braking", ok, False)
    assert f"{brake_mps2:g} m/s²" in result.found
    assert result.wanted == "at most 0.43 m/s², at least 0.25 m"
    assert ("control.governor.brake_mps2: 0.43" in result.fix) != ok


@pytest.mark.parametrize("kind", AutopilotKind)
@pytest.mark.parametrize(("less_m", "ok"), [(0.0, True), (0.01, False)])
def test_in_its_own_hold_an_autopilot_wanders_no_less_than_was_measured(
    kind: AutopilotKind, less_m: float, ok: bool
) -> None:
    """Protects narrow places: settings made for ArduPilot, which keeps its place better, are not flown with PX4."""
    needed_m = MEASURED_HOLD_CREEP_M[kind]
    result = braking(kind, Settings.model_validate({"safety": {"hold_creep_m": needed_m - less_m}}))
    assert result.ok is ok
    assert (f"safety.hold_creep_m: {needed_m:g}" in result.fix) is not ok
    assert "brake_mps2" not in result.fix


def test_the_flights_of_the_fault_matrix_pass(tmp_path: Path) -> None:
    """Protects the matrix, which is to show what is flown: no fault may bring settings that are not."""
    for fault in FAULTS:
        settings = write_config(tmp_path / "vehicle.yaml", 14540, "tcp://127.0.0.1:14600", fault.settings)
        assert all(braking(kind, settings).ok for kind in AutopilotKind), fault.name


@pytest.mark.parametrize("preset", ["flight", "swift", "table_ii"])
def test_no_fault_ends_near_a_wall(preset: str) -> None:
    """Protects whoever flies a preset: four centimetres were once called safe, and a creep of ten was not counted."""
    left_m = {line.fault: line.remaining_m for line in stopping_lines(load(None, preset).settings) if line.stops}
    assert min(left_m.values()) >= LEAST_LEFT_M, left_m


@pytest.mark.parametrize("name", ["flying.md", "safety.md"])
def test_the_documents_tell_the_number_that_is_asked_for(name: str) -> None:
    """Protects whoever copies it from there: with another number pre-flight would refuse the copy."""
    text = (Path(__file__).parents[3] / "docs" / name).read_text(encoding="utf-8")
    assert set(re.findall(r"brake_mps2: ([\d.]+\d)", text)) <= {f"{MEASURED_BRAKE_MPS2:g}"}
