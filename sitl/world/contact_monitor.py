"""What really happened, for a test that cannot trust what the vehicle says: distances, contacts, the way flown."""

from __future__ import annotations

import csv
import json
import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

import numpy as np

from companion.config.settings import Settings
from companion.errors import InputError
from companion.mapping.files.whole import whole_file
from companion.model import Pose
from sitl.scene.live import LiveWorld
from sitl.world.placement import Scene

log = logging.getLogger(__name__)

PERIOD_S = 0.05
"""The distance to the walls is taken this often: every 2.5 cm of the way at 0.5 m/s."""

FLYING_M = 0.5
"""It flies when its middle is this far above the floor: nearer, the floor would count as a wall."""

LANDING_MPS = 0.3
"""Nearer to the floor than `FLYING_M` and slower than this over ground, it is landing and not flying into a ramp."""

STEP_M = 0.02
"""The way is counted in steps of this length, so that a vehicle at rest does not collect the noise of its truth."""

APART_M = 0.1
"""A body that has come this much clear of the wall and touches it again has touched it twice."""

COLUMNS = ("t_s", "x_m", "y_m", "z_m", "yaw_rad", "vx_mps", "vy_mps", "vz_mps", "d_m", "touching")

MOST_ROWS = 2_000_000
"""More than a day at 20 looks a second; a process that is forgotten must not fill the disk."""


@dataclass(frozen=True, slots=True)
class Look:
    """One look at the vehicle in the mine: ``d_m`` is the least horizontal distance, None while not flying."""

    pose: Pose
    d_m: float | None
    touching: bool


class ContactMonitor:
    """Measures one vehicle in a mine as its true poses come.

    A contact is a surface within the body's radius of its middle, or no floor below it, while it flies: floors count,
    except those that it takes off from and lands on. Simulators know no floor but their own, mostly level one: where
    the mine's floor is higher a landing ends below it, and what happens there is not counted.

    Args:
        scene: the mine and the place on its floor where the vehicle stands.
        settings: the body and the margin d_s.
        live: what there is in the mine besides rock.
    """

    def __init__(self, scene: Scene, settings: Settings, live: LiveWorld) -> None:
        self.contacts = 0
        self.first_contact_s: float | None = None
        self.least_d_m = math.inf
        self.least_clearance_m = math.inf
        self.path_m = 0.0
        self.looks = 0
        self.flying_looks = 0
        self.looks_below_margin = 0
        self.began_s: float | None = None
        self.last_s = 0.0
        self.highest_m = 0.0
        self._caster = scene.caster
        self._live = live
        self._radius_m = settings.vehicle.body_radius_m
        self._half_height_m = settings.vehicle.body_height_m / 2.0
        self._margin_m = settings.control.margin_m
        self._stand = scene.stand
        self._floor_m = scene.stand.z_m - self._half_height_m
        self._next_s = -math.inf
        self._counted_at: Pose | None = None
        self._flying = False
        self._touching = False

    @property
    def time_s(self) -> float:
        """How long truth has been coming."""
        return 0.0 if self.began_s is None else self.last_s - self.began_s

    def restart(self) -> None:
        """The simulator was started anew: the vehicle stands at the start, and did not fly there."""
        self._counted_at = None
        self._flying = self._touching = False
        self._floor_m = self._stand.z_m - self._half_height_m

    def look(self, pose: Pose) -> Look | None:
        """Takes note of a true pose; the look, or None between two of them."""
        if self.began_s is None:
            self.began_s = pose.t_s
        self.last_s = pose.t_s
        self._count_way(pose)
        # A fifth of a period early still counts: truth comes with jitter.
        if pose.t_s < self._next_s - 0.2 * PERIOD_S:
            return None
        self._next_s = max(self._next_s + PERIOD_S, pose.t_s + 0.5 * PERIOD_S)
        self.looks += 1
        self.highest_m = max(self.highest_m, pose.z_m - self._stand.z_m)
        place = np.array([[pose.x_m, pose.y_m, pose.z_m]])
        self._follow_flight(pose, place)
        if not self._flying:
            return Look(pose, None, False)
        d_m = float(self._live.horizontal_clearance(np.array([pose.t_s]), place, self._half_height_m)[0])
        self.flying_looks += 1
        self.looks_below_margin += d_m < self._margin_m
        self.least_d_m = min(self.least_d_m, d_m)
        self._touch(pose, place)
        return Look(pose, d_m, self._touching)

    def _follow_flight(self, pose: Pose, place: np.ndarray) -> None:
        """Flying begins above the floor that it stands on, and ends slowly near a floor."""
        if not self._flying:
            self._flying = pose.z_m - self._floor_m >= FLYING_M
            return
        below_m = float(self._caster.cast(place, np.array([[0.0, 0.0, -1.0]]))[0])
        if below_m < FLYING_M and math.hypot(pose.vx_mps, pose.vy_mps) < LANDING_MPS:
            self._flying = self._touching = False
            self._floor_m = pose.z_m - below_m

    def _touch(self, pose: Pose, place: np.ndarray) -> None:
        down_m = float(self._caster.cast(place, np.array([[0.0, 0.0, -1.0]]))[0])
        clear_m = float(self._live.distance(np.array([pose.t_s]), place)[0]) - self._radius_m
        self.least_clearance_m = min(self.least_clearance_m, clear_m)
        outside = not math.isfinite(down_m)
        if self._touching:
            self._touching = outside or clear_m <= APART_M
        elif outside or clear_m <= 0.0:
            self._touching = True
            self.contacts += 1
            if self.first_contact_s is None:
                self.first_contact_s = pose.t_s - (self.began_s or 0.0)
                log.warning(
                    "contact at (%.2f, %.2f, %.2f) after %.1f s: %s; further ones are only counted",
                    *(pose.x_m, pose.y_m, pose.z_m, self.first_contact_s),
                    "outside the mine" if outside else f"a surface {clear_m + self._radius_m:.2f} m from the middle",
                )

    def _count_way(self, pose: Pose) -> None:
        last = self._counted_at
        if last is None:
            self._counted_at = pose
            return
        step_m = math.dist((last.x_m, last.y_m, last.z_m), (pose.x_m, pose.y_m, pose.z_m))
        if step_m >= STEP_M:
            self.path_m += step_m
            self._counted_at = pose

    def figures(self) -> dict[str, object]:
        """What `companion sim` calls these figures in its summary, as far as it has them."""
        share = self.looks_below_margin / self.flying_looks if self.flying_looks else None
        return {
            "sim_time_s": round(self.time_s, 3),
            "flying_time_s": round(self.flying_looks * PERIOD_S, 2),
            "path_length_m": round(self.path_m, 2),
            "highest_above_start_m": round(self.highest_m, 2),
            "contacts": self.contacts,
            "first_contact_s": None if self.first_contact_s is None else round(self.first_contact_s, 2),
            "least_d_m": round(self.least_d_m, 3) if math.isfinite(self.least_d_m) else None,
            "least_clearance_m": round(self.least_clearance_m, 3) if math.isfinite(self.least_clearance_m) else None,
            "time_below_d_s_fraction": None if share is None else round(share, 5),
        }


