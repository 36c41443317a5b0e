"""A flight from the gate's side: whose the vehicle is, how it ends, what is said."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from companion.gate.faults import Stage
from companion.gate.protocol import Goodbye, Phase
from companion.mavlink.firmware import AutopilotKind
from tests.gate.built import BEAT, KINDS, Air, command, in_the_air, texts_of


def test_px4_that_held_by_itself_is_not_called_back() -> None:
    """Protects a failsafe of the autopilot: on the first setpoint PX4 would go back to offboard."""
    air = in_the_air()
    air.positions = air.heartbeats = False
    air.run(1.5)
    air.positions = air.heartbeats = True
    air.mode = air.ours.hold
    air.heartbeat()
    silent = len(air.stops())
    air.run(3.0)
    assert len(air.stops()) == silent
    assert not air.gate.airborne
    assert any(notice.startswith("hands off: mode hold") for notice in air.notices)


@pytest.mark.parametrize("kind", KINDS)
def test_a_pilot_who_takes_over_has_it_at_once(kind: AutopilotKind) -> None:
    """Protects the pilot's last word: nothing of the gate or the application moves the vehicle any more."""
    air = in_the_air(kind=kind)
    air.beats = False
    air.run(0.5)
    assert air.stage() is Stage.BRAKE
    air.mode = 3 << 16 if kind is AutopilotKind.PX4 else 5
    air.heartbeat()
    before = len(air.stops())
    air.beats = True
    passed = len(air.passed)
    air.run(10.0)
    assert len(air.stops()) == before
    assert len(air.passed) == passed
    assert air.modes() == []
    for order in (
        command(400, 1.0),
        command(22),
        command(21),
        command(176, *air.ours.set_mode_parameters(air.ours.land)),
    ):
        assert air.ask(order) is None
    assert sum(notice.startswith("hands off") for notice in air.notices) == 1
    assert [fields["system_status"] for _, name, fields in air.sent if name == "HEARTBEAT"][-1] == 3


@pytest.mark.parametrize("kind", KINDS)
def test_a_hold_that_cannot_be_had_becomes_a_landing(kind: AutopilotKind) -> None:
    """Protects PX4 without a global origin, which refuses to hold."""
    air = in_the_air(kind=kind)
    air.beats = air.setpoints = False
    air.obeys = False
    air.run(5.3)
    assert air.stage() is Stage.HOLD
    air.tell("COMMAND_ACK", command=176, result=1, target_system=1, target_component=192)
    air.run(3.0)
    assert air.stage() is Stage.LAND
    land = air.ours.set_mode_parameters(air.ours.land)[1]
    assert air.modes()[-1] == land if kind is AutopilotKind.ARDUPILOT else land
    air.obeys = True
    air.run(2.0)
    assert air.mode == air.ours.land
    assert air.stops()[-1] > air.now_s - 2.0, "stopped by setpoints until the mode shows"


@pytest.mark.parametrize("kind", KINDS)
def test_a_take_off_of_the_autopilot_is_not_disturbed_by_stops(kind: AutopilotKind) -> None:
    """Protects a take-off from one late beat: zero velocity would suppress ArduPilot's; what stays late is held."""
    air = Air(kind=kind)
    air.setpoints = False
    air.heartbeat()
    air.beat = replace(BEAT, phase=Phase.CLIMBING)
    air.run(0.2)
    assert air.ask(command(400, 1.0)) is not None
    air.armed = True
    assert air.set_mode(air.ours.offboard if kind is AutopilotKind.ARDUPILOT else air.ours.hold) is not None
    assert air.ask(command(22)) is not None
    air.mode = min(air.ours.taking_off)
    air.heartbeat()
    air.beats = False
    air.run(0.5)
    air.beats = True
    air.run(1.5)
    assert (air.stage(), air.stops(), air.modes()) == (Stage.PASS, [], [])
    air.beats = False
    air.run(5.5)
    assert air.stage() is Stage.HOLD
    assert air.mode == air.ours.hold
    assert air.stops() == []


def test_who_lands_already_is_not_made_to_hold() -> None:
    """Protects a landing that the application began: what comes later is milder."""
    air = in_the_air()
    air.beat = replace(BEAT, phase=Phase.ENDING)
    assert air.set_mode(air.ours.land) is not None
    air.setpoints = air.beats = False
    air.run(8.0)
    assert air.stage() is Stage.HOLD
    assert air.mode == air.ours.land
    assert air.modes() == []
    again = in_the_air()
    again.beat = replace(BEAT, phase=Phase.ENDING)
    again.obeys = False
    assert again.set_mode(again.ours.land) is not None
    again.setpoints = again.beats = False
    again.run(5.5)
    assert set(again.modes()) == {4.0}
    assert all(fields["param3"] == 6.0 for _, name, fields in again.sent if name == "COMMAND_LONG"), "land, not hold"


