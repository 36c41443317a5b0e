"""A simulated mission comes home: flown by the same navigator, judged by the truth, and counted apart."""

from __future__ import annotations

import functools
from typing import Any

import pytest

from companion.config.mapping import MapSettings
from companion.config.mission import MissionSettings
from companion.config.sensors import CameraSettings, SensorSettings
from companion.config.settings import Settings
from companion.config.sim import BatterySettings, NoiseSettings, SimSettings
from sitl.mines import World, load_world
from sitl.sim.simulation import Simulation

EXPLORED_S = 60.0
QUICK: dict[str, Any] = {
    "sensors": SensorSettings(camera=CameraSettings(width_px=64, height_px=48)),
    "mapping": MapSettings(voxel_m=0.3),
}


@functools.cache
def room() -> World:
    return load_world("room", seed=1)


def flown(seed: int = 1, limit_s: float = EXPLORED_S, **changes: Any) -> Simulation:
    mission = Simulation(room(), Settings(**QUICK, **changes), seed)
    mission.run(limit_s)
    mission.come_home()
    return mission


def home_of(mission: Simulation) -> dict[str, Any]:
    homes = mission.score()["home"]
    assert isinstance(homes, list)
    return dict(homes[0])


@pytest.mark.parametrize("drift", [0.0, 0.01])
def test_it_stands_where_it_truly_started(drift: float) -> None:
    """The aim: within half a metre by the truth, also when its own position has drifted."""
    mission = flown(sim=SimSettings(noise=NoiseSettings(pose_drift_share=drift)))
    home = home_of(mission)
    assert home["ended_because"] == "home"
    assert home["arrived"]
    assert home["off_m"] < 0.3
    assert home["least_d_m"] > 0.7
    assert mission.score()["contacts"] == 0


def test_the_exploring_is_counted_without_the_way_home() -> None:
    """Protects every comparison with missions that stayed where they were."""
    stayed = Simulation(room(), Settings(**QUICK, mission=MissionSettings(end_action="land")), 1)
    stayed.run(EXPLORED_S)
    stayed.come_home()
    assert stayed.coming_home == ()
    came = flown()
    clock = {"wall_time_s", "times_real_time", "home", "precision", "accuracy_m", "occupied_voxels"}
    first, second = ({k: v for k, v in one.score().items() if k not in clock} for one in (stayed, came))
    assert first == second
    assert came.t_s > stayed.t_s


def test_it_turns_back_in_time_and_keeps_its_promise() -> None:
    """The reserve: a quarter of the battery is left at home, and what came is what was reckoned, to twenty seconds."""
    mission = flown(limit_s=900.0, sim=SimSettings(battery=BatterySettings(minutes=3.0), ends="done"))
    assert mission.ended_because == "battery needed for the way home"
    home = home_of(mission)
    assert home["ended_because"] == "home"
    assert home["promised_percent"] < 25.0
    assert home["time_s"] == pytest.approx(home["promised_s"], abs=20.0)
    assert home["came_percent"] > 23.0


def test_a_battery_that_falls_faster_is_landed_before_it_is_empty() -> None:
    """A worn cell on the way: it lands where it is, with what the gate's limit leaves, and does not fall."""
    worn = BatterySettings(minutes=3.0, worn_after_s=EXPLORED_S, worn_factor=20.0)
    home = home_of(flown(sim=SimSettings(battery=worn)))
    assert home["ended_because"] == "landed on the way: battery"
    assert not home["arrived"]


def test_who_stops_a_mission_stops_the_way_home_too() -> None:
    """Protects a user's Ctrl-C on the way home."""
    mission = Simulation(room(), Settings(**QUICK), 1)
    mission.run(EXPLORED_S)
    mission.come_home(stop=lambda: mission.t_s > EXPLORED_S + 2.0)
    assert home_of(mission)["ended_because"] == "stopped by the user"
