"""A vehicle in the air that its own mission hands over: the application may take it then, and from nobody else."""

from __future__ import annotations

import pytest

from companion.gate.faults import Fault, Stage
from companion.gate.gate import ARMING_BEAT_S
from companion.gate.protocol import Phase
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavResult
from companion.mavlink.modes import personality, px4_mode
from tests.gate.built import AUTOPILOT_NUMBER, SYSTEM
from tests.gate.gate_scene import JUST_S, NOW_S, Scene

AUTO, GUIDED, LOITER, LAND = 3, 4, 5, 9
SOON_S = NOW_S + 0.1


def in_its_mission(phase: Phase = Phase.CLIMBING, mode: int = AUTO) -> Scene:
    """ArduCopter, armed by somebody else, in the air."""
    scene = Scene(kind=AutopilotKind.ARDUPILOT, phase=phase)
    scene.heartbeat(mode)
    return scene


def is_ours(scene: Scene) -> bool:
    """Whether the gate watches the flight."""
    return scene.gate.airborne


def test_it_is_taken_from_its_mission_and_watched_from_then_on() -> None:
    scene = in_its_mission()
    assert not is_ours(scene)
    assert scene.mode(GUIDED)
    assert is_ours(scene), "before the autopilot shows it: whatever goes wrong now is ours"
    scene.heartbeat(GUIDED, SOON_S)
    assert scene.gate.airborne
    scene.gate.on_application_died("was killed")
    scene.gate.cycle(SOON_S)
    assert scene.gate.stage is Stage.BRAKE


@pytest.mark.parametrize("mode", [LOITER, LAND, 0, 2, 6, 17])
def test_a_vehicle_that_a_pilot_flies_is_not_taken(mode: int) -> None:
    """Protects the pilot from an application that is wrong about whose the vehicle is."""
    scene = in_its_mission(mode=mode)
    assert not scene.mode(GUIDED)
    assert not scene.gate.airborne
    assert scene.gate.counts["application: command refused"] == 1


def test_px4_has_no_mode_in_which_a_mission_hands_over() -> None:
    scene = Scene(phase=Phase.CLIMBING)
    for mode in (px4_mode(4, 4), px4_mode(4, 3), px4_mode(3), 0, AUTO):
        scene.heartbeat(mode)
        assert not scene.mode(personality(AutopilotKind.PX4).offboard)
    assert not scene.gate.airborne


def test_before_any_heartbeat_nothing_is_handed_over() -> None:
    scene = Scene(kind=AutopilotKind.PX4)
    scene.gate._vehicle._mode_monitor.mode = None
    assert not scene.gate._vehicle.hands_over


def test_only_an_application_that_ticks_takes_it() -> None:
    scene = in_its_mission()
    assert not scene.mode(GUIDED, NOW_S + ARMING_BEAT_S + JUST_S)
    assert scene.mode(GUIDED, NOW_S + ARMING_BEAT_S)


def test_standing_on_the_ground_the_mode_needs_no_handover() -> None:
    """A take-off begins with it."""
    scene = Scene(kind=AutopilotKind.ARDUPILOT)
    scene.heartbeat(LOITER, armed=False)
    assert scene.mode(GUIDED)
    assert not scene.gate.airborne


def test_in_its_own_flight_the_application_gets_the_mode_as_ever() -> None:
    scene = Scene(kind=AutopilotKind.ARDUPILOT)
    scene.fly()
    scene.heartbeat(GUIDED, NOW_S + ARMING_BEAT_S)
    assert scene.mode(GUIDED, NOW_S + ARMING_BEAT_S + JUST_S), "an old beat is another fault's business"


def test_a_handover_that_the_autopilot_refuses_leaves_the_vehicle_with_its_mission() -> None:
    """Protects a mission from being braked by the gate of an application that does not fly it."""
    scene = in_its_mission()
    assert scene.mode(GUIDED)
    scene.hear("COMMAND_ACK", SOON_S, command=176, result=MavResult.FAILED, target_system=SYSTEM, target_component=191)
    scene.heartbeat(AUTO, SOON_S)
    assert not scene.gate.airborne
    scene.gate.on_application_died("was killed")
    scene.gate.cycle(SOON_S)
    assert scene.gate.stage is Stage.PASS


def test_a_mode_that_is_refused_later_gives_nothing_back() -> None:
    scene = in_its_mission()
    assert scene.mode(GUIDED)
    scene.heartbeat(GUIDED, SOON_S)
    assert scene.mode(LAND, SOON_S)
    scene.hear("COMMAND_ACK", SOON_S, command=176, result=MavResult.FAILED, target_system=SYSTEM, target_component=191)
    assert scene.gate.airborne


def test_other_modes_hand_over_nothing() -> None:
    scene = in_its_mission()
    assert scene.mode(LAND)
    assert not scene.gate.airborne


def test_after_the_landing_a_new_arming_is_somebody_elses() -> None:
    scene = in_its_mission()
    assert scene.mode(GUIDED)
    scene.heartbeat(GUIDED, SOON_S)
    scene.gate.cycle(SOON_S)
    scene.heartbeat(GUIDED, SOON_S + 1.0, armed=False)
    scene.gate.cycle(SOON_S + 1.0)
    scene.heartbeat(AUTO, SOON_S + 5.0)
    assert not scene.gate.airborne


def test_a_stop_ordered_before_holds_what_is_taken() -> None:
    """Whoever ordered a stop while the mission flew has not taken it back."""
    scene = in_its_mission()
    assert scene.mode(GUIDED)
    scene.heartbeat(GUIDED, SOON_S)
    scene.gate._monitor.stop_ordered = True
    scene.gate.cycle(SOON_S)
    assert scene.gate.stage is Stage.BRAKE
    assert Fault.GROUND_STOP in scene.gate._escalation.counting
    assert not scene.mode(GUIDED, SOON_S)
    assert AUTOPILOT_NUMBER[scene.kind] == 3


@pytest.mark.parametrize("refused", [False, True])
def test_asking_for_the_mode_on_the_ground_hands_over_nothing(refused: bool) -> None:
    """Protects a pilot who arms while the application has only got as far as its mode, taken or refused."""
    scene = Scene(kind=AutopilotKind.ARDUPILOT)
    scene.heartbeat(LOITER, armed=False)
    assert scene.mode(GUIDED)
    if refused:
        ack = {"command": 176, "result": MavResult.FAILED, "target_system": SYSTEM, "target_component": 191}
        scene.hear("COMMAND_ACK", SOON_S, **ack)
    scene.heartbeat(LOITER if refused else GUIDED, SOON_S)
    assert not is_ours(scene)
