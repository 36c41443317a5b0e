"""What pilots and ground stations see of us: true, readable, and never a flood."""

from __future__ import annotations

import asyncio
import math

import pytest

from companion.autopilot.status_reporter import StatusReporter
from companion.mavlink.ids import MavSeverity, MavState
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def link(clock: HandClock) -> FakeLink:
    return FakeLink(clock)


def run(reporter: StatusReporter, clock: HandClock, time_s: float) -> None:
    for _ in range(round(time_s / 0.1)):
        reporter.tick()
        clock.advance(0.1)


def test_the_heartbeat_comes_once_a_second_and_says_the_truth(clock: HandClock, link: FakeLink) -> None:
    reporter = StatusReporter(link, clock)
    run(reporter, clock, 2.0)
    reporter.state(MavState.CRITICAL, armed=True)
    run(reporter, clock, 2.0)
    beats = link.sent_named("HEARTBEAT")
    assert 4 <= len(beats) <= 5
    assert (beats[0]["type"], beats[0]["autopilot"], beats[0]["custom_mode"]) == (18, 8, 0)
    assert (beats[0]["system_status"], beats[0]["base_mode"]) == (3, 0)
    assert (beats[-1]["system_status"], beats[-1]["base_mode"]) == (5, 128)


async def test_it_runs_until_cancelled(clock: HandClock, link: FakeLink) -> None:
    task = asyncio.create_task(StatusReporter(link, clock).run())
    await clock.sleep(5.0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert 5 <= len(link.sent_named("HEARTBEAT")) <= 6


def test_at_most_one_text_a_second_and_none_twice_in_a_row(clock: HandClock, link: FakeLink) -> None:
    reporter = StatusReporter(link, clock)
    for _ in range(30):
        reporter.say("stops: depth is stale", MavSeverity.WARNING)
        run(reporter, clock, 0.1)
    assert [text["text"] for text in link.sent_named("STATUSTEXT")] == ["stops: depth is stale"]
    for i in range(5):
        reporter.say(f"text {i}")
    run(reporter, clock, 3.0)
    assert 3 <= len(link.sent_named("STATUSTEXT")) - 1 <= 4


def test_the_queue_is_bounded_and_keeps_what_matters(clock: HandClock, link: FakeLink) -> None:
    """A burst of chatter must not keep the one warning from the pilot, nor be told minutes later."""
    reporter = StatusReporter(link, clock)
    reporter.say("battery low", MavSeverity.CRITICAL)
    for i in range(100):
        reporter.say(f"chatter {i}")
    run(reporter, clock, 30.0)
    texts = [text["text"] for text in link.sent_named("STATUSTEXT")]
    assert len(texts) == 8
    assert texts[0] == "battery low"
    assert texts[-1] == "chatter 99"
    assert reporter.dropped == 93


def test_texts_fit_the_message(clock: HandClock, link: FakeLink) -> None:
    """50 bytes of ASCII on one line; anything else is cut or replaced, not refused."""
    reporter = StatusReporter(link, clock)
    reporter.say("höhe\n" + "x" * 80)
    reporter.say("   ")
    run(reporter, clock, 3.0)
    (text,) = link.sent_named("STATUSTEXT")
    assert len(text["text"]) == 50
    assert text["text"].startswith("h?he xxx")


def test_values_come_twice_a_second_and_never_as_nan(clock: HandClock, link: FakeLink) -> None:
    reporter = StatusReporter(link, clock)
    reporter.value("d", 1.25)
    reporter.value("h", math.nan)
    reporter.value("complete", 0.5)
    run(reporter, clock, 2.0)
    reporter.value("d", None)
    sent = link.sent_named("NAMED_VALUE_FLOAT")
    assert {fields["name"] for fields in sent} == {"d", "complete"}
    assert 4 <= sum(fields["name"] == "d" for fields in sent) <= 5
    run(reporter, clock, 2.0)
    assert all(fields["name"] == "complete" for fields in link.sent_named("NAMED_VALUE_FLOAT")[len(sent) :])


@pytest.mark.parametrize("name", ["", "completeness", "höhe"])
def test_names_that_do_not_fit_are_refused(clock: HandClock, link: FakeLink, name: str) -> None:
    with pytest.raises(ValueError, match="ASCII"):
        StatusReporter(link, clock).value(name, 1.0)


def test_a_dead_link_does_not_stop_the_announcing(clock: HandClock, link: FakeLink) -> None:
    reporter = StatusReporter(link, clock)
    link.gone = True
    run(reporter, clock, 3.0)
    link.gone = False
    run(reporter, clock, 2.0)
    assert link.sent_named("HEARTBEAT")
