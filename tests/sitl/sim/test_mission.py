"""Whole missions, from the first observation to the end, and the record of each: every tick, nothing invented."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from companion.config.load import load_settings
from companion.model import Beam, Input, Measurement, Mode, Pose, Setpoint
from sitl.mines import load_world
from sitl.sim.flight_log import COLUMNS, MODES, FlightLog
from sitl.sim.simulation import COMPLETE_SHARE, Simulation


def flown(beams: Sequence[Beam] | None, limit_s: float) -> Simulation:
    """A mission in `room`, with noise, preset flight; with all beams when none are named."""
    settings = load_settings(None, "flight")
    if beams is not None:
        only = settings.sensors.beams.model_copy(update={"directions": tuple(beams)})
        sensors = settings.sensors.model_copy(update={"beams": only})
        settings = settings.model_copy(update={"sensors": sensors})
    simulation = Simulation(load_world("room", 2), settings, 2)
    simulation.run(limit_s)
    return simulation


@pytest.mark.slow
def test_a_mission_ends_with_a_complete_map_and_touches_nothing() -> None:
    """Protects the main job: sensors, law, dynamics and map together. 1500 s are four times the usual."""
    simulation = flown(None, 1500.0)
    summary = simulation.score()
    assert simulation.ended_because == "complete"
    assert simulation.completeness >= COMPLETE_SHARE
    assert summary["contacts"] == 0
    assert float(str(summary["least_d_m"])) >= simulation.settings.vehicle.body_radius_m


@pytest.mark.slow
def test_the_camera_and_the_downward_beam_are_enough() -> None:
    """Protects vehicles without side beams: the scan memory alone knows the wall beside and the corner behind."""
    simulation = flown([Beam.DOWN], 240.0)
    summary = simulation.score()
    assert simulation.ended_because in ("complete", "time limit")
    assert summary["contacts"] == 0
    # It flew: a vehicle that holds for want of a sensor touches nothing either.
    assert float(str(summary["path_length_m"])) > 20.0


# The record of a simulated flight: every tick, nothing invented.


TRUE = Pose(1.25, 1.0, 2.0, 3.0, 0.1)
ESTIMATED = Pose(1.25, 1.1, 2.2, 3.3, 0.2)
SETPOINT = Setpoint(1.25, 0.5, -0.1, 0.3)
KNOWN = Measurement(
    t_s=1.25,
    scan_age_s=0.1,
    scan=None,
    h_m=1.5,
    roof_m=2.0,
    ground_slope=0.0,
    d_m=0.9,
    d_bearing_rad=1.0,
    d_front_m=0.95,
    d_dot_mps=0.0,
    ahead_m=3.0,
    ranges_age_s=0.05,
)
UNKNOWN = Measurement(
    t_s=1.25,
    scan_age_s=float("inf"),
    scan=None,
    h_m=None,
    roof_m=None,
    ground_slope=None,
    d_m=None,
    d_bearing_rad=None,
    d_front_m=None,
    d_dot_mps=None,
    ahead_m=float("nan"),
    ranges_age_s=float("inf"),
    missing=(Input.DEPTH, Input.HEIGHT),
)
EXPECTED = {
    "t_s": 1.25,
    "x_m": 1.0,
    "y_m": 2.0,
    "z_m": 3.0,
    "yaw_rad": 0.1,
    "estimated_x_m": 1.1,
    "estimated_y_m": 2.2,
    "estimated_z_m": 3.3,
    "estimated_yaw_rad": 0.2,
    "d_m": 0.9,
    "d_front_m": 0.95,
    "h_m": 1.5,
    "speed_mps": 0.45,
    "setpoint_speed_mps": 0.5,
    "setpoint_climb_mps": -0.1,
    "setpoint_yaw_rate_radps": 0.3,
}
MEASURED = ("d_m", "d_front_m", "h_m")


def one_tick(measurement: Measurement = KNOWN, mode: Mode = Mode.BOUNDARY) -> FlightLog:
    log = FlightLog(3)
    log.append(TRUE, ESTIMATED, measurement, mode, SETPOINT, speed_mps=0.45)
    return log


def rows_of(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_every_value_stands_in_its_own_column() -> None:
    """Protects against columns that are swapped: all values differ, and all but the true distance are there."""
    log = one_tick()
    assert (len(log), log.vehicle_id) == (1, 3)
    assert {name: float(log.column(name)[0]) for name in COLUMNS if name != "true_d_m"} == EXPECTED
    np.testing.assert_array_equal(log.positions_m, [[1.0, 2.0, 3.0]])
    assert MODES[log.modes[0]] is Mode.BOUNDARY


def test_what_is_not_known_is_not_a_number() -> None:
    """Protects unknown from becoming zero; the true distance is not known before it is filled in."""
    log = one_tick(UNKNOWN)
    for name in COLUMNS:
        assert np.isnan(log.column(name)[0]) == (name in (*MEASURED, "true_d_m")), name


@pytest.mark.parametrize("mode", list(Mode))
def test_every_mode_can_be_recorded(mode: Mode) -> None:
    """Protects the mode's index, which is all that is kept of it."""
    assert MODES[one_tick(mode=mode).modes[0]] is mode


