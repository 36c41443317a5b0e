"""From take-off to the end: what the gate is told meanwhile, and who has the vehicle when something goes wrong."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Self

import pytest

from companion.config.load import load_settings
from companion.config.settings import Settings
from companion.control import completion
from companion.control.completion import MapWord
from companion.control.homing.homing import WayHome
from companion.flight.airborne import GOES_BACK_S, Airborne
from companion.flight.events import Event, EventEmitter
from companion.flight.gate_client import GateClient, GateLostError, GateTookOverError
from companion.flight.lookout import Lookout
from companion.flight.operator_commands import InterruptedFlightError, OperatorCommands, Wish
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.flight.termination import Termination
from companion.gate.faults import Fault, Stage
from companion.gate.protocol import Notice, Phase
from companion.mavlink.firmware import AutopilotKind
from companion.model import Measurement, Pose
from tests.flight.fake_gate import FakeGate
from tests.flight.test_reporting import STATUS
from tests.flight.test_termination import conditions
from tests.shared.clocks import HandClock

SETTINGS = load_settings()
NOTHING_LEFT = MapWord(frontier_m=0.0, seen_share=1.0, surfaces_seen=1000, has_room=True)
BACK_S = 4.0
STALL_S = 5.0
"""Longer than an autopilot may be silent, shorter than inputs may be missing."""


class Vehicle:
    """Does what it is told, and notes it; hangs in the manoeuvre that the test names."""

    def __init__(self, gate: GateClient, clock: HandClock) -> None:
        self.told: list[tuple[str, Phase]] = []
        self.hangs = ""
        self.patience_s = 60.0
        self.taken_over: str | None = None
        self.by_failsafe = False
        self.mode, self.armed = "hold", True
        self.leaves_in = "land"
        self._gate = gate
        self._clock = clock

    async def _do(self, what: str) -> None:
        self.told.append((what, self._gate.phase))
        if self.hangs == what:
            await self._clock.sleep(self.patience_s)

    async def take_off(self, *_: object) -> None:
        await self._do("take off")

    async def engage(self) -> None:
        await self._do("engage")
        self.mode = "offboard"

    async def land(self) -> bool:
        await self._do("land")
        self.mode, self.armed = "land", False
        return True

    async def hold(self) -> None:
        await self._do("hold")
        self.mode = "hold"

    async def take_over(self, *_: object) -> None:
        await self._do("take over")

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._do("leave")
        if self.armed and self.mode == "offboard":
            self.mode = self.leaves_in


class ControlLoop:
    """Ticks, until the test has it fail."""

    def __init__(self, gate: GateClient, flight: PhaseMachine, clock: HandClock) -> None:
        self.fresh_s = 0.0
        self.pose = Pose(0.0, 1.0, 2.0, 1.5, 0.0)
        self.way_is_left: bool | None = None
        self.off_m: float | None = None
        """How far home is; None: nobody knows."""
        self.way: WayHome | None = None
        self.is_home = self.way_is_closed = self.goes_back = False
        self.sees = True
        self.measurement: Measurement | None = None
        self.fails = False
        self._gate = gate
        self._flight = flight
        self._clock = clock

    def measured_height_m(self) -> float:
        return 1.5

    def is_way_left(self) -> bool | None:
        return self.way_is_left

    def way_home(self, anew: bool = False) -> WayHome | None:
        del anew
        return self.way

    @property
    def lands_elsewhere(self) -> bool:
        return False

    def off_home_m(self) -> float | None:
        return self.off_m

    @property
    def unsure_m(self) -> float:
        return 0.31

    async def run(self) -> None:
        while True:
            self._gate.look()
            if self.fails and self._flight.phase is FlightPhase.EXPLORING:
                raise ZeroDivisionError
            self._gate.ticked(1.0, None, None)
            if self.off_m is not None and self.sees:
                self.fresh_s = self._clock.now_s()
            await self._clock.sleep(0.05)


class Stand:
    """A flight on which all is well until the test says otherwise."""

    def __init__(self, gate: FakeGate, settings: Settings = SETTINGS) -> None:
        self.gate = gate
        self.phases = PhaseMachine()
        self.clock = HandClock()
        self.talk = GateClient(gate.link, self.clock, EventEmitter(), self.phases)
        self.vehicle = Vehicle(self.talk, self.clock)
        self.control_loop = ControlLoop(self.talk, self.phases, self.clock)
        self.heartbeat_s: float | None = None
        """When the autopilot was last heard; None: just now."""
        self.charge_percent = 80.0
        self.operator = OperatorCommands(by_command=False, flight=self.phases)
        self.status = STATUS
        self.events: list[tuple[Event, dict[str, object]]] = []
        emitter = EventEmitter(lambda event, details: self.events.append((event, dict(details))))
        session = SimpleNamespace(
            settings=settings,
            clock=self.clock,
            link=SimpleNamespace(kind=AutopilotKind.PX4),
            telemetry=SimpleNamespace(state=self._state),
            gate=self.talk,
            flight=self.phases,
        )
        parts: Any = (session, self.operator, self.vehicle, self.control_loop, self, emitter)
        self.flight = Airborne(*parts)

    def _state(self, now_s: float) -> object:
        age_s = 0.5 if self.heartbeat_s is None else now_s - self.heartbeat_s
        vehicle = self.vehicle
        return replace(
            conditions().vehicle,
            armed=vehicle.armed,
            mode=vehicle.mode,
            heartbeat_age_s=age_s,
            battery_percent=self.charge_percent,
        )

    async def _meanwhile(self, what: str) -> None:
        await self.clock.sleep(0.3)
        if what == "complete":
            self.status = replace(STATUS, word=NOTHING_LEFT)
        elif what == "stop":
            self.operator.stop.set()
            self.operator.wish = Wish.END
        elif what == "gate dies":
            self.gate.die()
        elif what == "gate holds":
            self.gate.notify(Notice(Stage.HOLD, Fault.DEPTH_STALE, "hold: depth_stale"))
            await self.clock.sleep(0.1)
            self.vehicle.taken_over = "hold"
        elif what in ("back to the ground", "not back", "taken on the way back"):
            self.control_loop.goes_back = True
            self.status = replace(STATUS, word=NOTHING_LEFT)
            await self.clock.sleep(BACK_S)
            if what == "taken on the way back":
                self.vehicle.taken_over = "position"
            self.control_loop.goes_back = what != "back to the ground"
        elif what in ("a pilot", "a failsafe"):
            self.vehicle.taken_over, self.vehicle.by_failsafe = "hold", what == "a failsafe"
        elif what in ("stall", "stall and silence"):
            self.heartbeat_s = self.clock.now_s()
            self.clock.advance(STALL_S)
            if what == "stall":
                await self.clock.sleep(1.0)
                self.heartbeat_s = None
                await self.clock.sleep(0.5)
                self.status = replace(STATUS, word=NOTHING_LEFT)
        elif what == "silence":
            self.heartbeat_s = self.clock.now_s()
        elif what == "tick fails":
            self.control_loop.fails = True

    async def fly(self, what: str) -> Termination:
        """One flight in which this happens soon after the take-off."""
        happening = asyncio.create_task(self._meanwhile(what))
        try:
            return await self.flight.run()
        finally:
            happening.cancel()

    @property
    def told(self) -> list[str]:
        return [what for what, _ in self.vehicle.told]


@pytest.fixture
def stand(monkeypatch: pytest.MonkeyPatch) -> Iterator[Stand]:
    # So long no flight of these tests has fresh inputs.
    monkeypatch.setattr(completion, "SUSTAINED_S", 0.0)
    with FakeGate() as gate:
        yield Stand(gate)


def test_a_mode_that_the_gate_has_asked_for_is_not_taken_for_a_pilots(stand: Stand) -> None:
    """Protects the summary: ArduPilot tells of a new mode at once, before the application listens to the gate again."""
    parts: Any = (stand.flight._session, stand.operator, stand.vehicle, stand.control_loop, stand)
    lookout = Lookout(*parts)
    stand.gate.notify(Notice(Stage.HOLD, Fault.GPS_LOST, "hold: gps_lost"))
    stand.vehicle.taken_over = "brake"
    now = lookout.look()
    assert now.taken_over
    assert now.gate_took_over


async def test_the_gate_knows_what_is_to_be_expected_at_every_time(stand: Stand) -> None:
    assert await stand.fly("complete") is Termination.COMPLETE
    assert stand.vehicle.told == [
        ("take off", Phase.CLIMBING),
        ("engage", Phase.CLIMBING),
        ("land", Phase.ENDING),
        ("leave", Phase.ENDING),
    ]
    phases = list(dict.fromkeys(beat.phase for beat in stand.gate.beats()))
    assert phases[-1] is Phase.ENDED
    assert [phase for phase in phases if phase is not Phase.ENDING] == [Phase.CLIMBING, Phase.EXPLORING, Phase.ENDED]


async def test_when_the_gate_dies_nothing_more_is_tried(stand: Stand) -> None:
    assert await stand.fly("gate dies") is Termination.GATE_LOST
    assert "land" not in stand.told
    assert stand.phases.phase is FlightPhase.ENDED


@pytest.mark.parametrize("hangs", ["take off", "engage"])
async def test_when_the_gate_dies_during_the_take_off_it_is_over_at_once(hangs: str, stand: Stand) -> None:
    stand.vehicle.hangs = hangs
    with pytest.raises(GateLostError, match="gate lost"):
        await stand.fly("gate dies")
    assert stand.told[-1] == "leave"


async def test_when_the_gate_holds_hands_are_off_and_it_is_named(stand: Stand) -> None:
    assert await stand.fly("gate holds") is Termination.GATE
    why, end = "gate took over hold: depth_stale", "gate took over"
    assert stand.events[-1] == (Event.ENDED_EARLY, {"why": why, "end": end, "then": "hands off"})
    assert "land" not in stand.told
    assert stand.talk.phase is Phase.ENDED


@pytest.mark.parametrize(("who", "why"), [("a pilot", Termination.PILOT), ("a failsafe", Termination.FAILSAFE)])
async def test_whoever_takes_the_vehicle_is_named_and_keeps_it(stand: Stand, who: str, why: Termination) -> None:
    """Protects who reads the end of the flight: a failsafe of the autopilot was told as a pilot who took over."""
    assert await stand.fly(who) is why
    assert "land" not in stand.told
    assert stand.events[-1] == (Event.ENDED_EARLY, {"why": f"{why} hold", "end": str(why), "then": "hands off"})


async def test_after_a_stall_of_ours_the_autopilot_is_not_taken_for_lost(stand: Stand) -> None:
    """Protects from ending a flight for a silence that we slept through: PX4's failsafe was overruled by a landing."""
    assert await stand.fly("stall") is Termination.COMPLETE


