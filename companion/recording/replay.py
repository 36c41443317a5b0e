"""Flies a recording again: the same observations through the same extractor and navigator, and compares setpoints.

The same code on the same kind of machine gives the same setpoints to the last bit. A difference shows what a change of
the code, of the settings or of a library would have done in that flight, up to the first moment at which it matters:
from there on the real vehicle would have been elsewhere.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.config.settings import Settings
from companion.control.graph import Graph
from companion.errors import InputError
from companion.mapping.files.ground_file import GROUND_NAME, ground_of_content
from companion.pipeline import Explorer, Order
from companion.recording import Recording, open_recording
from companion.recording.channels import COMMANDED
from companion.recording.flown import flown_settings


@dataclass(frozen=True, slots=True)
class Replay:
    """What came of flying a recording again.

    Attributes:
        ticks: sampling periods that were flown again.
        compared: those in which the navigator was asked and its setpoint was used.
        differing: those of them whose setpoint or mode is not exactly the recorded one.
        first_difference_s: time of the first of these, on the clock of the flight.
        largest_difference: of speed and climb in m/s and yaw rate in rad/s, the largest.
        stopped: why it ended before the recording did; ``None`` when it did not.
        graph: the navigation graph of what was flown again.
    """

    ticks: int
    compared: int
    differing: int
    first_difference_s: float | None
    largest_difference: float
    stopped: str | None
    graph: Graph


def replay(path: Path, settings: Settings | None = None) -> Replay:
    """Fly a recording again and compare.

    Args:
        path: the recording, which may be cut.
        settings: others than it was flown with, to see what they would change.

    Raises:
        InputError: the file is no recording, or was flown with settings that this version refuses, or went on from
            ground that the other settings have no use for.
    """
    recording = open_recording(path)
    explorer = Explorer(settings or flown_settings(recording), _generator(recording))
    _go_on_from_earlier(explorer, recording)
    ticks = compared = differing = 0
    first_s: float | None = None
    largest = 0.0
    stopped: str | None = None
    for tick, observation in recording.observations():
        if observation is None:
            stopped = f"the depth image of t = {tick['t_s']} s is not in the recording"
            break
        try:
            if tick["number"] != ticks:
                stopped = f"the ticks before t = {tick['t_s']} s are not all in the recording"
                break
            then = _then(tick)
        except (KeyError, TypeError, ValueError) as error:
            stopped = f"a tick is damaged: {error}"
            break
        ticks += 1
        if then is None:
            explorer.look(observation)
            continue
        explorer.navigator.height_m = then.height_m
        now = explorer.step(observation, then.order).setpoint
        if then.setpoint is None:
            continue
        off = np.abs(np.subtract([getattr(now, name) for name in COMMANDED], then.setpoint))
        compared += 1
        if np.any(off != 0.0) or explorer.navigator.status.mode != then.mode:
            differing += 1
            first_s = observation.t_s if first_s is None else first_s
            largest = max(largest, float(np.max(off)))
    graph = explorer.navigator.graph.finish()
    return Replay(ticks, compared, differing, first_s, largest, stopped or recording.damage, graph)


@dataclass(frozen=True, slots=True)
class _Then:
    """What the navigator said then."""

    setpoint: tuple[float, ...] | None
    mode: str
    height_m: float
    order: Order


def _then(tick: dict[str, Any]) -> _Then | None:
    """The recorded decision; ``None`` when the navigator was not asked."""
    if not tick["stepped"]:
        return None
    # What was recorded before setpoints had a part to the left asked for none, and nothing came home or waited.
    told = {"lateral_mps": 0.0, "order": Order.EXPLORE, **tick}
    wanted = [told[name] for name in COMMANDED]
    setpoint = None if wanted[0] is None else tuple(map(float, wanted))
    return _Then(setpoint, str(tick["mode"]), float(tick["wanted_height_m"]), Order(told["order"]))


def _go_on_from_earlier(explorer: Explorer, recording: Recording) -> None:
    """Know what the flight knew of the ground before it began."""
    content = recording.info.known_ground
    if not content:
        return
    earlier = ground_of_content(content, f"{recording.path}: {GROUND_NAME}")
    try:
        explorer.navigator.known_ground.go_on_from(earlier)
    except ValueError as error:
        raise InputError(
            f"{recording.path}: it went on from the known ground of earlier flights: {error}; give settings with the "
            "same control.critical_margin_m"
        ) from None


def _generator(recording: Recording) -> np.random.Generator:
    """The navigator's generator as it was before the first draw."""
    bits = np.random.PCG64()
    try:
        bits.state = json.loads(recording.info.rng_state)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        raise InputError(f"{recording.path}: the state of its random generator is damaged; no replay") from None
    return np.random.Generator(bits)