def test_the_end_of_a_flight_in_good_order() -> None:
    """Protects the ordinary end: landed, disarmed, said goodbye; nothing of it is a fault."""
    air = in_the_air()
    air.beat = replace(BEAT, phase=Phase.ENDING)
    assert air.set_mode(air.ours.land) is not None
    air.setpoints = False
    air.run(3.0)
    air.armed = False
    air.run(1.1)
    air.beat = replace(BEAT, phase=Phase.ENDED)
    air.run(0.1)
    air.beats = False
    air.run(5.0)
    air.gate.on_word(Goodbye(3).packed(), air.now_s)
    assert air.gate.goodbye == Goodbye(3)
    assert (air.gate.airborne, air.gate.armed, air.stage()) == (False, False, Stage.PASS)
    assert air.notices == []


def test_a_vehicle_left_holding_is_left_alone() -> None:
    """Protects ``end_action: hold``: the application writes its map for minutes and sends no beats."""
    air = in_the_air()
    air.beat = replace(BEAT, phase=Phase.ENDED)
    assert air.set_mode(air.ours.hold) is not None
    air.setpoints = False
    air.run(0.2)
    air.beats = False
    air.run(60.0)
    assert air.stage() is Stage.PASS
    assert air.stops() == []


def test_another_firmware_with_our_number_is_not_believed() -> None:
    """Protects the pilot's takeover from being forgotten because of a stranger on the line."""
    air = in_the_air()
    air.mode = 3 << 16
    air.heartbeat()
    air.run(0.1)
    assert not air.gate.airborne
    air.tell("HEARTBEAT", autopilot=3, base_mode=128, custom_mode=4)
    air.run(0.1)
    assert not air.gate.airborne


def test_a_refused_arming_is_no_flight() -> None:
    """Protects the ground: as long as nothing is armed there are no faults and no stops."""
    air = Air()
    air.heartbeat()
    air.run(0.2)
    air.setpoints = False
    assert air.ask(command(400, 1.0)) is not None
    air.tell("COMMAND_ACK", command=400, result=0)
    air.run(0.1)
    assert air.gate.airborne, "accepted, and no heartbeat can have said so yet"
    air.tell("COMMAND_ACK", command=400, result=4)
    air.run(0.1)
    assert air.gate.armed is False
    air.tell("COMMAND_ACK", command=22, result=4)
    air.tell("COMMAND_ACK", command=176, result=4, target_component=77)
    air.tell("PARAM_VALUE")
    air.run(0.1)
    assert air.notices == []


def test_a_landing_by_command_is_ours() -> None:
    """Protects NAV_LAND of the application: the mode that follows is not a stranger's."""
    air = in_the_air()
    air.beat = replace(BEAT, phase=Phase.ENDING)
    air.setpoints = False
    assert air.ask(command(21)) is not None
    air.mode = air.ours.land
    air.run(3.0)
    assert air.gate.airborne
    air.armed = False
    air.run(1.5)
    assert not any(notice.startswith("hands off") for notice in air.notices)


def test_texts_for_the_pilot_do_not_pile_up() -> None:
    """Protects the link: the newest eight wait, two a second go out, each fits a STATUSTEXT."""
    air = Air()
    for i in range(30):
        air.gate.on_application_died(f"number {i}")
    assert len(texts_of(air.gate)) == 30
    assert texts_of(air.gate) == []
    air = in_the_air()
    air.beat = replace(BEAT, depth_age_s=9.0, ranges_age_s=9.0, pose_age_s=9.0, map_age_s=99.0)
    air.run(0.3)
    assert sum(name == "STATUSTEXT" for _, name, _ in air.sent) == 1
    air.run(10.0)
    texts = [(t_s, fields["text"]) for t_s, name, fields in air.sent if name == "STATUSTEXT"]
    assert len(texts) >= 5
    assert all(later - earlier > 0.49 for (earlier, _), (later, _) in itertools.pairwise(texts))
    assert all(len(text) <= 50 for _, text in texts)


def test_a_landing_stays_due_when_the_application_ends_its_flight_in_a_hold() -> None:
    """Protects the last step: the application sees the hold, ends, and says nothing more of its dead camera."""
    air = in_the_air()
    air.beat = replace(BEAT, depth_age_s=9.0)
    air.run(7.0)
    assert air.mode == air.ours.hold
    air.setpoints = False
    air.beat = replace(BEAT, phase=Phase.ENDED)
    air.run(0.1)
    air.beats = False
    air.gate.on_word(Goodbye(1).packed(), air.now_s)
    air.run(22.0)
    assert air.mode == air.ours.hold
    air.run(3.0)
    assert air.mode == air.ours.land
