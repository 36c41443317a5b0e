"""Everything that is fuzzed. A case is drawn from its seed alone, and fails by raising."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass

from validation.fuzz import datagrams, messages, recordings, streams

Case = Callable[[random.Random], None]


@dataclass(frozen=True)
class Target:
    """One way to feed garbage to the software.

    Attributes:
        case: one case.
        count: how many of them the tests run, with the seeds from 0 on.
    """

    case: Case
    count: int


TARGETS: dict[str, Target] = {
    "harmless-messages": Target(messages.nothing_changes, 10),
    "autopilot-messages": Target(messages.anything_our_autopilot_says, 15),
    "messages-on-the-ground": Target(messages.nothing_begins, 10),
    "datagrams": Target(datagrams.garbage, 2),
    "datagrams-of-the-autopilot": Target(datagrams.own_content, 2),
    "flood": Target(datagrams.flood, 1),
    "stream-bytes": Target(streams.decoding, 200),
    "stream-content": Target(streams.driving, 10),
    "stream-connections": Target(streams.reconnecting, 2),
    "recording-bytes": Target(recordings.bytes_spoiled, 15),
    "recording-packed": Target(recordings.packed_spoiled, 15),
    "recording-content": Target(recordings.content_spoiled, 15),
}


def run(name: str, seed: int) -> None:
    """One case of a target."""
    TARGETS[name].case(random.Random(seed))  # noqa: S311 - reproducible, not secret
