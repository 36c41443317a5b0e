"""Where a simulated vehicle truly is, as its simulator tells: heard beside the world, which may be what fails."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from companion.config.settings import Settings
from companion.model import Pose
from sitl.autopilot.mavlink import Message
from sitl.world.placement import Placer
from sitl.world.truth_messages import TruthKind, TruthReader
from validation.fault_matrix.corridor import HEIGHT_M, LENGTH_M, START_X_M, WIDTH_M

STANDING_MPS, STANDING_FOR_S = 0.12, 0.5
"""A simulated vehicle that holds its place drifts, and creeps at 0.05 m/s where there is room left."""
FLYING_M = 0.5
"""Above its start; below, nothing is near it but the floor."""
ROOF_M = HEIGHT_M - Settings().vehicle.body_height_m / 2.0
"""Above its middle when it stands at the start."""
REMEMBERED = 20_000


@dataclass(frozen=True, slots=True)
class Truth:
    """One look at the vehicle where it truly was.

    Attributes:
        t_s: on the clock of `time.monotonic`.
        x_m: along the corridor.
        y_m: across it.
        height_m: above its start.
        speed_mps: horizontal.
        d_m: from its middle to the nearest wall of the corridor; None while it does not fly.
        roof_m: from its middle to the roof.
    """

    t_s: float
    x_m: float
    y_m: float
    height_m: float
    speed_mps: float
    d_m: float | None
    roof_m: float = math.inf


class TrueWay:
    """Gathers. One thread hears, others read."""

    def __init__(self) -> None:
        self._poses: deque[Pose] = deque(maxlen=REMEMBERED)
        self._reader = TruthReader(TruthKind.AUTO)
        self._placer = Placer(Pose(0.0, START_X_M, 0.0, 0.0, 0.0))

    def hear(self, message: Message, now_s: float) -> None:
        """One message of the autopilot."""
        ned = self._reader.on_message(message, now_s)
        if ned is None:
            return
        self._poses.append(self._placer.place(ned))

    def poses(self, since_s: float = -math.inf, until_s: float = math.inf) -> list[Pose]:
        """Between two moments, oldest first."""
        return [pose for pose in tuple(self._poses) if since_s <= pose.t_s <= until_s]

    def looks(self, since_s: float = -math.inf, until_s: float = math.inf) -> list[Truth]:
        """The same as looks at the corridor."""
        return list(map(_look, self.poses(since_s, until_s)))

    def now(self) -> Truth:
        """The last look, where one must have come."""
        newest = self.newest()
        assert newest is not None, "the simulator told no truth"
        return newest

    def newest(self) -> Truth | None:
        """The last look; None: nothing has come."""
        return _look(self._poses[-1]) if self._poses else None


def _look(pose: Pose) -> Truth:
    speed_mps = math.hypot(pose.vx_mps, pose.vy_mps)
    d_m = min(LENGTH_M / 2.0 - abs(pose.x_m), WIDTH_M / 2.0 - abs(pose.y_m))
    flies = pose.z_m >= FLYING_M
    return Truth(pose.t_s, pose.x_m, pose.y_m, pose.z_m, speed_mps, d_m if flies else None, ROOF_M - pose.z_m)


def contacts(looks: Iterable[Truth], radius_m: float) -> int:
    """How often a body of this radius came to touch a wall or the roof while it flew."""
    count, touched = 0, False
    for look in looks:
        touches = look.d_m is not None and min(look.d_m, look.roof_m) <= radius_m
        count += touches and not touched
        touched = touches
    return count


def standing_s(looks: Iterable[Truth], since_s: float) -> float | None:
    """From a moment until the first from which on it stood for `STANDING_FOR_S`; None: it never did."""
    moving_s = since_s
    for look in looks:
        if look.speed_mps > STANDING_MPS:
            moving_s = look.t_s
        elif look.t_s - moving_s >= STANDING_FOR_S:
            return moving_s - since_s
    return None
