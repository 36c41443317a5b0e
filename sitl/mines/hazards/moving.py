"""What was not there before: a person or a machine that crosses and stays, a door that closes."""

from __future__ import annotations

import numpy as np

from sitl.mines.conditions import Conditions, Mover, Trigger
from sitl.mines.hazards.building import HEIGHT_M, START_M, Body, box, main_and_branch, mine, rough
from sitl.mines.model import World
from sitl.mines.plan import Drift, round_drift

WALK_MPS = 1.2
"""A person in a hurry, a loader in a narrow place."""

DOOR_MPS = 1.0

FALL_MPS = 5.0


def person() -> World:
    """Somebody comes out of a niche 3 m before the vehicle, and stays in the middle of the drift."""
    stands = _mover(box((10.8, 2.6, -0.2), (11.3, 3.1, 1.8)), (0.0, -2.4, 0.0), WALK_MPS, Trigger(8.0, 0.0, 1.5))
    niche = round_drift(11.0, 0.0, 11.0, 3.0, width_m=1.6)
    told = "a person who steps into the drift 3 m before the vehicle and stays"
    return mine("person", told, rough([*main_and_branch(), niche]), Conditions(movers=(stands,)))


def machine() -> World:
    """A loader comes out of a side drift and stops across the whole drift, where the vehicle has been."""
    loader = _mover(box((9.8, 3.4, -0.2), (11.9, 8.0, 2.2)), (0.0, -5.3, 0.0), WALK_MPS, Trigger(14.5, 0.0, 1.5))
    side = round_drift(10.8, 0.0, 10.8, 9.0, width_m=3.6)
    told = "a loader that comes out of a side drift behind the vehicle and stands across the drift"
    return mine("machine", told, rough([*main_and_branch(), side]), Conditions(movers=(loader,)))


def door() -> World:
    """A door that closes behind the vehicle; there is no other way home."""
    told = "a door that closes behind the vehicle; no other way leads home"
    return mine("door", told, rough(main_and_branch()), Conditions(movers=(_door(),)))


def door_on_loop() -> World:
    """A door that closes behind the vehicle, and another way round."""
    told = "a door that closes behind the vehicle; the way home leads round"
    return mine("door-on-loop", told, rough([*main_and_branch(), *_round_about()]), Conditions(movers=(_door(),)))


def roof_fall() -> World:
    """A fall of roof where flights begin, while the vehicle is away: it cannot land there any more."""
    above_m = HEIGHT_M + 0.5
    heap = box((START_M[0] - 0.5, -1.0, above_m), (START_M[1] + 0.5, 1.0, above_m + 2.4))
    falls = _mover(heap, (0.0, 0.0, -(above_m + 0.2)), FALL_MPS, Trigger(13.5, 0.0, 2.0))
    told = "a fall of roof where the flight began, while the vehicle is away"
    return mine("roof-fall", told, rough(main_and_branch()), Conditions(movers=(falls,)))


def _round_about() -> list[Drift]:
    return [
        round_drift(2.0, 0.0, 4.0, 10.0, width_m=4.0),
        round_drift(4.0, 10.0, 20.0, 10.0, width_m=4.0),
    ]


def _door() -> Mover:
    above_m = HEIGHT_M + 0.5
    leaf = box((9.0, -2.6, above_m), (9.3, 2.6, above_m + HEIGHT_M + 0.6))
    return _mover(leaf, (0.0, 0.0, -(above_m + 0.3)), DOOR_MPS, Trigger(13.5, 0.0, 2.0))


def _mover(body: Body, way_m: tuple[float, float, float], speed_mps: float, trigger: Trigger) -> Mover:
    return Mover(np.ascontiguousarray(body.vertices_m), np.ascontiguousarray(body.triangles), way_m, speed_mps, trigger)
