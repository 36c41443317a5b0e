"""The script that gives the real ArduCopter the mode "Explore": what it asks of the companion computer, and when.

Another end stands in for the companion computer, so that what it answers is the test's choice.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from companion.config.settings import Settings
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.launch.processes import free_udp_ports
from sitl.launch.program import Ports, Running
from tests.real.conftest import real_or_skip
from tests.shared.beside import wait_until
from validation.fault_matrix.stand import RealStand
from validation.real.station import Station

SCRIPT = Path(__file__).parents[2] / "ground-stations" / "explore.lua"
PARAMETERS = {"SCR_ENABLE": 1.0}
EXPLORE, GUIDED = 101, 4
START, PAUSE_CONTINUE, HOME = 300, 193, 20
SCRIPTING1, LOW, MIDDLE, HIGH = 300, 0, 1, 2
ACCEPTED, NOT_NOW, FAILED = 0, 1, 4
BOOT_S, READY_S, SAYS_S, QUIET_S = 60.0, 90.0, 15.0, 1.0


class Companion(Station):
    """Component 191 as the autopilot sees it: it lives, hears commands to itself, and answers as it is told.

    Attributes:
        result: of every command; None: no answer.
        asked: the commands that came, with their first parameter.
    """

    def __init__(self, port: int) -> None:
        self.result: int | None = ACCEPTED
        self.asked: list[tuple[int, float]] = []
        self.lives = True
        super().__init__(port)
        self.beating = False

    def _hear(self, message: Message, now_s: float) -> None:
        super()._hear(message, now_s)
        name = message.get_type()
        if name == "HEARTBEAT" and self.lives:
            beat = m.MAVLink_heartbeat_message(m.MAV_TYPE_ONBOARD_CONTROLLER, m.MAV_AUTOPILOT_INVALID, 0, 0, 3, 3)
            self.send(beat, (1, 191))
        elif name == "COMMAND_LONG" and message.target_component == 191:
            command, parameter = message.command, message.param1
            self.asked.append((command, parameter))
            if self.result is not None:
                self.send(m.MAVLink_command_ack_message(command, self.result, 0, 0, 1, 1), (1, 191))

    def _ask_for_positions(self) -> None:
        """Nobody here wants them."""


class Scene:
    """The real ArduCopter with the script, a ground station, and who stands in for the companion computer."""

    def __init__(self, ground: Station, companion: Companion) -> None:
        self.ground, self.companion = ground, companion

    def chooses(self, mode: int) -> int:
        """The ground station chooses a mode; how that is answered."""
        (result,) = self.ground.ask(m.MAV_CMD_DO_SET_MODE, 1.0, float(mode))
        return result

    def switched(self, level: int) -> set[tuple[int, float]]:
        """The button of an auxiliary function, as Mission Planner has it; what the companion is asked for then."""
        self.companion.asked.clear()
        assert self.ground.ask(m.MAV_CMD_DO_AUX_FUNCTION, float(SCRIPTING1), float(level)) == [ACCEPTED]
        time.sleep(QUIET_S)
        return set(self.companion.asked)

    def says(self, words: str) -> None:
        """Until a text has come that has these words."""
        wait_until(lambda: any(words in text for text in self.ground.texts), f"{words!r} is said", SAYS_S)

    def shows(self, mode: str) -> None:
        """Until the heartbeat does."""
        self.ground.wait(f"mode {mode}", lambda: self.ground.mode == mode, SAYS_S)

    def arm(self) -> None:
        """As soon as it can be."""
        assert self.chooses(GUIDED) == ACCEPTED
        ready_s = time.monotonic() + READY_S
        while self.ground.ask(m.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) != [ACCEPTED]:
            assert time.monotonic() < ready_s, self.ground.texts
            time.sleep(2.0)


@contextmanager
def scene(folder: Path) -> Iterator[Scene]:
    stand = RealStand(real_or_skip("ardupilot"), parameters=PARAMETERS)
    scripts = folder / "autopilot" / "scripts"
    scripts.mkdir(parents=True)
    shutil.copy(SCRIPT, scripts)
    application_port, ground_port, world_port, control = free_udp_ports(4)
    ports = Ports(application_port, ground_port, world_port)
    with Station(ground_port) as ground, Companion(application_port) as companion:
        running = Running(stand.program(folder, Settings(), ports, control), folder)
        try:
            running.wait(BOOT_S)
            found = Scene(ground, companion)
            found.says("Explore: mode 101 is there")
            yield found
        finally:
            running.end()


@pytest.mark.real
@pytest.mark.timeout(200)
def test_explore_asks_the_companion_to_start_and_tells_what_it_answers(tmp_path: Path) -> None:
    """Protects the pilot from a mode that looks taken while nothing happens."""
    with scene(tmp_path) as now:
        companion = now.companion

        companion.lives = False
        time.sleep(4.0)
        assert now.chooses(EXPLORE) == FAILED, "without a companion there is nothing to choose"
        companion.lives = True
        time.sleep(2.0)

        companion.result = NOT_NOW
        assert now.chooses(EXPLORE) == ACCEPTED
        now.says("Explore: start: not now")
        now.shows("stabilize")
        assert companion.asked == [(START, 0.0)]

        companion.result, companion.asked = None, []
        assert now.chooses(EXPLORE) == ACCEPTED
        now.says("Explore: start: the companion is not heard")
        now.shows("stabilize")
        assert 4 <= len(companion.asked) <= 7, "asked again while no answer came"
        assert set(companion.asked) == {(START, 0.0)}

        companion.result, companion.asked = ACCEPTED, []
        assert now.chooses(EXPLORE) == ACCEPTED
        now.says("Explore: started")
        now.shows(f"mode {EXPLORE}")
        time.sleep(QUIET_S)
        assert companion.asked == [(START, 0.0)], "asked once"


@pytest.mark.real
@pytest.mark.timeout(200)
def test_the_auxiliary_function_starts_pauses_and_comes_home(tmp_path: Path) -> None:
    """Mission Planner has a button for each of its levels; a switch of the transmitter may have it too."""
    with scene(tmp_path) as now:
        assert now.switched(HIGH) == set(), "it stood high when it was first seen"
        now.says("Explore: the switch is on, switch it off")
        assert now.switched(LOW) == set(), "on the ground low is no order"
        assert now.switched(HIGH) == {(START, 0.0)}
        now.companion.result = NOT_NOW
        assert now.switched(MIDDLE) == set()
        assert now.switched(HIGH) == {(START, 0.0)}
        now.says("Explore: start: not now")

        now.companion.result = ACCEPTED
        now.arm()
        assert now.switched(MIDDLE) == {(PAUSE_CONTINUE, 0.0)}
        assert now.switched(HIGH) == {(PAUSE_CONTINUE, 1.0)}
        assert now.switched(LOW) == {(HOME, 0.0)}
        assert now.chooses(EXPLORE) == FAILED, "whoever has an armed vehicle keeps it"
        assert now.ground.mode == "guided"
