"""From what the sensors said to what the navigator needs: h, N, d, d_f, the rate of d, and what is free ahead."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from companion.compiled import compiled
from companion.config.sensors import SensorSettings
from companion.config.vehicle import VehicleSettings
from companion.control.boundary import nearest
from companion.control.separation import Back
from companion.model import (
    CLEAR,
    FRONT_RAD,
    HIT,
    UNKNOWN,
    Beam,
    DepthFrame,
    FloatArray,
    Input,
    Measurement,
    Observation,
    Pose,
    Scan,
)
from companion.perception.approach import Approach, nearest_of
from companion.perception.dark import DARK_S, dark_look, is_filled_by_wall
from companion.perception.depth import Slab, look_ahead
from companion.perception.ground_below import GroundBelow, above_ground_m
from companion.perception.look import Look, bin_bearings, planar_look
from companion.perception.rangefinders import Beams, sees_nothing
from companion.perception.scan_memory import ScanMemory
from companion.perception.shafts import Shafts
from companion.perception.view import shows_anything, view_of
from companion.sides import NOTHING_AROUND, Side, Sides

POSE_STALE_S = 0.3
"""A pose older than this is missing: at 0.5 m/s the vehicle is 15 cm from where it says."""

FARTHEST_GROUND_M = 100.0
"""No rangefinder of ours sees the ground from higher."""

AHEAD_MARGIN_M = 0.1
"""Added to the body's radius on either side: less beside the propellers is no room to fly through."""

BODY_MARGIN_M = 0.1
"""Added above and below the body: what is remembered so near to its height is in its way."""

STANDS_S = 1.5
"""So many seconds further on a vehicle stands when it begins to brake now: 0.6 m at 0.4 m/s."""

LOOK_M = 5.0
"""A bearing looks along the way when it is still within the width this far out: the bearings beside leave it sooner."""

BESIDE_COS = math.cos(math.radians(45.0))
"""A quarter of all bearings is a side."""

_SIDEWAYS = {Beam.FRONT: 0.0, Beam.LEFT: math.pi / 2.0, Beam.BACK: -math.pi, Beam.RIGHT: -math.pi / 2.0}


