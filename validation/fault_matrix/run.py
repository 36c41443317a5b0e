"""Fly one cell of the matrix."""

from __future__ import annotations

import dataclasses
import os
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

from companion.config.settings import Settings
from companion.gate.runtime import processes
from sitl.launch.program import CrewError
from validation.fault_matrix.faults import BY_NAME
from validation.fault_matrix.injection import Injection
from validation.fault_matrix.outcome import Outcome, judged
from validation.fault_matrix.scene import Flight, SceneError, approach, flying
from validation.fault_matrix.stand import Stand, StubStand

ATTEMPTS = 3
"""A flight that shows nothing, on a computer that is busy with others, is flown once more."""


class StoodStillError(SceneError):
    """The computer did not run the gate, the autopilot or the wires: what followed says nothing of the gate."""


def end_with_parent() -> None:
    """However this process ends, or the one that started it: the processes of a flight end with it."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    processes.end_with_parent(signal.SIGTERM)


def fly_in_pool(name: str, personality: str, parent: Path | None) -> Outcome:
    """`fly`, in a process that `end_with_parent` prepared."""
    try:
        return fly(name, personality, parent)
    except SystemExit:
        # A pool takes the end of a process for the result of a call, and would wait for the next.
        os._exit(1)


def fly(name: str, personality: str, parent: Path | None = None) -> Outcome:
    """One fault of the matrix on the stub with one personality; otherwise as `fly_on`."""
    return fly_on(StubStand(personality), BY_NAME[name], parent)


def fly_on(stand: Stand, injection: Injection, parent: Path | None = None, attempts: int = ATTEMPTS) -> Outcome:
    """One fault on one autopilot.

    Args:
        stand: the autopilot.
        injection: the fault.
        parent: where the flight's folder goes, and stays; None: it is deleted.
        attempts: flights until one shows something.

    Raises:
        CompanionError: it never came as far as the fault, or the computer stood still each time.
    """
    for attempt in range(1, attempts + 1):
        prefix = f"{injection.name.replace(' ', '-')}-{stand.personality}-"
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        try:
            return dataclasses.replace(_fly(injection, stand, folder), attempts=attempt)
        except (SceneError, CrewError):
            if attempt == attempts:
                raise
        finally:
            if parent is None:
                shutil.rmtree(folder, ignore_errors=True)
    raise AssertionError("there is always a last attempt")


def _fly(injection: Injection, stand: Stand, folder: Path) -> Outcome:
    with flying(folder, stand, injection) as flight:
        approach(flight, injection.trigger_m)
        if injection.careless:
            flight.tell_flyer("careless")
        told, fault_s = len(flight.witness.texts), time.monotonic()
        injection.inject(flight)
        time.sleep(max(0.0, fault_s + injection.watch_s - time.monotonic()))
        end_s = time.monotonic()
        verified = None if injection.verify is None else injection.verify(flight)
        if injection.undo is not None:
            injection.undo(flight)
    stood_s = stood_still(flight, fault_s, end_s)
    return dataclasses.replace(judged(flight, injection, fault_s, end_s, verified, told), stood_still_s=stood_s)


def patience_s(settings: Settings) -> float:
    """A wait that the gate cannot make good: a zero was just due, and one more may be, before the autopilot acts."""
    return settings.autopilot.silence_s - 2.0 * settings.control.period_s


def stood_still(flight: Flight, since_s: float, until_s: float) -> float:
    """How long anybody had to wait for a processor between two moments of `time.monotonic`, in s.

    Raises:
        StoodStillError: for longer than the autopilot waits for setpoints.
    """
    longest = flight.standstill.longest(since_s, until_s)
    limit_s = patience_s(flight.settings)
    if longest.lasted_s > limit_s:
        raise StoodStillError(f"the computer stood still for longer than {limit_s:g} s: {longest}")
    return longest.lasted_s