def test_it_grows_and_keeps_everything() -> None:
    """Protects long flights: the arrays are enlarged several times and no tick is lost, moved or made up."""
    log = FlightLog()
    ticks = 20_000
    for i in range(ticks):
        log.append(
            Pose(0.05 * i, float(i), 0.0, 0.0, 0.0), ESTIMATED, KNOWN, list(Mode)[i % 4], SETPOINT, speed_mps=0.0
        )
    assert len(log) == ticks
    np.testing.assert_array_equal(log.column("x_m"), np.arange(ticks))
    np.testing.assert_array_equal(log.modes, np.arange(ticks) % 4)
    assert log.positions_m.shape == (ticks, 3)
    assert np.isnan(log.column("true_d_m")).all()


def test_the_true_distance_can_be_filled_in() -> None:
    """Protects the scoring, which writes through the column."""
    log = one_tick()
    log.column("true_d_m")[:] = 0.8
    assert log.column("true_d_m")[0] == 0.8


def test_the_file_has_a_row_for_each_tick(tmp_path: Path) -> None:
    """Protects the columns of trajectory.csv, by name: time and mode first, everything with its unit."""
    log = one_tick()
    log.append(TRUE, ESTIMATED, KNOWN, Mode.HOLD, SETPOINT, speed_mps=0.45)
    log.column("true_d_m")[0] = 0.875
    log.write_csv(tmp_path / "trajectory.csv")
    first, second = rows_of(tmp_path / "trajectory.csv")
    assert list(first) == ["t_s", "mode", *COLUMNS[1:]]
    assert first.pop("mode") == "R3"
    assert second["mode"] == "hold"
    # Four digits behind the point: a tenth of a millimetre.
    assert {name: float(text) for name, text in first.items()} == pytest.approx(
        {**EXPECTED, "true_d_m": 0.875}, abs=5e-5
    )
    assert second["true_d_m"] == ""


def test_an_unknown_value_is_an_empty_cell(tmp_path: Path) -> None:
    """Protects readers of the file from a 0 or a 'nan' that would be drawn as a number."""
    one_tick(UNKNOWN).write_csv(tmp_path / "trajectory.csv")
    (row,) = rows_of(tmp_path / "trajectory.csv")
    assert [name for name, text in row.items() if text == ""] == [
        name for name in COLUMNS if name in (*MEASURED, "true_d_m")
    ]
    assert not {"nan", "None", "inf"} & set(row.values())


def test_a_flight_without_a_tick_is_only_the_heading(tmp_path: Path) -> None:
    """Protects a mission that ends before it begins."""
    FlightLog().write_csv(tmp_path / "trajectory.csv")
    lines = (tmp_path / "trajectory.csv").read_text(encoding="utf-8").splitlines()
    assert lines == [",".join(["t_s", "mode", *COLUMNS[1:]])]
