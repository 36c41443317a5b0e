"""The link's inbox by itself: whose messages it takes, how many it keeps, and who gets them."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from companion.autopilot.inbox import PENDING, Inbox
from companion.autopilot.interface import Message


def message(name: str = "STATUSTEXT", system_id: int = 1, component_id: int = 1) -> Message:
    return Message(name, {}, 5.0, system_id, component_id)


def test_a_loop_that_does_not_run_costs_old_messages_not_memory() -> None:
    """Protects the bound of the queue: what is dropped is counted, and the newest stay."""
    calls: list[Callable[[], None]] = []
    heard: list[Message] = []
    inbox = Inbox(1, calls.append)
    inbox.events("STATUSTEXT", heard.append)
    messages = [Message("STATUSTEXT", {"n": n}, float(n), 1, 1) for n in range(PENDING + 44)]
    for each in messages:
        inbox.put(each)
    assert len(calls) == 1, "one wake-up of the loop for all of them"
    assert inbox.dropped == 44
    calls.pop()()
    assert heard == messages[44:]


def test_a_handler_that_fails_does_not_deafen_the_others(caplog: pytest.LogCaptureFixture) -> None:
    """Protects the pilot's takeover from a malformed STATUSTEXT."""
    heard: list[Message] = []
    inbox = Inbox(1, lambda call: call())

    def broken(_: Message) -> None:
        raise KeyError("text")

    inbox.events("STATUSTEXT", broken)
    inbox.events("STATUSTEXT", heard.append)
    inbox.put(message())
    inbox.put(message())
    assert len(heard) == 2
    assert "STATUSTEXT" in caplog.text


def test_nobody_elses_messages_reach_a_stream() -> None:
    """Protects the state of our vehicle from a gimbal's heartbeat and another vehicle's."""
    inbox = Inbox(1, lambda call: call())
    stream = inbox.watch("HEARTBEAT")
    assert stream is inbox.watch("HEARTBEAT")
    for system_id, component_id in ((2, 1), (1, 154), (1, 191), (255, 190), (0, 0)):
        inbox.put(message("HEARTBEAT", system_id, component_id))
        assert not inbox.wants("HEARTBEAT", system_id, component_id)
    assert stream.count == 0
    assert stream.age_s(7.0) == math.inf
    inbox.put(message("HEARTBEAT"))
    assert (stream.count, stream.age_s(7.0)) == (1, 2.0)
    assert stream.rate_hz(6.0) == 0.5
    assert stream.rate_hz(7.5) == 0.0
