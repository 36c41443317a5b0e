"""What of a mission is on the disk while it flies."""

from __future__ import annotations

import csv
import errno
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from companion.config.load import load_settings
from companion.mapping.journal import JOURNAL_NAME, Journal, JournalError
from companion.mapping.voxels.chunks import keys_of
from companion.mapping.voxels.piece import MapSource
from sitl.mines import load_world
from sitl.report.kept import PERIOD_S, SHARE, Kept
from sitl.sim.flight_log import COLUMNS
from sitl.sim.simulation import Simulation


class Clock:
    """Stands, and takes ``tick_s`` for each question."""

    def __init__(self) -> None:
        self.t_s, self.tick_s = 100.0, 0.0

    def __call__(self) -> float:
        self.t_s += self.tick_s
        return self.t_s


def mission(vehicles: int = 1) -> Simulation:
    """A mission that has flown nothing yet."""
    return Simulation(load_world("complex" if vehicles > 1 else "room", 1), load_settings(), 1, vehicles)


def flown(simulation: Simulation, until_s: float) -> None:
    """Fly on to that time."""
    simulation.ended_because = ""
    simulation.run(until_s)


@pytest.fixture
def clock() -> Clock:
    return Clock()


def voxels(source: MapSource) -> dict[int, bytes]:
    """Every chunk's values."""
    return {
        key: values.tobytes()
        for piece in source.pieces()
        for key, values in zip(keys_of(piece.chunks).tolist(), piece.values, strict=True)
    }


def rows_of(path: Path) -> Iterator[dict[str, str]]:
    """The rows of a trajectory; every one has all of its cells."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert {len(row) for row in rows} == {len(COLUMNS) + 1}
    return (dict(zip(rows[0], row, strict=True)) for row in rows[1:])


def looked(kept: Kept, clock: Clock, t_s: float) -> None:
    """Fly on, and look when it is time for that."""
    flown(kept.simulation, t_s)
    clock.t_s += 1000.0
    kept.look()


@pytest.mark.parametrize("vehicles", [1, 2])
def test_what_is_on_the_disk_is_what_was_flown_until_then(tmp_path: Path, clock: Clock, vehicles: int) -> None:
    """Protects an hour of flight from SIGKILL: all rows, and the map of all vehicles, as of the last look."""
    simulation = mission(vehicles)
    with Kept(tmp_path, simulation, clock) as kept:
        for t_s in (1.0, 2.0):
            looked(kept, clock, t_s)
            for flight in simulation.flights:
                rows = list(rows_of(kept.trajectory(flight.log)))
                assert [float(row["t_s"]) for row in rows] == pytest.approx(flight.log.column("t_s"), abs=1e-4)
                true_d_m = [float(row["true_d_m"] or "nan") for row in rows]
                assert true_d_m == pytest.approx(flight.log.column("true_d_m"), abs=1e-4, nan_ok=True)
            with Journal.read_only(tmp_path / JOURNAL_NAME) as journal:
                assert voxels(journal) == voxels(simulation.merged_map())
        flown(simulation, 3.0)
        kept.keep_map()
    with Journal.read_only(tmp_path / JOURNAL_NAME) as journal:
        assert voxels(journal) == voxels(simulation.merged_map())
    names = {"trajectory.csv"} if vehicles == 1 else {"trajectory-1.csv", "trajectory-2.csv"}
    assert {path.name for path in tmp_path.iterdir()} == {JOURNAL_NAME, *names}


def test_it_takes_no_more_of_the_time_than_its_share(tmp_path: Path, clock: Clock) -> None:
    """Protects the speed of the simulation on slow disks and in large mines: what takes long comes seldom."""
    simulation = mission()
    flown(simulation, 0.5)
    with Kept(tmp_path, simulation, clock) as kept:
        kept.look()
        assert not list(tmp_path.iterdir()), "before its time"
        clock.t_s += PERIOD_S
        clock.tick_s = 0.2
        kept.look()
        there = (tmp_path / "trajectory.csv").stat().st_size
        flown(simulation, 1.0)
        clock.tick_s = 0.0
        clock.t_s += 0.2 / SHARE - 0.1
        kept.look()
        assert (tmp_path / "trajectory.csv").stat().st_size == there, "before its time"
        clock.t_s += 0.2
        kept.look()
        assert (tmp_path / "trajectory.csv").stat().st_size > there


def test_a_disk_that_takes_nothing_ends_no_mission_and_is_tried_again(tmp_path: Path, clock: Clock) -> None:
    """Protects a flight from the disk; what is wrong with that is said by whoever writes the results."""
    simulation = mission()
    (tmp_path / "trajectory.csv").mkdir()
    (tmp_path / JOURNAL_NAME).touch()
    with Kept(tmp_path, simulation, clock) as kept:
        looked(kept, clock, 0.5)
        with pytest.raises(JournalError):
            kept.keep_map()
        (tmp_path / "trajectory.csv").rmdir()
        (tmp_path / JOURNAL_NAME).unlink()
        looked(kept, clock, 1.0)
        assert len(list(rows_of(tmp_path / "trajectory.csv"))) == len(simulation.flights[0].log)
        with Journal.read_only(tmp_path / JOURNAL_NAME) as journal:
            assert voxels(journal) == voxels(simulation.merged_map())


def test_half_a_row_that_a_full_disk_took_is_written_over(tmp_path: Path, clock: Clock) -> None:
    """Protects the table: what comes behind half a row would stand in the wrong columns."""
    simulation = mission()
    with Kept(tmp_path, simulation, clock) as kept:
        looked(kept, clock, 0.5)
        with (tmp_path / "trajectory.csv").open("ab") as file:
            file.write(b"0.5000,circle,1.2")
        looked(kept, clock, 1.0)
    assert len(list(rows_of(tmp_path / "trajectory.csv"))) == len(simulation.flights[0].log)


def test_the_table_at_the_end_takes_the_place_of_the_one_of_the_flight_at_once(tmp_path: Path, clock: Clock) -> None:
    """Protects the rows of an hour from a disk that is full when they get their true distances."""
    simulation = mission()
    with Kept(tmp_path, simulation, clock) as kept:
        looked(kept, clock, 0.5)
    log = simulation.flights[0].log
    there = (tmp_path / "trajectory.csv").read_bytes()

    def full(*_: object) -> str:
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(log), "csv_rows", full)
        with pytest.raises(OSError, match="No space"):
            log.write_csv(tmp_path / "trajectory.csv")
    assert (tmp_path / "trajectory.csv").read_bytes() == there
    log.column("true_d_m")[:] = np.arange(len(log))
    log.write_csv(tmp_path / "trajectory.csv")
    assert [row["true_d_m"] for row in rows_of(tmp_path / "trajectory.csv")][:2] == ["0.0000", "1.0000"]
