"""Missions that fly in no time, for tests of everything around them. Workers find these functions by their names."""

from __future__ import annotations

import os
import signal
import time
from concurrent.futures import Future
from pathlib import Path
from typing import Self

from companion.config.settings import Settings
from sitl.campaign.mission import Campaign, Mission, Row, Site
from sitl.campaign.workers import Fly

SETTINGS_JSON = Settings().model_dump_json()


def mission(number: int, world: str = "room") -> Mission:
    """A mission whose world is where `bad` and `slow` note that they flew."""
    return Mission(number, world, Site(), number + 1, "flight", "", {}, SETTINGS_JSON, 1, 60.0)


def campaign(count: int, world: str = "room") -> Campaign:
    """That many missions."""
    missions = tuple(mission(number, world) for number in range(count))
    return Campaign(missions, {"worlds": {world: "stamp"}, "seeds": f"1..{count}", "software": "test"}, ())


def once(flown: Mission) -> Row:
    """A mission that is complete; its figures follow from its seed alone."""
    return {
        "world": "room",
        "ended_because": "complete",
        "completed_at_s": 10.0 * flown.seed,
        "sim_time_s": 10.0 * flown.seed,
        "completeness": 0.99,
        "completeness_when_done": 0.985,
        "estimate_error": -0.01,
        "path_length_m": 4.0 * flown.seed,
        "contacts": 0,
        "least_d_m": 0.9,
        "speed_mps": 0.4,
        "critical_margin_m": 0.8,
        "in_d_c_share": 0.0,
        "software": "1.2.3 abc",
    }


def uneven(flown: Mission) -> Row:
    """As `once`, but number 0 ends after another one has, however busy the computer is; its world is for the note."""
    note = Path(flown.world) / "overtaken"
    until_s = time.monotonic() + 60.0
    while flown.number == 0 and not note.exists() and time.monotonic() < until_s:
        time.sleep(0.01)
    if flown.number != 0:
        note.touch()
    return once(flown)


def raises(flown: Mission) -> Row:
    """Mission number 1 raises an error."""
    if flown.number == 1:
        raise ZeroDivisionError("of number 1")
    return once(flown)


def bad(flown: Mission) -> Row:
    """Of these missions number 1 raises an error; the processes of 2 die once, those of 3 always."""
    _note(flown)
    tries = Path(flown.world).read_text(encoding="utf-8").split().count(str(flown.number))
    if flown.number == 3 or (flown.number == 2 and tries == 1):
        os.kill(os.getpid(), signal.SIGKILL)
    return raises(flown)


def slow(flown: Mission) -> Row:
    """A mission of some time, during which something may happen to whoever waits for it."""
    _note(flown, os.getpid())
    time.sleep(0.05 if flown.number < 8 else 600.0)
    return once(flown)


def blocked_signals(_: Mission) -> Row:
    """Signals that do not reach the process which flies."""
    return {"signals": sorted(signal.pthread_sigmask(signal.SIG_BLOCK, ()))}


class Here:
    """Workers without processes: a mission is flown where it is handed over."""

    died: tuple[type[BaseException], ...] = ()

    def __init__(self, count: int) -> None:
        self._count = count

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return

    def room(self) -> int:
        """One."""
        return 1

    def who(self) -> str:
        """One."""
        return "here"

    def check(self) -> None:
        """Nothing."""

    def submit(self, fly: Fly, mission: Mission) -> Future[Row]:
        """Fly it now."""
        future: Future[Row] = Future()
        try:
            future.set_result(fly(mission))
        except Exception as error:  # noqa: BLE001 - as a worker hands it over
            future.set_exception(error)
        return future


def _note(flown: Mission, process: int | None = None) -> None:
    with Path(flown.world).open("a", encoding="utf-8") as file:
        file.write(f"{flown.number}\n" if process is None else f"{flown.number},{process}\n")