async def test_an_autopilot_that_stays_silent_after_a_stall_is_lost(stand: Stand) -> None:
    """Protects from waiting for ever: its time is counted from when we are awake again."""
    began_s = stand.clock.now_s()
    assert await stand.fly("stall and silence") is Termination.LINK
    assert stand.clock.now_s() - began_s == pytest.approx(0.3 + STALL_S + SETTINGS.safety.stale.heartbeat_s, abs=0.5)


async def test_an_autopilot_that_falls_silent_is_lost_in_its_time(stand: Stand) -> None:
    """Protects from a stall that is seen where none was: looks as regular as these are no reason to wait longer."""
    began_s = stand.clock.now_s()
    assert await stand.fly("silence") is Termination.LINK
    assert stand.clock.now_s() - began_s == pytest.approx(0.3 + SETTINGS.safety.stale.heartbeat_s, abs=0.5)


async def test_a_take_off_that_the_gate_ends_is_named_as_that(stand: Stand) -> None:
    """On PX4 hold is a mode of the take-off too: without its word the climb would be waited for."""
    stand.vehicle.hangs = "take off"
    with pytest.raises(GateTookOverError, match="during the take-off: hold: depth_stale"):
        await stand.fly("gate holds")
    assert stand.told == ["take off", "leave"]


