"""What a true way shows of following and stopping. Pure; a way is a list of poses, oldest first."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.model import Pose, wrap_rad

STOPPED_MPS = 0.05
"""Along the way flown. A simulated vehicle that stands is blown about by its own sensors, also across it."""
CREEP_S = 5.0
STEADY_S, AT_ORDER_S = 1.5, 0.3
"""How long before the order a speed counts as steady; and over how long the one at the order is told, since a single
speed is on a grid of 1 cm/s."""


@dataclass(frozen=True, slots=True)
class Cruise:
    """How a velocity was followed.

    Attributes:
        reached_mps: mean horizontal speed in the end.
        largest_mps: on the way there.
        lag_s: by how long it was behind a vehicle that has that speed at once.
        at_order_mps: horizontal speed when the stop was ordered.
    """

    reached_mps: float
    largest_mps: float
    lag_s: float
    at_order_mps: float


@dataclass(frozen=True, slots=True)
class Stop:
    """How it stopped. Both times are None when it never did.

    Attributes:
        stopped_s: from the order until it was slower than `STOPPED_MPS`.
        stopped_m: how far it had gone then.
        creep_m: greatest distance from there in the `CREEP_S` after.
        way_m: greatest distance from where it was at the order, until then: what has to be free.
    """

    stopped_s: float | None
    stopped_m: float | None
    creep_m: float
    way_m: float


@dataclass(frozen=True, slots=True)
class Turn:
    """How a yaw rate was followed, on the spot or in flight.

    Attributes:
        reached_radps: mean rate in the end.
        lag_s: by how long the heading was behind a vehicle that has that rate at once.
        speed_mps: mean horizontal speed in the end.
        slip_rad: by how much the direction of flight was behind the heading in the end; None on the spot.
        overrun_rad: how far it turned on when the rate was 0 again.
    """

    reached_radps: float
    lag_s: float
    speed_mps: float
    slip_rad: float | None
    overrun_rad: float


def cruise(poses: Sequence[Pose], begun_s: float, ordered_s: float) -> Cruise:
    """Of a vehicle that stood, and was asked for one velocity from a moment to the next."""
    flown = _between(poses, begun_s, ordered_s)
    reached_mps = _mean_speed(_between(flown, ordered_s - STEADY_S, ordered_s))
    way_m = _apart_m(flown[0], flown[-1])
    return Cruise(
        reached_mps=reached_mps,
        largest_mps=max(map(_speed, flown)),
        lag_s=flown[-1].t_s - begun_s - way_m / reached_mps,
        at_order_mps=_mean_speed(_between(flown, ordered_s - AT_ORDER_S, ordered_s)),
    )


def stop(poses: Sequence[Pose], ordered_s: float) -> Stop:
    """From the order on, until `CREEP_S` after it stood, or to the end of what is known."""
    after = _between(poses, ordered_s, math.inf)
    first = after[0]
    before = _between(poses, ordered_s - AT_ORDER_S, ordered_s)
    direction_rad = math.atan2(sum(pose.vy_mps for pose in before), sum(pose.vx_mps for pose in before))
    stood = next((pose for pose in after if _along(pose, direction_rad) < STOPPED_MPS), None)
    if stood is None:
        return Stop(None, None, 0.0, max(_apart_m(first, pose) for pose in after))
    watched = [pose for pose in after if pose.t_s <= stood.t_s + CREEP_S]
    return Stop(
        stopped_s=stood.t_s - ordered_s,
        stopped_m=_apart_m(first, stood),
        creep_m=max(_apart_m(stood, pose) for pose in watched if pose.t_s >= stood.t_s),
        way_m=max(_apart_m(first, pose) for pose in watched),
    )


def turn(poses: Sequence[Pose], begun_s: float, ordered_s: float, moving: bool) -> Turn:
    """Of a vehicle that was asked for one yaw rate from a moment to the next, and for none from then on.

    Args:
        poses: the way.
        begun_s: when the rate was asked for.
        ordered_s: when none was.
        moving: whether it was to fly forward too, before and meanwhile.
    """
    turning = _between(poses, begun_s, ordered_s)
    steady = _between(turning, ordered_s - STEADY_S, ordered_s)
    headings = np.unwrap([pose.yaw_rad for pose in turning])
    after = np.unwrap([pose.yaw_rad for pose in _between(poses, ordered_s, math.inf)])
    in_the_end = headings[-len(steady) :]
    reached_radps = float((in_the_end[-1] - in_the_end[0]) / (steady[-1].t_s - steady[0].t_s))
    sense = math.copysign(1.0, reached_radps)
    slips = [wrap_rad(pose.yaw_rad - math.atan2(pose.vy_mps, pose.vx_mps)) for pose in steady]
    return Turn(
        reached_radps=reached_radps,
        lag_s=turning[-1].t_s - begun_s - float(headings[-1] - headings[0]) / reached_radps,
        speed_mps=_mean_speed(steady),
        slip_rad=sense * math.fsum(slips) / len(slips) if moving else None,
        overrun_rad=float(max(sense * (after - after[0]))),
    )


def _between(poses: Sequence[Pose], since_s: float, until_s: float) -> list[Pose]:
    late = itertools.dropwhile(lambda pose: pose.t_s < since_s, poses)
    found = list(itertools.takewhile(lambda pose: pose.t_s <= until_s, late))
    assert found, "nothing is known of the way then"
    return found


def _along(pose: Pose, direction_rad: float) -> float:
    return pose.vx_mps * math.cos(direction_rad) + pose.vy_mps * math.sin(direction_rad)


def _speed(pose: Pose) -> float:
    return math.hypot(pose.vx_mps, pose.vy_mps)


def _mean_speed(poses: Sequence[Pose]) -> float:
    return math.fsum(map(_speed, poses)) / len(poses)


def _apart_m(one: Pose, other: Pose) -> float:
    return math.hypot(other.x_m - one.x_m, other.y_m - one.y_m)
