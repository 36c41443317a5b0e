"""Flies missions of a campaign, or does something else for each, and keeps the row of each as soon as it has ended."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from traceback import format_exception

from sitl.campaign.mission import Mission, Row, failure
from sitl.campaign.workers import Fly, Workers

TRIES = 2
"""A mission whose worker dies is flown once more; if that dies too, the mission is what kills it."""

LOOK_S = 0.5
"""How long it waits for a mission to end before it looks whether workers came or went."""


def run(
    missions: Iterable[Mission],
    workers: Workers,
    fly: Fly,
    keep: Callable[[Row], object],
    look: Callable[[], object] = lambda: None,
) -> None:
    """Fly missions, in any order.

    Args:
        missions: what is to be flown.
        workers: who flies them.
        fly: flies one, in a worker.
        keep: is given the row of every mission as soon as it has ended.
        look: called a few times a second.

    Raises:
        CompanionError: no mission can be flown any more.
    """
    waiting = deque(missions)
    under_way: dict[Future[Row], Mission] = {}
    deaths: Counter[int] = Counter()
    while waiting or under_way:
        workers.check()
        while waiting and len(under_way) < workers.room():
            mission = waiting.popleft()
            under_way[workers.submit(fly, mission)] = mission
        ended, _ = wait(under_way, timeout=LOOK_S, return_when=FIRST_COMPLETED)
        for future in ended:
            mission = under_way.pop(future)
            try:
                figures = future.result()
            except workers.died as error:
                deaths[mission.number] += 1
                if deaths[mission.number] < TRIES:
                    waiting.appendleft(mission)
                    continue
                figures = failure(f"its process died, {TRIES} times; it may have had too little memory", str(error))
            except CancelledError:
                # A scheduler that went away takes its futures along; `check` says so if it stays away.
                waiting.appendleft(mission)
                continue
            except Exception as error:  # noqa: BLE001 - of the worker: a package that it lacks, a disk that is full
                figures = failure(f"{type(error).__name__}: {error}", "".join(format_exception(error)))
            keep({**mission.given(), **figures, "settings": mission.settings_json})
        look()