class Extractor:
    """Keeps the newest reading of each sensor and makes a `Measurement` of them, once a tick.

    Args:
        settings: sensors and scan.
        vehicle: the body, which with the slab's margin says what is in the way.
        height_m: H, at which it flies.
    """

    def __init__(self, settings: SensorSettings, vehicle: VehicleSettings, height_m: float) -> None:
        self._settings = settings
        self._half_width_m = vehicle.body_radius_m + AHEAD_MARGIN_M
        self._slab = Slab(vehicle.body_height_m / 2.0 + settings.scan.slab_margin_m, settings.scan.max_ground_slope)
        self._bearings_rad = bin_bearings(settings.scan.bins)
        self._all_round = np.ones(settings.scan.bins, np.bool_)
        self._in_front = np.abs(self._bearings_rad) <= FRONT_RAD
        self._beside = {
            side: np.cos(self._bearings_rad - towards_rad) > BESIDE_COS for side, towards_rad in _SIDEWAYS.items()
        }
        self._memory = ScanMemory(
            settings.scan.memory_age_s, settings.scan.memory_distance_m, vehicle.body_height_m / 2.0 + BODY_MARGIN_M
        )
        self._shafts = Shafts(settings.scan.memory_distance_m)
        self._ground = GroundBelow(height_m - self._slab.half_height_m)
        self._ahead: Look | None = None
        self._ground_slope: float | None = None
        self._shown_s = -math.inf
        self._around: Look | None = None
        self._beams = Beams(settings.beams)
        self._approaches = {side: [Approach(towards_rad) for _ in range(3)] for side, towards_rad in _SIDEWAYS.items()}

    def measure(self, observation: Observation, beneath: tuple[Back, ...] = ()) -> Measurement:
        """The measurement at ``observation.t_s``, from this observation and the memory of the earlier ones.

        Args:
            observation: of now.
            beneath: the other vehicles that it may be above.
        """
        t_s, pose = observation.t_s, observation.pose
        self._beams.on_readings(observation.ranges, pose)
        down_m = above_ground_m(self._beams.height_m(pose, t_s), beneath)
        h_m, over_shaft = self._ground.see(down_m, self._beams.no_ground(t_s), pose, t_s)
        ground_m = self._ground.height_m(t_s)
        if over_shaft:
            self._shafts.mark(pose)
        if observation.frame is not None and observation.frame.pose.is_finite and ground_m is not None:
            h_then_m = observation.frame.pose.z_m - ground_m
            # A jump of the estimate can put the vehicle below the ground: that frame says nothing.
            if 0.0 < h_then_m < FARTHEST_GROUND_M:
                self._look(observation.frame, h_then_m)
        if observation.planar is not None and observation.planar.pose.is_finite:
            self._around = planar_look(observation.planar, self._settings.scan.bins)
            self._remember(self._around, observation.planar.pose.z_m, self._around.state == HIT)
            self._approach(self._around, 1, _SIDEWAYS)
        known = [look for look in (self._ahead, self._around) if look is not None and look.t_s <= t_s]
        looks = [look for look in known if t_s - look.t_s <= self._settings.scan.stale_after_s]
        missing = self._missing(pose, t_s, h_m, looks)
        scan, recent_m = self._scan(looks, pose, t_s) if looks and pose.is_finite else (None, None)
        d_m, d_bearing_rad = (nearest(scan, self._all_round) if scan else None) or (None, None)
        front = nearest(scan, self._in_front) if scan else None
        roof_m, rise_m = self._vertical_m(pose, h_m, t_s)
        return Measurement(
            t_s=t_s,
            scan_age_s=t_s - max((look.t_s for look in known), default=-math.inf),
            scan=scan,
            h_m=h_m,
            roof_m=roof_m,
            rise_m=rise_m,
            ground_slope=self._ground_slope if self._ahead in looks else None,
            d_m=d_m,
            d_bearing_rad=d_bearing_rad,
            d_front_m=None if front is None else front[0],
            d_dot_mps=None if d_bearing_rad is None else -pose.towards_mps(d_bearing_rad),
            ahead_m=ahead_m(scan, self._half_width_m) if scan else math.nan,
            ranges_age_s=self._beams.oldest_age_s(t_s),
            missing=missing,
            sides=self._sides(pose, t_s, recent_m),
            over_shaft=over_shaft,
        )

    def _look(self, frame: DepthFrame, h_m: float) -> None:
        """Take what an image says; that of a wall without echo which fills it is a look that sees nothing new."""
        bins, view = self._settings.scan.bins, view_of(frame)
        if shows_anything(frame):
            self._shown_s = frame.t_s
            self._ahead, self._ground_slope = look_ahead(view, frame, h_m, self._slab, bins)
            self._memory.remember_view(view, frame.pose, self._settings.scan.memory_look_m, frame.t_s)
            # Nearer, the floor before it is below the picture.
            self._remember(self._ahead, frame.pose.z_m, self._ahead.inferred)
            self._approach(self._ahead, 0, (Beam.FRONT,))
        elif frame.t_s - self._shown_s <= DARK_S:
            scan = self._blank()
            self._memory.recall(scan, frame.pose, frame.t_s)
            if is_filled_by_wall(view, scan, h_m):
                self._ahead, self._ground_slope = dark_look(frame, bins), None

    def _blank(self) -> Scan:
        bins = self._bearings_rad.size
        return Scan(self._bearings_rad, np.zeros(bins), np.full(bins, UNKNOWN, np.uint8), np.zeros(bins, np.bool_))

    def _vertical_m(self, pose: Pose, h_m: float | None, t_s: float) -> tuple[float | None, float]:
        """The roof above, and the rise of the ground ahead: a beam looks at one point, the camera saw the rest."""
        beam_m = self._beams.level_m(Beam.UP, pose, t_s)
        ahead_m = pose.towards_mps(0.0) * STANDS_S if pose.is_finite_in_plane else 0.0
        up_m, down_m = self._memory.above_and_below(pose, self._half_width_m, ahead_m, t_s)
        roof_m = min(math.inf if beam_m is None else beam_m, up_m)
        rise_m = 0.0 if h_m is None else max(0.0, h_m - down_m)
        return (roof_m if math.isfinite(roof_m) else None), rise_m

    def _missing(self, pose: Pose, t_s: float, h_m: float | None, looks: Sequence[Look]) -> tuple[Input, ...]:
        lacks = {
            Input.DEPTH: not looks,
            Input.HEIGHT: h_m is None,
            Input.POSE: not 0.0 <= t_s - pose.t_s <= POSE_STALE_S or not pose.is_finite,
        }
        return tuple(which for which, lacking in lacks.items() if lacking)

    def _approach(self, look: Look, sensor: int, sides: Iterable[Beam]) -> None:
        """Note how far a look saw on those sides of the body."""
        for side in sides:
            distance_m = _beside_m(self._bearings_rad, look.ranges_m, look.state, _SIDEWAYS[side], self._half_width_m)
            self._approaches[side][sensor].see(look.t_s, distance_m, (look.x_m, look.y_m), look.yaw_rad)

    def _sides(self, pose: Pose, t_s: float, recent_m: FloatArray | None) -> Sides:
        """What is seen just now, and beside and behind what was seen a moment ago: a beam looks at one point only."""
        if not pose.is_finite:
            return NOTHING_AROUND
        for side, (*_, approach) in self._approaches.items():
            if (known := self._beams.fresh(side, t_s)) is not None:
                reading, read_at = known
                range_m = self._beams.level_m(side, pose, t_s)
                at_m = (read_at.x_m, read_at.y_m)
                approach.see(reading.t_s, math.inf if range_m is None else range_m, at_m, read_at.yaw_rad)
        found = {}
        for side, towards_rad in _SIDEWAYS.items():
            towards_mps = pose.towards_mps(towards_rad)
            found[side] = nearest_of(self._approaches[side], t_s, towards_mps)
            if recent_m is None or side is Beam.FRONT:
                continue
            remembered_m = float(np.min(recent_m[self._beside[side]]))
            if remembered_m < found[side].distance_m:
                closing_mps = max(towards_mps, found[side].closing_mps)
                found[side] = Side(remembered_m, closing_mps)
        return Sides(*found.values())

    def _remember(self, look: Look, z_m: float, which: NDArray[np.bool_]) -> None:
        hits = which & (look.ranges_m <= self._settings.scan.memory_look_m)
        pose = Pose(look.t_s, look.x_m, look.y_m, z_m, look.yaw_rad)
        self._memory.remember(pose, self._bearings_rad[hits], look.ranges_m[hits], look.t_s)

    def _scan(self, looks: Sequence[Look], pose: Pose, t_s: float) -> tuple[Scan, FloatArray]:
        scan = self._blank()
        for look in looks:
            _carry(scan, look, pose.x_m, pose.y_m, pose.yaw_rad)
        for beam, bearing_rad in _SIDEWAYS.items():
            self._add_beam(scan, beam, bearing_rad, pose, t_s)
        recent_m = self._memory.recall(scan, pose, t_s)
        self._shafts.recall(scan, pose)
        return scan, recent_m

    def _add_beam(self, scan: Scan, beam: Beam, bearing_rad: float, pose: Pose, t_s: float) -> None:
        known = self._beams.fresh(beam, t_s)
        if known is None:
            return
        reading, read_at = known
        bins = scan.bearings_rad.size
        b = int((bearing_rad + math.pi) / (2.0 * math.pi) * bins) % bins
        range_m = self._beams.level_m(beam, pose, t_s)
        if range_m is None:
            if sees_nothing(reading) and scan.state[b] == UNKNOWN:
                scan.ranges_m[b], scan.state[b], scan.fresh[b] = reading.max_range_m, CLEAR, True
            return
        self._memory.remember(
            read_at, np.array([bearing_rad]), np.array([range_m]), reading.t_s, self._beams.is_sure(beam)
        )
        if scan.state[b] != HIT or range_m < scan.ranges_m[b]:
            scan.ranges_m[b], scan.state[b], scan.fresh[b] = range_m, HIT, True


