"""What happened in a simulated flight, tick by tick, as columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.mapping.files.whole import whole_file
from companion.model import Measurement, Mode, Pose, Setpoint

COLUMNS = (
    *("t_s", "x_m", "y_m", "z_m", "yaw_rad"),
    *("estimated_x_m", "estimated_y_m", "estimated_z_m", "estimated_yaw_rad"),
    *("d_m", "d_front_m", "true_d_m", "h_m"),
    *("speed_mps", "setpoint_speed_mps", "setpoint_climb_mps", "setpoint_yaw_rate_radps"),
)
MODES = tuple(Mode)

CSV_HEADER = ",".join(("t_s", "mode", *COLUMNS[1:])) + "\r\n"
_ROW = ",".join(("%.4f", "%s", *["%.4f"] * (len(COLUMNS) - 1))) + "\r\n"
_BLOCK = 4096


class FlightLog:
    """Rows of `COLUMNS` and the mode of each; NaN where a value was not known.

    ``true_d_m`` is filled in when the flight has ended, from the true mesh: the vehicle does not know it.
    """

    def __init__(self, vehicle_id: int = 1) -> None:
        self.vehicle_id = vehicle_id
        self._rows = np.full((4096, len(COLUMNS)), np.nan)
        self._modes = np.zeros(4096, np.uint8)
        self._size = 0

    def __len__(self) -> int:
        return self._size

    def append(
        self, true: Pose, estimated: Pose, measurement: Measurement, mode: Mode, setpoint: Setpoint, speed_mps: float
    ) -> None:
        """Add one tick."""
        if self._size == len(self._rows):
            self._rows = np.concatenate([self._rows, np.full_like(self._rows, np.nan)])
            self._modes = np.concatenate([self._modes, np.zeros_like(self._modes)])
        distances_m = (measurement.d_m, measurement.d_front_m, None, measurement.h_m)
        self._rows[self._size] = (
            *(true.t_s, true.x_m, true.y_m, true.z_m, true.yaw_rad),
            *(estimated.x_m, estimated.y_m, estimated.z_m, estimated.yaw_rad),
            *(float("nan") if one_m is None else one_m for one_m in distances_m),
            *(speed_mps, setpoint.speed_mps, setpoint.climb_mps, setpoint.yaw_rate_radps),
        )
        self._modes[self._size] = MODES.index(mode)
        self._size += 1

    def column(self, name: str) -> NDArray[np.float64]:
        """The (ticks,) values of one of `COLUMNS`: a view, valid until the next `append`."""
        return self._rows[: self._size, COLUMNS.index(name)]

    @property
    def modes(self) -> NDArray[np.uint8]:
        """The (ticks,) indices into `MODES`."""
        return self._modes[: self._size]

    @property
    def positions_m(self) -> NDArray[np.float64]:
        """The (ticks, 3) true positions."""
        return self._rows[: self._size, 1:4]

    def write_csv(self, path: Path) -> None:
        """Write every tick, in place of what is there only when all is written; an unknown value is an empty cell.

        Raises:
            OSError: it cannot be written; what was there before still is.
        """
        with whole_file(path) as file:
            file.write(CSV_HEADER.encode())
            for first in range(0, self._size, _BLOCK):
                file.write(self.csv_rows(first, first + _BLOCK).encode())

    def csv_rows(self, first: int = 0, end: int | None = None) -> str:
        """The lines of the ticks from ``first`` on, up to ``end``."""
        some = slice(first, self._size if end is None else min(end, self._size))
        modes = [str(MODES[mode]) for mode in self._modes[some].tolist()]
        lines = (
            _ROW % (values[0], mode, *values[1:]) for values, mode in zip(self._rows[some].tolist(), modes, strict=True)
        )
        return "".join(lines).replace(",nan", ",")
