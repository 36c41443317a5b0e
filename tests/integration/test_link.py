"""The link in a whole flight: it is watched, stopped and sent home over it, and the map comes over whole."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from companion.link.ground.copy import MapCopy
from companion.link.ground.station import LinkStation
from companion.link.words import Answer, Command
from sitl.launch.processes import free_tcp_port
from tests.integration.whole import flown
from tests.integration.witness import speed_mps
from tests.link.rig import answer_to, known, until

STOPPED_S, STANDS_MPS = 3.0, 0.1


@pytest.mark.flight
@pytest.mark.timeout(300)
@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_a_flight_is_watched_stopped_and_sent_home_over_the_link(personality: str, tmp_path: Path) -> None:
    """Protects the operator's side as a whole; the witness says whether it really stands."""
    endpoint = f"tcp/127.0.0.1:{free_tcp_port()}"
    link = {"enabled": True, "name": "drone1", "listen": [endpoint], "finish_s": 30.0}
    with (
        flown(tmp_path, personality, link=link) as flight,
        LinkStation(tmp_path / "ground", connect=[endpoint], name="anna") as ground,
    ):
        flight.explore_for(2.0)
        vehicle = known(ground)
        assert answer_to(vehicle, Command.STOP) == Answer(accepted=True)
        time.sleep(STOPPED_S)
        assert speed_mps(flight.witness.pose()) < STANDS_MPS
        until(lambda: vehicle.telemetry is not None and vehicle.telemetry.paused)
        assert answer_to(vehicle, Command.CONTINUE) == Answer(accepted=True)
        time.sleep(3.0)
        assert answer_to(vehicle, Command.HOME) == Answer(accepted=True)
        assert flight.exit_code(120.0) == 0, flight.said()[-1500:]
        assert vehicle.has_whole_map
        assert vehicle.telemetry is not None
        assert vehicle.telemetry.phase == "ended"
        assert len(vehicle.way_m()) > 5
        whole = vehicle.map_sum
    copy = MapCopy(flight.folder)
    assert copy.sum == whole, "the ground's map is the vehicle's"
    copy.close()
    assert "anna over the link: stop: done" in flight.said()
    assert flight.crew.score()["contacts"] == 0
