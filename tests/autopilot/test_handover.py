"""ArduCopter's own mission that hands the vehicle over: noticed, taken, and left alone where it is not ours."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from companion.autopilot.handover import ASK_S, STALE_S, Handover
from companion.autopilot.vehicle_state import VehicleState
from companion.mavlink.firmware import AutopilotKind
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock

FLYING = VehicleState(
    armed=True, mode="auto", landed=False, battery_percent=80.0, heartbeat_age_s=0.5, pose_age_s=0.0,
    position_valid=True, version="4.7.0",
)  # fmt: skip
WAYPOINT = {"seq": 1, "command": 16, "param1": 0.0, "mission_type": 0}
HANDS_OVER = {"seq": 2, "command": 92, "param1": 1.0, "mission_type": 0}


class Mission:
    """As the autopilot tells of it."""

    def __init__(self, kind: AutopilotKind = AutopilotKind.ARDUPILOT, answers: bool = True) -> None:
        self.clock = HandClock()
        self.link = FakeLink(self.clock, kind)
        self.items: dict[int, dict[str, Any]] = {1: WAYPOINT, 2: HANDS_OVER}
        self.handover = Handover(self.link)
        if answers:
            self.link.on_send = self._answer

    def _answer(self, name: str, fields: dict[str, Any]) -> None:
        assert name == "MISSION_REQUEST_INT"
        assert (fields["target_system"], fields["target_component"], fields["mission_type"]) == (1, 1, 0)
        self.link.deliver("MISSION_ITEM_INT", self.items[fields["seq"]])

    def at(self, item: object, state: VehicleState = FLYING) -> bool:
        """Whether it is ours when the autopilot has come to this item: what is not known yet is asked for."""
        self.link.deliver("MISSION_CURRENT", {"seq": item})
        self.handover.is_ours(state, self.clock.now_s())
        return self.handover.is_ours(state, self.clock.now_s())


def test_it_is_ours_at_the_item_and_not_before() -> None:
    mission = Mission()
    assert not mission.at(1)
    mission.clock.advance(ASK_S)
    assert mission.at(2)
    mission.clock.advance(ASK_S)
    assert not mission.at(1)


@pytest.mark.parametrize(
    "changes",
    [
        {"param1": 0.0},
        {"param1": float("nan")},
        {"param1": None},
        {"command": 93},
        {"command": None},
        {"mission_type": 1},
        {"seq": 3},
        {"seq": None},
    ],
)
def test_another_item_hands_nothing_over(changes: dict[str, Any]) -> None:
    mission = Mission()
    mission.items[2] = HANDS_OVER | changes
    assert not mission.at(2)


@pytest.mark.parametrize(
    "changes", [{"mode": "guided"}, {"mode": "loiter"}, {"armed": False}, {"landed": True}, {"landed": None}]
)
def test_it_has_to_fly_in_its_mission(changes: dict[str, Any]) -> None:
    """Protects whoever stands beside it, and the pilot who has taken it."""
    mission = Mission()
    assert not mission.at(2, replace(FLYING, **changes))
    assert mission.link.sent == [], "nothing is asked for either"


def test_another_mission_is_asked_for_anew() -> None:
    """The item of the one before had the same number."""
    mission = Mission()
    assert mission.at(2)
    mission.at(2, replace(FLYING, armed=False))
    mission.items[2] = WAYPOINT | {"seq": 2}
    mission.clock.advance(ASK_S)
    assert not mission.at(2)


def test_an_item_that_is_not_answered_is_asked_for_once_a_second() -> None:
    mission = Mission(answers=False)
    for _ in range(10):
        assert not mission.at(2)
        mission.clock.advance(ASK_S / 4.0)
    assert len(mission.link.sent) == 3
    mission.link.gone = True
    mission.clock.advance(ASK_S)
    assert not mission.at(2)


def test_a_mission_that_is_not_told_any_more_is_none() -> None:
    mission = Mission()
    assert mission.at(2)
    mission.clock.advance(STALE_S + 0.1)
    assert not mission.handover.is_ours(FLYING, mission.clock.now_s())


@pytest.mark.parametrize("seq", [None, -1, 65536, 1.5])
def test_a_number_that_is_none_is_not_asked_for(seq: object) -> None:
    mission = Mission()
    assert not mission.at(seq)
    assert mission.link.sent == []


def test_px4_hands_nothing_over() -> None:
    mission = Mission(AutopilotKind.PX4)
    assert not mission.at(2, replace(FLYING, mode="mission"))
    assert mission.link.sent == []