async def test_a_landing_is_not_broken_off_by_the_gate(stand: Stand) -> None:
    """It would be told to land once more, by whoever has just stopped waiting for it."""
    stand.vehicle.hangs, stand.vehicle.patience_s = "land", 0.5
    stand.status = replace(STATUS, word=NOTHING_LEFT)
    assert await stand.fly("gate holds") is Termination.COMPLETE
    assert stand.told == ["take off", "engage", "land", "leave"]


async def test_a_stop_in_the_take_off_breaks_it_off(stand: Stand) -> None:
    stand.vehicle.hangs = "take off"
    with pytest.raises(InterruptedFlightError):
        await stand.fly("stop")
    assert stand.told == ["take off", "leave"]
    assert dict(stand.vehicle.told)["leave"] is Phase.ENDING


async def test_an_exception_in_a_tick_leaves_the_vehicle_landing_and_is_seen(stand: Stand) -> None:
    with pytest.raises(ZeroDivisionError):
        await stand.fly("tick fails")
    assert stand.told[-1] == "leave"
    assert stand.talk.phase is Phase.ENDED, "the map may be written in peace"


async def test_a_vehicle_that_could_not_be_left_in_order_stays_the_gates_business(stand: Stand) -> None:
    """Else nobody would stop a vehicle that flies on in offboard while the map is written."""
    stand.vehicle.leaves_in = "offboard"
    with pytest.raises(ZeroDivisionError):
        await stand.fly("tick fails")
    assert stand.talk.phase is Phase.ENDING
    assert Phase.ENDED not in {beat.phase for beat in stand.gate.beats()}


