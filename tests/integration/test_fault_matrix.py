"""The fault matrix: its short form, and what its figures rest on. All of it: `python -m validation.fault_matrix`."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from companion.config.load import load_settings
from companion.mavlink.ids import MavCmd
from tests.integration.seen import CommandSeen, SetpointSeen
from validation.fault_matrix.__main__ import main
from validation.fault_matrix.faults import BY_NAME, CELLS, FAULTS
from validation.fault_matrix.injection import PERSONALITIES, Final
from validation.fault_matrix.outcome import Outcome, brake_begins_s, ended_right, stopped_at_the_wall, stops
from validation.fault_matrix.report import BEGIN, END, ReportError, markdown, write_into_docs
from validation.fault_matrix.run import fly

LEAST_FAULTS = 30
"""As many the safety case promises."""
TELLING = (
    ("SIGKILL application", "px4"),
    ("forged telemetry", "px4"),
    pytest.param("setpoint 10x", "ardupilot", marks=pytest.mark.flight),
    pytest.param("depth frozen", "px4", marks=pytest.mark.flight),
    pytest.param("SIGKILL gate", "ardupilot", marks=pytest.mark.flight),
)
"""A death, a stranger, a lie, a sense that fails unseen, and the last layer alone."""


@pytest.mark.slow
@pytest.mark.timeout(240)  # on a computer that compiles everything first
@pytest.mark.parametrize(("name", "personality"), TELLING)
def test_no_fault_leads_into_the_wall(name: str, personality: str, tmp_path: Path) -> None:
    """Protects the promise of the whole safety gate, in the flights that tell most: no contact, and the right end."""
    outcome = fly(name, personality, tmp_path)

    assert outcome.problem is None, f"{outcome}\n{_said(tmp_path)}"
    assert outcome.contacts == 0
    assert outcome.least_m > 0.5, "from the middle of a body with a radius of 0.35 m"
    assert outcome.speed_mps > 0.3, "it flew when the fault came"


def _said(parent: Path) -> str:
    """By gate and application, in the newest flight."""
    newest = max(parent.glob("*/gate.log"), key=lambda log: log.stat().st_mtime)
    return newest.read_text(encoding="utf-8", errors="replace")


def test_the_matrix_is_whole(capsys: pytest.CaptureFixture[str]) -> None:
    """Protects the extent of the matrix: a fault that drops out of the list would be missed by nobody."""
    assert len(BY_NAME) == len(FAULTS), "no two faults have one name"
    assert len(FAULTS) >= LEAST_FAULTS
    assert all(fault.personalities == PERSONALITIES for fault in FAULTS)
    assert all(Final.FLYING not in fault.expects and fault.expects for fault in FAULTS)
    assert len(CELLS) == 2 * len(FAULTS)

    assert main(["--list"]) == 0

    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(FAULTS)
    assert all(any(fault.name in line for line in lines) for fault in FAULTS)


def _setpoint(t_s: float, vx: float) -> SetpointSeen:
    return SetpointSeen(t_s, vx, 0.0, 0.1, 0.0, 8, 0x5C7, (1, 1), (1, 191), True)


def test_a_zero_that_is_taken_back_is_no_stop() -> None:
    """Protects the time to brake, the first figure of the table: an alternation of zeros and speed stops nothing."""
    wavering = [_setpoint(0.05 * i, 0.5 * (i % 2)) for i in range(20)]
    standing = [_setpoint(1.0 + 0.05 * i, 0.0) for i in range(10)]

    assert brake_begins_s(wavering[:-2], []) is None
    assert brake_begins_s([*wavering, *standing], []) == 1.0
    assert brake_begins_s([*wavering, *standing], [0.4]) == 0.4, "an order to hold or land stops it as well"
    assert brake_begins_s([], []) is None


@pytest.mark.parametrize(
    ("personality", "hold", "land", "offboard"),
    [
        ("px4", (1.0, 4.0, 3.0), (1.0, 4.0, 6.0), (1.0, 6.0, 0.0)),
        ("ardupilot", (1.0, 17.0, 0.0), (1.0, 9.0, 0.0), (1.0, 4.0, 0.0)),
    ],
)
def test_only_hold_and_land_are_orders_that_stop(
    personality: str, hold: tuple[float, ...], land: tuple[float, ...], offboard: tuple[float, ...]
) -> None:
    """Protects the time to brake: an order to fly on must not count as a stop."""

    def order(t_s: float, command: int, params: tuple[float, ...]) -> CommandSeen:
        return CommandSeen(t_s, command, (*params, 0.0, 0.0, 0.0, 0.0), (1, 1), (1, 192), True)

    orders = [
        order(1.0, MavCmd.DO_SET_MODE, offboard),
        order(2.0, MavCmd.DO_SET_MODE, hold),
        order(3.0, MavCmd.DO_SET_MODE, land),
    ]
    assert stops(personality, [*orders, order(4.0, MavCmd.NAV_LAND, (0.0, 0.0, 0.0)), order(5.0, 400, hold)]) == [
        2.0,
        3.0,
        4.0,
    ]


@pytest.mark.parametrize(
    ("final", "gate", "least_m", "at_wall"),
    [
        (Final.BRAKED, ("gate: distance 0.79 m ahead", "gate: brake: distance"), 0.78, True),
        (Final.BRAKED, ("gate: brake: distance", "gate: pass: all is well", "gate: brake: distance"), 0.78, True),
        (Final.BRAKED, ("gate: brake: distance",), 1.4, False),
        (Final.BRAKED, ("gate: brake: distance",), math.nan, False),
        (Final.BRAKED, ("gate: brake: distance", "gate: brake: pose"), 0.78, False),
        (Final.BRAKED, (), 0.78, False),
        (Final.LANDED, ("gate: brake: distance",), 0.78, False),
    ],
)
def test_a_gate_that_stops_it_for_the_wall_obeyed_nobody_else(
    final: Final, gate: tuple[str, ...], least_m: float, at_wall: bool
) -> None:
    """Protects flights that must go on: the wall ends them all, and only the wall may, at the place where it is."""
    assert stopped_at_the_wall(final, gate, least_m, load_settings(None, "flight")) is at_wall


@pytest.mark.parametrize(
    ("name", "final", "at_wall", "right"),
    [
        ("forged telemetry", Final.FLEW_ON, False, True),
        ("forged telemetry", Final.BRAKED, True, True),
        ("forged telemetry", Final.BRAKED, False, False),
        ("application ignores the wall", Final.BRAKED, True, True),
        ("application ignores the wall", Final.FLEW_ON, False, False),
        ("autopilot hears nothing", Final.BRAKED, True, False),
    ],
)
def test_the_wall_excuses_only_flights_that_go_on(name: str, final: Final, at_wall: bool, right: bool) -> None:
    """Protects faults that the gate must stop: where it stops them at the wall it has done just that."""
    assert ended_right(BY_NAME[name], final, at_wall=at_wall) is right


def _outcome(name: str, brake_s: float | None, least_m: float, problem: str | None = None) -> Outcome:
    return Outcome(
        name, BY_NAME[name].group, "px4", 0.42, 1.44, brake_s, 0.2, least_m, 0, Final.HELD, ("brake",), problem
    )


def test_the_table_begins_with_the_worst(tmp_path: Path) -> None:
    """Protects the reader of the safety case: the worst flight stands first, and a failed one cannot be overlooked."""
    outcomes = [
        _outcome("SIGKILL application", 0.03, 1.2),
        _outcome("SIGSTOP application", 0.16, 1.1),
        _outcome("setpoint NaN", None, 0.4, "nothing on the wire stopped it"),
    ]
    text = markdown(outcomes)

    head = text.split("###")[0]
    assert "3 faults, 3 flights, 0 contacts; 2 ended as they must" in head
    assert "0.40 (setpoint NaN, px4)" in head
    assert "0.16 (SIGSTOP application, px4)" in head
    assert "flights above the aim of 0.15 s: 1" in head
    assert "**Failed:** setpoint NaN (px4): nothing on the wire stopped it" in head

    file = tmp_path / "safety.md"
    with pytest.raises(ReportError, match="no place for the table"):
        write_into_docs(outcomes, file)
    file.write_text(f"before\n{BEGIN}\nold\n{END}\nbehind\n", encoding="utf-8")
    write_into_docs(outcomes, file)
    assert file.read_text(encoding="utf-8") == f"before\n{BEGIN}\n{text}\n{END}\nbehind\n"
