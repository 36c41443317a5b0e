"""The link in a flight: what it tells of it, and what its silence means."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from companion.autopilot.vehicle_state import VehicleState
from companion.config.load import load_settings
from companion.config.settings import Settings
from companion.flight.events import Event, EventEmitter
from companion.flight.ground_link import GroundLink
from companion.flight.operator_commands import OperatorCommands, Wish
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.flight.situation import WARN_S, Situation
from companion.link.vehicle.client import LinkClient
from companion.link.wire import decoded, encoded
from companion.link.words import Command, Telemetry
from companion.mapping.process.client import MapClient
from companion.mapping.process.messages import MapStatus
from companion.pipeline import Explorer
from tests.shared.clocks import HandClock

LOST_S = 20.0


class Silent:
    """In the place of the process of the link: the ground was heard so long ago."""

    silent_s = 0.0

    def offer(self, _telemetry: Telemetry) -> None:
        """It goes nowhere."""

    async def finish(self) -> None:
        """At once."""


class Mapper:
    """In the place of the map."""

    status = MapStatus(completeness=0.5, frontiers=2, frontiers_m=((1.0, 2.0, 3.0),))


class Nobody:
    """In the place of an autopilot that was never heard."""

    def __init__(self) -> None:
        self.poses = self

    def newest(self) -> None:
        return None

    def state(self, _now_s: float) -> VehicleState:
        return VehicleState(False, "unknown", None, None, math.inf, math.inf, False, None)


def settings(link_lost: str) -> Settings:
    return load_settings(None).model_validate(
        {"mission": {"link_lost": link_lost, "link_lost_s": LOST_S}, "link": {"enabled": True, "name": "drone1"}}
    )


class Rig:
    """A link in a flight, without the process."""

    def __init__(self, link_lost: str = "go_on") -> None:
        self.clock, self.flight, self.told = HandClock(), PhaseMachine(), list[tuple[Event, dict[str, object]]]()
        self.flight.phase = FlightPhase.EXPLORING
        self.operator = OperatorCommands(by_command=True, flight=self.flight)
        self.settings = settings(link_lost)
        explorer = Explorer(self.settings, np.random.default_rng(1))
        mapper = cast("MapClient", Mapper())
        self.situation = Situation(
            "drone1", "f", 1.1, 25.0, self.flight, cast("Any", Nobody()), mapper, explorer, self.clock
        )

        def sink(event: Event, details: Mapping[str, object]) -> None:
            self.told.append((event, dict(details)))

        events = EventEmitter(sink, self.situation.sink)
        self.link = GroundLink(
            self.settings,
            Path("map.journal"),
            self.situation,
            explorer,
            mapper,
            self.operator,
            self.flight,
            events,
            self.clock,
        )
        self.silence = Silent()
        self.link.client = cast("LinkClient", self.silence)

    def passes(self, time_s: float) -> None:
        """Time in which the ground is silent."""
        for _ in range(int(time_s)):
            self.clock.advance(1.0)
            self.silence.silent_s += 1.0
            self.link._watch_silence()


@pytest.mark.parametrize(("link_lost", "wish"), [("go_on", Wish.NOTHING), ("home", Wish.HOME), ("land", Wish.LAND)])
def test_what_follows_when_the_ground_is_silent(link_lost: str, wish: Wish) -> None:
    """Protects both who wants the vehicle to fly on underground and who wants it back."""
    rig = Rig(link_lost)
    rig.passes(LOST_S - 1.0)
    assert rig.operator.wish is Wish.NOTHING
    rig.passes(3.0)
    assert rig.operator.wish is wish
    assert [event for event, _ in rig.told] == [Event.LINK_LOST], "told once"
    rig.silence.silent_s = 0.0
    rig.passes(LOST_S + 2.0)
    assert len(rig.told) == 2, "and again when it was heard meanwhile"


def test_who_was_never_heard_is_silent_from_the_beginning_of_the_exploring() -> None:
    rig = Rig("home")
    rig.silence.silent_s = math.inf
    rig.passes(LOST_S - 1.0)
    assert not rig.operator.stop.is_set(), "not at once: the ground gets its time"
    rig.passes(3.0)
    assert rig.operator.wish is Wish.HOME


def test_on_the_ground_silence_means_nothing() -> None:
    rig = Rig("land")
    rig.flight.phase = FlightPhase.WAITING
    rig.passes(10 * LOST_S)
    assert rig.operator.wish is Wish.NOTHING
    assert not rig.told


def test_commands_are_done_and_told_of() -> None:
    rig = Rig()
    assert rig.link.obey(Command.PAUSE, "anna").accepted
    assert rig.flight.paused
    assert not rig.link.obey(Command.START, "anna").reason
    rig.flight.phase = FlightPhase.LEAVING
    assert not rig.link.obey(Command.HOME, "bob").accepted
    assert [(event, details["who"]) for event, details in rig.told][::2] == [
        (Event.LINK_COMMAND, "anna"),
        (Event.LINK_COMMAND, "bob"),
    ]


def test_what_is_not_known_is_not_told_as_a_number() -> None:
    """Before anything was heard of the vehicle; and it goes over the link as it is."""
    rig = Rig()
    told = rig.situation.telemetry()
    assert (told.x_m, told.d_m, told.battery_percent, told.home_m) == (None, None, None, None)
    assert (told.phase, told.completeness, told.frontiers) == ("exploring", 0.5, 2)
    assert decoded(Telemetry, encoded(told)) == told
    assert rig.situation.telemetry().number == told.number + 1


def test_warnings_are_told_for_a_while() -> None:
    rig = Rig()
    rig.situation.sink(Event.GATE_NOTICE, {"text": "brake: depth_stale"})
    rig.situation.sink(Event.EXPLORING, {})
    assert rig.situation.telemetry().warnings == ("gate: brake: depth_stale",)
    rig.clock.advance(WARN_S + 1.0)
    assert rig.situation.telemetry().warnings == ()


@pytest.mark.parametrize(("silent_s", "told"), [(math.inf, 0), (3.0, 1)])
async def test_only_a_ground_that_was_heard_is_said_to_fetch_the_map(silent_s: float, told: int) -> None:
    """Vehicles that have the link for each other end without a word of it."""
    rig = Rig()
    rig.silence.silent_s = silent_s
    await rig.link.finish()
    assert [event for event, _ in rig.told] == [Event.LINK_FINISHING] * told