@compiled
def _carry(scan: Scan, look: Look, x_m: float, y_m: float, yaw_rad: float) -> None:
    """Merge a look, made a moment ago from elsewhere, into the scan about the present pose."""
    ranges, state, fresh = scan.ranges_m, scan.state, scan.fresh
    moved_x_m, moved_y_m = x_m - look.x_m, y_m - look.y_m
    bins = ranges.size
    width = 2.0 * np.pi / bins
    for b in range(bins):
        bearing = -np.pi + (b + 0.5) * width + yaw_rad - look.yaw_rad
        source = int(np.floor((bearing + np.pi) / width)) % bins
        if not look.covered[source]:
            continue
        fresh[b] = True
        if look.state[source] == HIT:
            direction = look.yaw_rad - np.pi + (source + 0.5) * width
            x = look.ranges_m[source] * np.cos(direction) - moved_x_m
            y = look.ranges_m[source] * np.sin(direction) - moved_y_m
            distance = np.sqrt(x * x + y * y)
            if state[b] != HIT or distance < ranges[b]:
                ranges[b] = distance
                state[b] = HIT
        elif look.state[source] == CLEAR and state[b] == UNKNOWN:
            ranges[b] = look.limit_m
            state[b] = CLEAR


@compiled
def _beside_m(
    bearings: FloatArray, ranges: FloatArray, state: NDArray[np.uint8], towards_rad: float, half_width_m: float
) -> float:
    """Least distance in a direction, within the body's width; infinite where nothing is seen."""
    least = np.inf
    for i in range(bearings.size):
        along = np.cos(bearings[i] - towards_rad)
        if state[i] == HIT and along > 0.0 and abs(ranges[i] * np.sin(bearings[i] - towards_rad)) < half_width_m:
            least = min(least, ranges[i] * along)
    return least


@compiled
def ahead_m(scan: Scan, half_width_m: float) -> float:
    """Least distance to an obstacle ahead, along the heading, from the centre of the body: what the gate is sent.

    Args:
        scan: N(t), remembered points included.
        half_width_m: obstacles further beside the heading than this are not in the way.

    Returns:
        The least x of the HIT bearings in the way, in m; infinite when what is known there is CLEAR; NaN when nothing
        is known there.
    """
    bearings, ranges, state, _ = scan
    least = math.nan
    for i in range(bearings.size):
        if abs(bearings[i]) >= np.pi / 2.0:
            continue
        beside = abs(np.sin(bearings[i]))
        # Written so that no range that is no number gets in.
        if state[i] == HIT and ranges[i] >= 0.0 and ranges[i] * beside < half_width_m:
            x = ranges[i] * np.cos(bearings[i])
            if not x >= least:
                least = x
        elif state[i] == CLEAR and min(ranges[i], LOOK_M) * beside < half_width_m and not least < np.inf:
            least = np.inf
    return least
