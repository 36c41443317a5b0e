"""What PX4 says in EVENT messages, as texts: by MAVSDK's metadata where it has any, by number where not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from mavsdk.plugins.events import (
    Event,
    HealthAndArmingCheckMode,
    HealthAndArmingCheckProblem,
    HealthAndArmingCheckReport,
    LogLevel,
)

from companion.autopilot import px4_events
from companion.autopilot.interface import Message
from companion.autopilot.px4_events import METADATA_S, Px4Events
from tests.shared.clocks import HandClock

GIMBAL = 154
ARMING_DENIED = 0x01234ABC


class Plugin:
    """MAVSDK's `Events` without MAVSDK: the test says what it decoded."""

    def __init__(self, _system: object) -> None:
        self.decoded: Callable[[Event, object], None]
        self.checked: Callable[[HealthAndArmingCheckReport, object], None]

    def subscribe_events(self, callback: Callable[[Event, object], None]) -> None:
        self.decoded = callback

    def subscribe_health_and_arming_checks(
        self, callback: Callable[[HealthAndArmingCheckReport, object], None]
    ) -> None:
        self.checked = callback


class System:
    """As MAVSDK has discovered it."""

    def get_system_id(self) -> int:
        return 7


class Px4:
    """Events of a PX4 with the system id 7, and what is made of them."""

    def __init__(self) -> None:
        self.clock = HandClock()
        self.put: list[Message] = []
        system: Any = System()
        self.events = Px4Events(system, self.put.append, self.clock)
        plugin: Any = self.events._events
        self.plugin: Plugin = plugin

    def says(self, message: str, level: LogLevel = LogLevel.CRITICAL, component: int = 1) -> None:
        """An event that MAVSDK knows the text of."""
        self.plugin.decoded(Event(component, message, "a longer description", level, "px4", "a_name"), None)

    def raw(self, log_levels: int) -> None:
        """The same as it came, which MAVSDK hands over whether it knows the text or not."""
        self.events.on_raw({"id": ARMING_DENIED, "log_levels": log_levels, "arguments": [0] * 40})

    def finds(self, *problems: str) -> None:
        """The report of its arming checks."""
        each = [HealthAndArmingCheckProblem(text, "", LogLevel.ERROR, "") for text in problems]
        self.plugin.checked(HealthAndArmingCheckReport(HealthAndArmingCheckMode("", False, each), [], each), None)

    @property
    def texts(self) -> list[tuple[int, str]]:
        return [(message.fields["severity"], message.fields["text"]) for message in self.put]


@pytest.fixture
def px4(monkeypatch: pytest.MonkeyPatch) -> Px4:
    monkeypatch.setattr(px4_events, "Events", Plugin)
    return Px4()


def test_an_event_comes_as_the_text_that_a_ground_station_would_get(px4: Px4) -> None:
    """Protects "the autopilot said": PX4 sends this application no STATUSTEXT, and a refusal came without a reason."""
    px4.clock.advance(3.0)
    px4.says("Arming denied: Resolve system health failures first", LogLevel.CRITICAL)
    px4.says("Takeoff detected", LogLevel.INFO)
    assert px4.texts == [(2, "Arming denied: Resolve system health failures first"), (6, "Takeoff detected")]
    said = px4.put[0]
    # One whole text, of the autopilot itself: telemetry takes it for what it is.
    assert (said.name, said.system_id, said.component_id, said.received_s) == ("STATUSTEXT", 7, 1, px4.clock.now_s())
    assert (said.fields["id"], said.fields["chunk_seq"]) == (0, 0)


def test_what_other_components_say_is_not_put_in_the_autopilots_mouth(px4: Px4) -> None:
    """Protects the reason of a refusal from a gimbal's complaints."""
    px4.says("Gimbal overheated", component=GIMBAL)
    assert px4.texts == []


def test_without_metadata_an_event_is_told_by_its_number(px4: Px4) -> None:
    """Protects from silence where the texts cannot be had: a number can be looked up, nothing cannot.

    Not while they may still be on the way, and only what is a warning or worse by its external level: the lower four
    bits of the byte, the upper four are what PX4 logs it as.
    """
    warning, notice = 0x64, 0x45
    px4.clock.advance(METADATA_S - 0.1)
    px4.raw(warning)
    assert px4.texts == []
    px4.clock.advance(0.2)
    px4.raw(notice)
    px4.raw(warning)
    assert px4.texts == [(4, "event 0x01234abc, whose text the autopilot does not tell")]


@pytest.mark.parametrize("by", ["a text", "a report"])
def test_with_metadata_no_event_is_told_by_its_number_too(px4: Px4, by: str) -> None:
    """Protects from each refusal being told twice, once in words and once as a number that says less."""
    if by == "a text":
        px4.says("Takeoff detected")
    else:
        px4.finds()
    told = px4.texts.copy()
    px4.clock.advance(METADATA_S + 1.0)
    px4.raw(0x22)
    assert px4.texts == told


def test_arming_problems_are_those_of_the_newest_report_each_once(px4: Px4) -> None:
    """Protects the reason of a refused arming: PX4 names a problem for each mode, and drops it when it has passed."""
    assert list(px4.events.problems) == []
    px4.finds("No valid position estimate", "", "Battery low", "No valid position estimate")
    assert list(px4.events.problems) == ["No valid position estimate", "Battery low"]
    px4.finds("Battery low")
    assert list(px4.events.problems) == ["Battery low"]
    px4.finds()
    assert list(px4.events.problems) == []
