"""The mode Explore of the stub, as the script makes it on the real one (`tests/real/test_explore_mode.py`)."""

from __future__ import annotations

import pytest

from sitl.autopilot import ARDUPILOT, PX4
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from tests.sitl.autopilot.rig import Rig

EXPLORE, GROUND = 101, (255, 190)
ACCEPTED, NOT_NOW, FAILED, IN_PROGRESS = 0, 1, 4, 5


def with_script(enabled: int = 1) -> Rig:
    """A vehicle that has booted, and whose companion lives."""
    rig = Rig(ARDUPILOT, parameters={"SCR_ENABLE": enabled})
    rig.run(3.0)
    heartbeat(rig)
    return rig


def heartbeat(rig: Rig) -> None:
    rig.send(m.MAVLink_heartbeat_message(m.MAV_TYPE_ONBOARD_CONTROLLER, m.MAV_AUTOPILOT_INVALID, 0, 0, 3, 3))


def choose(rig: Rig) -> int:
    command = m.MAV_CMD_DO_SET_MODE
    (answer,) = rig.send(m.MAVLink_command_long_message(1, 1, command, 0, 1, EXPLORE, 0, 0, 0, 0, 0), GROUND)
    return int(answer.result)


def asked(messages: list[Message]) -> int:
    """How often the companion was asked to start."""
    return sum(
        one.get_type() == "COMMAND_LONG" and (one.target_component, one.command) == (191, m.MAV_CMD_MISSION_START)
        for one in messages
    )


def answer(rig: Rig, result: int, command: int = m.MAV_CMD_MISSION_START) -> None:
    rig.send(m.MAVLink_command_ack_message(command, result, 0, 0, 1, 1))
    rig.run(0.1)


def test_chosen_on_the_ground_it_asks_once_and_stays_when_that_is_accepted() -> None:
    rig = with_script()
    assert choose(rig) == ACCEPTED
    assert asked(rig.run(0.2)) == 1
    answer(rig, ACCEPTED)
    assert rig.mode == "EXPLORE"
    assert rig.texts()[-1] == "Explore: started"
    assert asked(rig.run(5.0)) == 0


def test_refused_it_says_so_and_goes_back() -> None:
    rig = with_script()
    before = rig.mode
    choose(rig)
    rig.run(0.2)
    answer(rig, IN_PROGRESS)
    answer(rig, ACCEPTED, command=400)
    assert rig.mode == "EXPLORE", "that was no answer to it"
    answer(rig, NOT_NOW)
    assert rig.mode == before
    assert "Explore: start: not now" in rig.texts()


def test_unanswered_it_asks_again_and_gives_up() -> None:
    rig = with_script()
    before = rig.mode
    choose(rig)
    assert 5 <= asked(rig.run(3.2)) <= 7
    assert rig.mode == before
    assert "Explore: start: the companion is not heard" in rig.texts()


@pytest.mark.parametrize("why", ["no script", "no companion", "armed"])
def test_it_cannot_be_chosen(why: str) -> None:
    rig = with_script(enabled=int(why != "no script"))
    before = rig.mode
    if why == "no companion":
        rig.run(3.5)
    rig.vehicle.state.armed = why == "armed"
    assert choose(rig) == FAILED
    assert rig.mode == before
    assert asked(rig.run(1.0)) == 0


def test_px4_has_no_such_mode() -> None:
    rig = Rig(PX4)
    rig.run(3.0)
    heartbeat(rig)
    choose(rig)
    assert asked(rig.run(1.0)) == 0
