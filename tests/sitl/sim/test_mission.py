"""Whole missions: the same code as `companion sim`, from the first observation to the end."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from companion.config.load import load_settings
from companion.model import Beam
from sitl.mines import load_world
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
    assert float(str(summary["path_length_m"])) > 30.0
