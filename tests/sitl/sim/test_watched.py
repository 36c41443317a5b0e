"""A simulated mission as the page sees it."""

from __future__ import annotations

import numpy as np
import pytest

from companion.config.load import load_settings
from companion.link.words import Answer, Command
from companion.mapping.voxels.piece import MapSource
from sitl.mines import load_world
from sitl.sim.simulation import Simulation
from sitl.sim.watched import WatchedSimulation


def chunks(source: MapSource) -> dict[tuple[int, ...], bytes]:
    """Every chunk with its voxels."""
    return {
        tuple(chunk): values.tobytes()
        for piece in source.pieces()
        for chunk, values in zip(piece.chunks.tolist(), piece.values, strict=True)
    }


def test_the_page_gets_what_the_vehicle_has_and_only_what_changed() -> None:
    """Protects the picture: the copy is the map, voxel for voxel, the figures are those of the flight, ways grow."""
    now = [0.0]
    simulation = Simulation(load_world("room", 1), load_settings(), 1)
    station = WatchedSimulation(simulation, "a mission", now_s=lambda: now[0])
    [vehicle] = station.vehicles()
    assert vehicle.age_s == float("inf")

    def tick() -> bool:
        now[0] += 0.1
        station.look()
        return False

    simulation.run(2.0, stop=tick)
    first = vehicle.changed(0)
    simulation.ended_because = ""
    simulation.run(4.0, stop=tick)
    station.look(now=True)
    assert chunks(vehicle.source()) == chunks(simulation.flights[0].map)
    assert 0 < len(vehicle.changed(first.revision).chunks) <= len(vehicle.changed(0).chunks)
    assert len(vehicle.changed(vehicle.changed(0).revision).chunks) == 0
    told, here = vehicle.telemetry, simulation.flights[0].estimated
    assert told is not None
    assert (told.x_m, told.y_m, told.z_m) == pytest.approx((here.x_m, here.y_m, here.z_m))
    assert told.flight == "a mission"
    assert told.frame == (0.0, 0.0, 0.0, 0.0), "the maps of a simulation lie in the frame of its world"
    assert told.ended_because == "time limit"
    assert np.linalg.norm(np.diff(vehicle.way_m(), axis=0), axis=1).min(initial=1.0) >= 0.2
    answers: list[Answer | None] = []
    vehicle.ask(Command.STOP, answers.append)
    assert answers[0] is not None
    assert not answers[0].accepted
