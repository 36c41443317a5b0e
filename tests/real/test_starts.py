"""The starts that a ground station of ArduCopter has: a mission that hands the vehicle over, and the mode "Explore".

The real ArduCopter, with the whole application.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.launch.processes import Crew, FlightPlan
from tests.integration.rig import process, wait_for_words
from tests.integration.whole import end_family
from tests.real.conftest import real_or_skip
from tests.real.test_explore_mode import EXPLORE, SCRIPT
from validation.real.station import Station

READY_S, FLIES_S, ENDS_S = 120.0, 60.0, 120.0
EXPLORES_S = 20.0
HIGHER_M = 2.2
"""Than the height H of the settings: the companion sinks to that."""


class MissionStation(Station):
    """One that uploads a mission: it answers each question for an item."""

    def __init__(self, port: int) -> None:
        self.items: list[tuple[int, float, float]] = []  # command, parameter 1, altitude
        self.uploaded: int | None = None
        super().__init__(port)

    def upload(self, *items: tuple[int, float, float]) -> None:
        """A mission: the autopilot's home, then these."""
        self.items = [(16, 0.0, 0.0), *items]
        self.send(m.MAVLink_mission_count_message(1, 1, len(self.items), 0))
        self.wait("the mission is taken", lambda: self.uploaded == m.MAV_MISSION_ACCEPTED, 10.0)

    def _hear(self, message: Message, now_s: float) -> None:
        super()._hear(message, now_s)
        if message.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
            command, first, altitude_m = self.items[message.seq]
            place = (0, 0, altitude_m)
            relative = m.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
            item = (1, 1, message.seq, relative, command, 0, 1, first, 0.0, 0.0, 0.0, *place)
            self.send(m.MAVLink_mission_item_int_message(*item))
        elif message.get_type() == "MISSION_ACK":
            self.uploaded = message.type


@contextmanager
def waiting(folder: Path, parameters: dict[str, float]) -> Iterator[tuple[MissionStation, Path]]:
    """The real ArduCopter in a room, and the application, which waits for its start; its log."""
    settings = {"mission": {"start": "command", "end_action": "land"}}
    real = real_or_skip("ardupilot")
    scripts = folder / "autopilot" / "scripts"
    scripts.mkdir(parents=True)
    shutil.copy(SCRIPT, scripts)
    plan = FlightPlan(folder, "ardupilot", time_limit_s=EXPLORES_S, settings=settings, real=real, parameters=parameters)
    log = folder / "application.log"
    with (
        Crew(plan) as crew,
        MissionStation(crew.ports.ground) as ground,
        process(log, crew.application("--fix")) as gate,
    ):
        try:
            wait_for_words(log, gate, "ready: waiting for MAV_CMD_MISSION_START", READY_S)
            yield ground, log
            gate.wait(ENDS_S)
        finally:
            end_family(gate.pid)
    assert crew.score()["contacts"] == 0


@pytest.mark.real
@pytest.mark.timeout(400)
def test_a_mission_hands_the_vehicle_over_and_it_explores_from_there(tmp_path: Path) -> None:
    """Protects who plans in Mission Planner: take-off, NAV_GUIDED_ENABLE, and the rest is the companion's."""
    with waiting(tmp_path, {}) as (ground, log):
        ground.upload((m.MAV_CMD_NAV_TAKEOFF, 0.0, HIGHER_M), (m.MAV_CMD_NAV_GUIDED_ENABLE, 1.0, 0.0))
        assert ground.ask(m.MAV_CMD_DO_SET_MODE, 1.0, 4.0) == [0]
        assert ground.ask(m.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == [0]
        assert ground.ask(m.MAV_CMD_MISSION_START) == [0]
        ground.wait("auto", lambda: ground.mode == "auto", 5.0)
        ground.wait("handed over", lambda: ground.mode == "guided", FLIES_S)
        assert 1.5 < ground.pose().z_m < 2.7, "in the air, where the mission took it"
        ground.wait("it lands", lambda: ground.mode == "land", EXPLORES_S + FLIES_S)
        ground.wait("it lies", lambda: not ground.armed, FLIES_S)
    said = log.read_text(encoding="utf-8")
    assert "taking the vehicle over from its own mission" in said
    assert "exploring ended: time limit" in said


@pytest.mark.real
@pytest.mark.timeout(400)
def test_the_mode_explore_starts_the_flight(tmp_path: Path) -> None:
    """Protects the whole of script, autopilot, gate and application: one mode, chosen at a ground station."""
    with waiting(tmp_path, {"SCR_ENABLE": 1.0}) as (ground, log):
        assert ground.ask(m.MAV_CMD_DO_SET_MODE, 1.0, float(EXPLORE)) == [0]
        ground.wait("the companion has it", lambda: ground.mode == "guided" and ground.armed, FLIES_S)
        assert ground.ask(m.MAV_CMD_DO_SET_MODE, 1.0, float(EXPLORE)) == [4], "not in the air"
        ground.wait("it lands", lambda: ground.mode == "land", EXPLORES_S + FLIES_S)
        ground.wait("it lies", lambda: not ground.armed, FLIES_S)
    assert any("Explore: started" in text for text in ground.texts)
    assert "exploring ended: time limit" in log.read_text(encoding="utf-8")
