"""The small parts of the map's process, and how the process is started."""

from __future__ import annotations

import time
from multiprocessing import get_context
from multiprocessing.connection import Connection

import numpy as np
import pytest

from companion.mapping.process import supervisor
from companion.mapping.process.client import Tally
from companion.mapping.process.messages import SLOTS, FromMap, OfferedFrame, Preparing, Ready, SlotRing, ToMap
from companion.mapping.process.server import Waiting
from companion.mapping.process.supervisor import MapSupervisor
from tests.mapping.voxels import scenes


def offered(source: int, t_s: float) -> OfferedFrame:
    return OfferedFrame(source, 0, t_s, scenes.pose(), scenes.camera(40, 30))


def test_the_newest_of_each_sensor_comes_first_and_the_sensors_in_turn() -> None:
    """Protects a slow camera from a fast one: whatever the fast one piles up, both are looked at in turn."""
    waiting = Waiting(3)
    for t_s in range(5):
        waiting.add(offered(0, float(t_s)))
    waiting.add(offered(2, 0.5))
    waiting.add(offered(2, 1.5))
    order = [(next_.source, next_.t_s) for next_ in (waiting.pop() for _ in range(len(waiting)))]
    assert order == [(0, 4.0), (2, 1.5), (0, 3.0), (2, 0.5), (0, 2.0), (0, 1.0), (0, 0.0)]
    with pytest.raises(IndexError):
        waiting.pop()


def test_a_sensor_that_was_just_served_comes_last() -> None:
    """Protects the order when new images keep coming: one that is never empty is not served twice."""
    waiting = Waiting(2)
    served = []
    for n in range(6):
        waiting.add(offered(0, float(n)))
        if n % 2 == 0:
            waiting.add(offered(1, float(n)))
        served.append(waiting.pop().source)
    assert served == [0, 1, 0, 1, 0, 1]


def test_a_ring_gives_each_slot_once() -> None:
    """Protects an image from being written over while it is read, and the ring from a slot that comes back twice."""
    ring = SlotRing(get_context("spawn"), (4, 5), np.float32)
    slots = [ring.take() for _ in range(SLOTS)]
    assert sorted(slot for slot in slots if slot is not None) == list(range(SLOTS))
    assert ring.take() is None
    assert ring.in_use == SLOTS
    ring.array(1)[...] = 7.0
    assert np.all(ring.array(1) == 7.0)
    assert not np.any(ring.array(0))
    ring.give_back(1)
    ring.give_back(1)
    assert ring.in_use == SLOTS - 1
    assert ring.take() == 1
    ring.give_back_all()
    assert ring.in_use == 0


def test_every_offer_is_counted_once() -> None:
    """Protects the numbers that say what was lost: in the map, lost and dropped add up over all processes."""
    tally = Tally()
    for _ in range(10):
        tally.used("frames")
    tally.used("scans")
    tally.kept(frames=7, scans=1)
    tally.used("frames")
    assert tally.in_map("frames") == 11
    assert tally.died(waiting=2) == 4
    assert (tally.in_map("frames"), tally.in_map("scans"), tally.lost, tally.dropped) == (7, 1, 4, 2)
    # The next one counts from zero, and what it says of itself must not reach what is safe.
    tally.used("frames")
    tally.kept(frames=0, scans=0)
    assert tally.died(waiting=0) == 1
    assert (tally.in_map("frames"), tally.lost) == (7, 5)


# How the process of the map is started.


STAGE_S, STAGES = 1.5, 4


def slow_to_start(pipe: Connection[FromMap, ToMap]) -> None:
    """Be a map on a small computer."""
    for number in range(STAGES):
        pipe.send(Preparing(f"compiling part {number}"))
        time.sleep(STAGE_S)
    pipe.send(Ready())
    pipe.recv()


async def test_a_process_that_says_what_it_is_at_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A small computer compiles for many minutes: only silence is given up."""
    heard: list[FromMap] = []

    def hear(message: FromMap) -> None:
        # From its first word on: until then a busy computer may take as long for the start of any process.
        monkeypatch.setattr(supervisor, "SILENT_TIMEOUT_S", 0.8 * STAGES * STAGE_S)
        heard.append(message)

    async def start() -> bool:
        process = MapSupervisor(get_context("spawn"), slow_to_start, (), hear, lambda: 0)
        await process.begin()
        try:
            return process.is_ready
        finally:
            await process.close()

    assert await start()
    assert [type(message) for message in heard] == [Preparing] * STAGES + [Ready]
