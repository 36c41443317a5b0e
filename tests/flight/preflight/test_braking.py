"""Law and gate must not count on more braking than was measured for the autopilot that is connected."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from companion.config.settings import Settings
from companion.flight.preflight.checks import braking
from companion.mavlink.firmware import ARDUCOPTER_BRAKE_MPS2, AutopilotKind
from companion.safety_case.gate_plan import stopping_lines
from sitl.launch.processes import Crew, FlightPlan, write_settings
from validation.fault_matrix.faults import FAULTS
from validation.fault_matrix.scene import write_config

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
ABOVE_MPS2 = ARDUCOPTER_BRAKE_MPS2 + 0.001


def with_brake(brake_mps2: float, speed_law: str = "governor") -> Settings:
    """Settings whose law and gate count on so much."""
    return Settings.model_validate({"control": {"speed_law": speed_law, "governor": {"brake_mps2": brake_mps2}}})


@pytest.mark.parametrize("speed_law", ["governor", "paper"])
@pytest.mark.parametrize(
    ("brake_mps2", "ok"),
    [(0.2, True), (ARDUCOPTER_BRAKE_MPS2, True), (ABOVE_MPS2, False), (Settings().control.governor.brake_mps2, False)],
)
def test_ardupilot_may_be_counted_on_for_what_was_measured_and_no_more(
    brake_mps2: float, ok: bool, speed_law: str
) -> None:
    """Protects the stopping budget with ArduPilot; the gate counts on the number whatever law sets the speed."""
    (result,) = braking(ARDUPILOT, with_brake(brake_mps2, speed_law))
    assert (result.name, result.ok, result.skipped) == ("braking", ok, False)
    assert f"{brake_mps2:g} m/s²" in result.found
    assert result.wanted == "at most 0.43 m/s² with ArduPilot"
    assert ("control.governor.brake_mps2: 0.43" in result.fix) != ok


@pytest.mark.parametrize("brake_mps2", [ARDUCOPTER_BRAKE_MPS2, Settings().control.governor.brake_mps2])
def test_px4_is_not_asked(brake_mps2: float) -> None:
    """Protects flights with PX4, for which the default was chosen, from a demand that is ArduPilot's."""
    assert list(braking(PX4, with_brake(brake_mps2))) == []


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_our_own_flights_with_the_application_pass(kind: AutopilotKind, tmp_path: Path) -> None:
    """Protects `companion sitl fly` and all flights of the tests that use its crew, also with settings of their own."""
    besides = {"control": {"speed_mps": 0.4, "governor": {"reaction_s": 0.5}}}
    settings = Crew(FlightPlan(folder=tmp_path, personality=kind.value, settings=besides)).write_settings()
    assert (settings.control.speed_mps, settings.control.governor.reaction_s) == (0.4, 0.5)
    assert all(result.ok for result in braking(kind, settings))
    assert (settings.control.governor.brake_mps2 == Settings().control.governor.brake_mps2) == (kind is PX4)


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_the_flights_of_the_fault_matrix_pass(kind: AutopilotKind, tmp_path: Path) -> None:
    """Protects the matrix, which is to show what is flown: no fault may bring settings that are not."""
    for fault in FAULTS:
        settings = write_config(tmp_path / "vehicle.yaml", kind.value, 14540, "tcp://127.0.0.1:14600", fault.settings)
        assert all(result.ok for result in braking(kind, settings)), fault.name


def left_m(preset: str, personality: str, folder: Path) -> dict[str, float]:
    """What each fault leaves between body and wall, with the settings that the personality needs."""
    lines = stopping_lines(write_settings(folder / "vehicle.yaml", preset, personality))
    return {line.fault: line.remaining_m for line in lines if line.stops}


def test_what_ardupilot_needs_leaves_no_less_room_than_the_default_does_with_px4(tmp_path: Path) -> None:
    """Protects whoever sets what pre-flight asks for: the law slows down so much earlier that no stop ends nearer.

    But for a millimetre or two, at the governor's creep, which it allows down to d_c in any case.
    """
    px4 = left_m("flight", "px4", tmp_path)
    ardupilot = left_m("flight", "ardupilot", tmp_path)
    assert min(ardupilot.values()) > min(px4.values()) > 0.0
    assert all(ardupilot[fault] >= left - 0.002 for fault, left in px4.items())


def test_the_papers_flight_passes_with_ardupilot_too(tmp_path: Path) -> None:
    """Protects the preset without a governor: there each stop is only longer, and must still end before the wall."""
    assert min(left_m("table_ii", "ardupilot", tmp_path).values()) > 0.0


@pytest.mark.parametrize("name", ["flying.md", "safety.md", "sitl.md"])
def test_the_documents_tell_the_number_that_is_asked_for(name: str) -> None:
    """Protects whoever copies it from there: with another number pre-flight would refuse the copy."""
    text = (Path(__file__).parents[3] / "docs" / name).read_text(encoding="utf-8")
    assert set(re.findall(r"brake_mps2: ([\d.]+\d)", text)) == {f"{ARDUCOPTER_BRAKE_MPS2:g}"}