async def test_known_ground_with_a_way_left_keeps_it_flying_whatever_the_map_says(stand: Stand) -> None:
    """Protects an untaken exit that the map's plan does not show. Where the exploring ended is known afterwards."""
    stand.control_loop.way_is_left = True
    stand.status = replace(STATUS, word=NOTHING_LEFT)
    assert await stand.fly("nothing") is Termination.INPUTS
    assert stand.flight.done_at_s is None
    assert stand.flight.end == stand.control_loop.pose


async def test_the_end_tells_when_the_mission_was_done(stand: Stand) -> None:
    stand.control_loop.way_is_left = False
    assert await stand.fly("complete") is Termination.COMPLETE
    assert stand.flight.done_at_s == pytest.approx(stand.flight.explored_s, abs=0.2)


async def test_a_vehicle_that_is_handed_over_in_the_air_is_not_taken_off_with(stand: Stand) -> None:
    stand.operator.in_air = True
    assert await stand.fly("complete") is Termination.COMPLETE
    assert stand.told == ["take over", "engage", "land", "leave"]
    assert stand.events[0] == (Event.TAKING_OVER, {})


@pytest.mark.parametrize(("what", "after_s"), [("back to the ground", BACK_S), ("not back", GOES_BACK_S)])
async def test_over_a_shaft_it_is_not_landed_while_it_goes_back(stand: Stand, what: str, after_s: float) -> None:
    """Protects a vehicle whose time, or map, or battery ends in the seconds over an edge: it would land into it."""
    began_s = stand.clock.now_s()
    assert await stand.fly(what) is Termination.COMPLETE
    # That the map is complete is found within two seconds.
    assert 0.0 <= stand.clock.now_s() - began_s - 0.3 - after_s <= 2.0
    assert "land" in stand.told
    beats = [beat.phase for beat in stand.gate.beats() if beat.phase in (Phase.EXPLORING, Phase.ENDING)]
    assert beats.count(Phase.EXPLORING) * 0.05 > after_s - 0.5, "it is steered until then"


async def test_who_takes_it_on_its_way_back_keeps_it(stand: Stand) -> None:
    stand.control_loop.goes_back = True
    assert await stand.fly("taken on the way back") is Termination.COMPLETE
    assert "land" not in stand.told
