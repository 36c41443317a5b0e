"""The way home: what turns a flight back, what it is told and promised, and what happens when home is not reached."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from companion.config.settings import Settings
from companion.control import completion
from companion.control.homing.homing import LONGER_S, WayHome
from companion.flight.coming_home import TELL_PERIOD_S
from companion.flight.events import Event
from companion.flight.operator_commands import Wish
from companion.flight.phase import FlightPhase
from companion.flight.termination import Termination
from companion.gate.faults import Fault, Stage
from companion.gate.protocol import Notice, Phase
from companion.model import Measurement
from tests.flight.fake_gate import FakeGate
from tests.flight.test_airborne import NOTHING_LEFT, Stand, stand
from tests.flight.test_reporting import STATUS

__all__ = ["stand"]


WAY_M, WAY_S = 20.0, 200.0
DRAIN_PERCENT_PER_S = 0.1


class Homeward(Stand):
    """A flight that turns back for what the test says, and on which something happens on the way home.

    It drains so that it would be empty after 800 s, is home after `flies_s`, and never gets there where that is None.
    """

    def __init__(self, gate: FakeGate, end_action: str = "home") -> None:
        super().__init__(gate, Settings.model_validate({"mission": {"end_action": end_action}}))
        self.control_loop.off_m, self.control_loop.way = 15.0, WayHome(WAY_M, WAY_S)
        self.flies_s: float | None = 40.0
        self.drain = DRAIN_PERCENT_PER_S
        self.turned_s: float | None = None
        self.turned_percent = 0.0
        self.happens = ""

    async def fly(self, what: str) -> Termination:
        life = asyncio.create_task(self._live())
        try:
            return await super().fly(what)
        finally:
            life.cancel()

    async def _live(self) -> None:
        while True:
            await self.clock.sleep(0.1)
            self.charge_percent -= 0.1 * self.drain
            if self.phases.phase is not FlightPhase.HOMING:
                continue
            if self.turned_s is None:
                self.turned_s, self.turned_percent = self.clock.now_s(), self.charge_percent
            on_way_s = self.clock.now_s() - self.turned_s
            if self.flies_s is not None and on_way_s > self.flies_s:
                self.control_loop.is_home, self.control_loop.off_m = True, 0.12
            if on_way_s > 10.0:
                self._happen()

    def _happen(self) -> None:
        what, self.happens = self.happens, ""
        if what == "blind":
            self.control_loop.sees = False
        elif what == "drains ten times as fast":
            self.drain = 10.0 * DRAIN_PERCENT_PER_S
        elif what == "no way":
            self.control_loop.way_is_closed = True
            self.flies_s = 20.0
        elif what == "stop":
            self.operator.wish = Wish.END
        elif what == "landing ordered":
            self.operator.wish = Wish.LAND
        elif what == "pilot":
            self.vehicle.taken_over = "position"
        elif what == "gate dies":
            self.gate.die()
        elif what == "gate holds":
            self.gate.notify(Notice(Stage.HOLD, Fault.DEPTH_STALE, "hold: depth_stale"))
            self.vehicle.taken_over = "hold"
        elif what == "silence":
            self.heartbeat_s = self.clock.now_s()

    def seen(self, event: Event) -> list[dict[str, object]]:
        return [details for one, details in self.events if one is event]


@pytest.fixture
def homeward(stand: Stand) -> Homeward:
    return Homeward(stand.gate)


async def test_what_is_complete_comes_home_and_lands_there(homeward: Homeward) -> None:
    """Protects what the vehicle is built for: it is back, and what came of the battery stands beside the promise."""
    assert await homeward.fly("complete") is Termination.COMPLETE
    assert homeward.told == ["take off", "engage", "land", "leave"]
    phases = list(dict.fromkeys(beat.phase for beat in homeward.gate.beats()))
    assert Phase.EXPLORING in phases, "the gate watches the way home as it watches the exploring"
    assert homeward.flight.explored_s < 5.0, "the way home is counted apart"
    came = homeward.flight.homecoming
    assert came is not None
    assert came.as_it_should
    found = came.as_json()
    assert found["arrived"]
    assert (found["ended_because"], found["way_home_m"], found["off_home_m"]) == ("home", WAY_M, 0.12)
    assert found["off_home_unsure_m"] == 0.31
    assert found["homing_s"] == pytest.approx(40.0, abs=1.0)
    assert found["charge_turning_percent"] - found["charge_came_percent"] == pytest.approx(4.0, abs=0.3)
    assert found["charge_promised_percent"] == pytest.approx(80.0 - 3.0 - 23.0, abs=1.0), "once it knows what it draws"
    (turned,) = homeward.seen(Event.HOMING)
    assert turned["instead"] == "Ctrl-C twice"
    assert turned["outlook"] == "20 m, battery 80 %", "the drain of a few seconds is no drain"
    assert len(homeward.seen(Event.HOMING_PROGRESS)) == 40.0 // TELL_PERIOD_S
    assert homeward.seen(Event.LANDED) == [{"off": "0.1 m", "unsure": ", give or take 0.3 m"}]
    assert not homeward.seen(Event.ENDED)


async def test_it_turns_back_when_the_reserve_would_be_flown(homeward: Homeward) -> None:
    """Protects the battery on arrival: 200 s of way and a landing at 0.1 %/s, and a quarter has to be left."""
    homeward.drain = DRAIN_PERCENT_PER_S
    homeward.flies_s = 200.0
    assert await homeward.fly("nothing") is Termination.RESERVE
    found = homeward.flight.homecoming
    assert found is not None
    assert homeward.turned_percent == pytest.approx(25.0 + 23.0, abs=1.0)
    assert found.charge_promised_percent == pytest.approx(25.0, abs=0.5)
    assert found.charge_came_percent == pytest.approx(25.0 + 3.0, abs=1.0), "no time passes in this landing"


@pytest.mark.parametrize(
    ("happens", "ended", "told"),
    [
        ("blind", Termination.INPUTS, ["land"]),
        ("drains ten times as fast", Termination.BATTERY, ["land"]),
        ("nothing", Termination.TIME, ["land"]),
        ("no way", Termination.CLOSED, ["land"]),
        ("landing ordered", Termination.STOPPED, ["land"]),
        ("pilot", Termination.PILOT, []),
        ("gate holds", Termination.GATE, []),
        ("gate dies", Termination.GATE_LOST, []),
        ("silence", Termination.LINK, ["land"]),
    ],
)
async def test_when_home_cannot_be_reached(
    homeward: Homeward, happens: str, ended: Termination, told: list[str]
) -> None:
    """Protects the vehicle and its pilot: each row of the table in docs/flying.md."""
    homeward.flies_s, homeward.happens = None, happens
    homeward.drain = 0.0 if ended is Termination.TIME else DRAIN_PERCENT_PER_S
    assert await homeward.fly("complete") is Termination.COMPLETE
    assert homeward.told == ["take off", "engage", *told, "leave"]
    came = homeward.flight.homecoming
    assert came is not None
    assert came.ended is ended
    assert came.as_it_should is (ended is Termination.STOPPED)
    event = Event.HOMING_ENDED if came.as_it_should else Event.HOMING_ENDED_EARLY
    (said,) = homeward.seen(event)
    assert said["then"] == ("landing" if told else "hands off")
    assert len(homeward.seen(Event.WAY_CLOSED)) == (ended is Termination.CLOSED), "told once, when it is found out"


async def test_a_way_home_that_takes_too_long_ends_in_its_time(homeward: Homeward) -> None:
    """Protects from circling before a closed way until the battery is empty."""
    homeward.flies_s, homeward.drain = None, 0.0
    await homeward.fly("complete")
    came = homeward.flight.homecoming
    assert came is not None
    assert came.homing_s == pytest.approx(3.0 * WAY_S + LONGER_S, abs=1.0)


async def test_a_battery_that_falls_faster_is_told_and_flown_home_with_as_far_as_it_goes(homeward: Homeward) -> None:
    """Protects whoever has to fetch it: each metre nearer counts, and its pilot knows soon."""
    homeward.flies_s, homeward.happens = None, "drains ten times as fast"
    homeward.control_loop.way = WayHome(80.0, 800.0)
    await homeward.fly("complete")
    assert homeward.seen(Event.OUT_OF_REACH) == [{"spent": "16"}]
    assert homeward.charge_percent == pytest.approx(16.0, abs=0.5)


async def test_a_battery_with_nothing_left_is_landed_where_it_is(homeward: Homeward) -> None:
    homeward.charge_percent = 15.5
    assert await homeward.fly("nothing") is Termination.BATTERY
    assert homeward.flight.homecoming is None
    assert homeward.told == ["take off", "engage", "land", "leave"]


@pytest.mark.parametrize("end_action", ["land", "hold", "home"])
async def test_a_person_sends_it_home_or_lands_it_whatever_is_configured(stand: Stand, end_action: str) -> None:
    for wish, comes_home in ((Wish.HOME, True), (Wish.LAND, False), (Wish.END, end_action == "home")):
        flight = Homeward(stand.gate, end_action)
        flight.operator.wish = wish
        if wish is Wish.END and end_action == "hold":
            continue
        assert await flight.fly("nothing") is Termination.STOPPED
        assert (flight.flight.homecoming is not None) is comes_home
        assert flight.told == ["take off", "engage", "land", "leave"]


async def test_the_first_stop_on_the_way_home_is_answered(homeward: Homeward) -> None:
    """Protects from a Ctrl-C that seems to be ignored, after which a second one lands it in the mine."""
    homeward.happens = "stop"
    assert await homeward.fly("complete") is Termination.COMPLETE
    assert len(homeward.seen(Event.HOMING_ALREADY)) == 1
    assert homeward.seen(Event.HOMING_ENDED)[0]["why"] == "home"


async def test_a_place_that_is_not_fit_to_land_on_is_told(homeward: Homeward) -> None:
    homeward.control_loop.measurement = Measurement(0.0, 0.1, None, 1.5, None, 0.5, 0.4, 0.0, 0.4, 0.0, 2.0, 0.05)
    await homeward.fly("complete")
    assert homeward.seen(Event.UNFIT_TO_LAND) == [{"what": "a slope of 50% and 0.4 m beside a wall"}]


async def test_a_pause_is_no_reason_to_be_done(stand: Stand, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the half minute in which it flies on before it is done: who stands finds nothing."""
    monkeypatch.setattr(completion, "SUSTAINED_S", 5.0)
    flight = Homeward(stand.gate)
    flight.status = replace(STATUS, word=NOTHING_LEFT)

    async def pause() -> None:
        await flight.clock.sleep(2.0)
        assert flight.phases.pause(True)
        await flight.clock.sleep(30.0)
        assert flight.phases.phase is FlightPhase.EXPLORING
        flight.phases.pause(False)

    pausing = asyncio.create_task(pause())
    assert await flight.fly("nothing") is Termination.COMPLETE
    await pausing
    assert flight.flight.explored_s == pytest.approx(35.0, abs=3.0)


@pytest.mark.parametrize(("what", "why"), [("blind", Termination.INPUTS), ("time", Termination.TIME)])
async def test_what_ends_a_flight_ends_a_paused_one(homeward: Homeward, what: str, why: Termination) -> None:
    """Protects from a pause that nobody ends."""

    async def pause() -> None:
        await homeward.clock.sleep(2.0)
        assert homeward.phases.pause(True)
        homeward.control_loop.sees = what != "blind"

    homeward.drain = 0.0
    pausing = asyncio.create_task(pause())
    assert await homeward.fly("nothing") is why
    await pausing
    assert not homeward.phases.paused
