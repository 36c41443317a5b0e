"""The check ``clock``: it looks a second time before it refuses, and names the cause and the remedy."""

from __future__ import annotations

from typing import Any

import pytest

from companion.autopilot.telemetry import Telemetry
from companion.config.settings import Settings
from companion.flight.preflight import CheckResult, run_checks
from companion.flight.preflight.clock_check import SECOND_LOOK_S, check_clock
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock


class Answering:
    """An autopilot that answers TIMESYNC as a test wants, while somebody waits."""

    def __init__(self, round_trip_s: float | None = 0.002, rate: float = 1.0, answers: int = 1000) -> None:
        self.clock = HandClock()
        self.link = FakeLink(self.clock)
        self.telemetry = Telemetry(self.link, self.clock, Settings())
        self.round_trip_s = round_trip_s
        self.rate = rate
        self.answers = answers
        """So many questions are answered."""
        self.link.on_send = self._heard
        self.clock.pass_by = self.pass_s

    def _heard(self, name: str, fields: dict[str, Any]) -> None:
        if name == "TIMESYNC" and self.round_trip_s is not None and self.answers > 0:
            self.answers -= 1
            self.clock.advance(0.5 * self.round_trip_s)
            answer = int(1e9 * self.rate * (self.clock.now_s() - 990.0))
            self.clock.advance(0.5 * self.round_trip_s)
            self.link.deliver("TIMESYNC", {"tc1": answer, "ts1": fields["ts1"]})

    def pass_s(self, by_s: float) -> None:
        until_s = self.clock.now_s() + by_s
        while self.clock.now_s() < until_s:
            self.clock.advance(0.1)
            self.telemetry.ask(self.clock.now_s())

    async def check(self) -> CheckResult:
        return await check_clock(self.telemetry, self.clock)


async def test_a_clock_that_is_known_is_looked_at_once() -> None:
    """Protects the time that a pilot stands and waits."""
    autopilot = Answering()
    autopilot.pass_s(3.0)
    began_s = autopilot.clock.now_s()
    result = await autopilot.check()
    assert result.ok
    assert (result.found.startswith("known to "), "clock" in result.found, result.fix) == (True, False, "")
    assert autopilot.clock.now_s() == began_s


async def test_a_simulation_that_is_slow_passes_and_its_rate_is_told() -> None:
    """Protects flights on PX4's own simulator, which no longer are refused, and the reader who wonders about times."""
    autopilot = Answering(rate=0.982)
    autopilot.pass_s(3.0)
    result = await autopilot.check()
    assert result.ok
    assert result.found.endswith("; the autopilot's clock runs 1.8 % slow")
    autopilot = Answering(rate=1.012)
    autopilot.pass_s(3.0)
    assert (await autopilot.check()).found.endswith("runs 1.2 % fast")


async def test_a_bad_moment_is_looked_at_again() -> None:
    """Protects a start over a link that had a bad moment: better answers come within seconds."""
    autopilot = Answering(round_trip_s=0.2)
    autopilot.pass_s(3.0)
    autopilot.round_trip_s = 0.002
    began_s = autopilot.clock.now_s()
    assert (await autopilot.check()).ok
    assert began_s < autopilot.clock.now_s() < began_s + SECOND_LOOK_S


@pytest.mark.parametrize(
    ("autopilot", "found", "told"),
    [
        pytest.param(Answering(None), "not aligned", "TIMESYNC is not answered", id="no answer"),
        pytest.param(Answering(0.09), "known to ", "round trip takes 90 ms: a faster link", id="slow"),
        pytest.param(Answering(0.056, 0.982), "1.8 % slow", "does not keep real time", id="drifts"),
        pytest.param(Answering(0.058), "known to ", "round trip takes 58 ms: a faster link", id="hardly too slow"),
        pytest.param(Answering(0.002, answers=2), "known to ", "are lost or contradict each other", id="lost"),
    ],
)
async def test_the_cause_is_named(autopilot: Answering, found: str, told: str) -> None:
    """Protects the person who has to find out: a link, a radio, and a simulator are mended in different places."""
    autopilot.pass_s(6.0)
    began_s = autopilot.clock.now_s()
    result = await autopilot.check()
    assert result.failed
    assert found in result.found
    assert told in result.fix
    assert autopilot.clock.now_s() >= began_s + SECOND_LOOK_S


async def test_answers_by_another_clock_are_named() -> None:
    """Protects against two that answer: their clock is not that of the messages."""
    autopilot = Answering()
    for i in range(200):
        autopilot.pass_s(0.1)
        fields = dict.fromkeys(("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"), 0.0)
        held_up_ms = 40 * (i // 20 % 2)  # for two seconds of four
        now_ms = int(1e3 * (autopilot.clock.now_s() - 900.0)) - held_up_ms
        autopilot.link.deliver("ATTITUDE", {"time_boot_ms": now_ms, **fields})
    result = await autopilot.check()
    assert result.failed
    assert "or by another clock than that of the messages" in result.fix


async def test_whoever_skips_it_does_not_wait_for_it() -> None:
    """Protects a start that somebody wants without it."""
    autopilot = Answering(None)
    began_s = autopilot.clock.now_s()
    results = await run_checks(
        autopilot.link, autopilot.telemetry, Settings(), {}, skip=["clock"], clock=autopilot.clock
    )
    assert [result.name for result in results if result.skipped] == ["clock"]
    assert autopilot.clock.now_s() == began_s