def write_score(path: Path, score: dict[str, object]) -> None:
    """Writes the score as JSON; a reader sees the old one or the new one, never half of it.

    Raises:
        InputError: it cannot be written.
    """
    try:
        with whole_file(path) as file:
            file.write((json.dumps(score, indent=2, allow_nan=False) + "\n").encode())
    except OSError as error:
        raise InputError(f"--score {path}: {error.strerror or error}") from error


class Trajectory:
    """The true trajectory as CSV, a row for each look.

    Args:
        path: of the file, or None for none.

    Raises:
        InputError: it cannot be written.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._rows = 0
        self._file: IO[str] | None = None
        self._writer: Any = None

    def __enter__(self) -> Self:
        if self._path is not None:
            try:
                self._file = self._path.open("w", newline="", encoding="ascii")
            except OSError as error:
                raise InputError(f"--trajectory {self._path}: {error.strerror or error}") from error
            self._writer = csv.writer(self._file)
            self._writer.writerow(COLUMNS)
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()
            self._file = self._writer = None

    def add(self, look: Look) -> None:
        """Adds a row: times as `time.monotonic`, places in the mine, d empty while not flying."""
        if self._writer is None or self._rows >= MOST_ROWS:
            return
        self._rows += 1
        pose = look.pose
        numbers = (pose.x_m, pose.y_m, pose.z_m, pose.yaw_rad, pose.vx_mps, pose.vy_mps, pose.vz_mps)
        d_m = "" if look.d_m is None else f"{look.d_m:.3f}"
        self._writer.writerow([f"{pose.t_s:.4f}", *(f"{x:.4f}" for x in numbers), d_m, int(look.touching)])

    def flush(self) -> None:
        """Hands everything to the operating system, for whoever reads along."""
        if self._file is not None:
            self._file.flush()
