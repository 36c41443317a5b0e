"""The application of the matrix: the real one, with a navigator that only flies straight ahead.

    python -m validation.fault_matrix.flyer --request-fd N --control PORT [--wait]

The request is for `companion.flight`. At the port it listens for the faults of `flyer_faults`; with
`--wait` it loads everything and then waits there for the command to go.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence

import numpy as np
import typer

from companion import pipeline
from companion.control import laws
from companion.control.governor import braking_speed_mps
from companion.control.known_ground import Outlook
from companion.control.navigator import Navigator, Status
from companion.control.parameters import Parameters
from companion.flight import __main__ as application
from companion.flight.request import FlightRequest
from companion.flight.warm_up import warm_up
from companion.model import Measurement, Mode, Pose, Setpoint, wrap_rad
from validation.fault_matrix.flyer_faults import FAULTS, install

YAW_GAIN_PER_S = 1.0
MOST_YAW_RATE_RADPS = 0.3
LOADED = "flyer: loaded"
GO_S = 300.0


class Straight(Navigator):
    """In the place of the navigator: ahead until the governor's braking room is used up.

    Law (12) and the part of the governor that brakes, as flown. The part that slows down for turns is left out: this
    one never turns, so that it is faster near the wall than any flight of the navigator.

    Args:
        parameters: the law's settings.
        rng, outlook: as the navigator has them.
    """

    def __init__(self, parameters: Parameters, rng: np.random.Generator, outlook: Outlook) -> None:
        super().__init__(parameters, rng, outlook)
        self._heading_rad: float | None = None
        self._mode = Mode.HOLD

    @property
    def status(self) -> Status:
        """What it is doing now."""
        return Status(self._mode, 1, None, 0, 0, 0, 0)

    def step(self, measurement: Measurement, pose: Pose, t_s: float) -> Setpoint:
        """One sampling period; whatever is missing stops the vehicle."""
        FAULTS.tick()
        parameters = self.parameters
        finite = pose.is_finite_in_plane
        h_m = measurement.h_m
        climb_mps = 0.0
        if h_m is not None and math.isfinite(h_m):
            climb_mps = laws.climb_mps(self.height_m, h_m, measurement.roof_m, 0.0, parameters)
        if (measurement.missing or measurement.scan is None or not finite) and not FAULTS.careless:
            self._mode = Mode.HOLD
            self._standing.release()
            return self._ramp.limit(Setpoint(t_s, 0.0, climb_mps, 0.0))
        self._mode = Mode.BOUNDARY
        if self._heading_rad is None:
            self._heading_rad = pose.yaw_rad
        speed_mps = laws.speed_mps(Mode.BOUNDARY, measurement.d_front_m, parameters)
        governor = parameters.governor
        room_m = measurement.ahead_m - parameters.critical_margin_m
        if FAULTS.careless:
            speed_mps = parameters.speed_mps
        elif room_m <= 0.0 or not math.isfinite(speed_mps):
            speed_mps = 0.0
        else:
            braking_mps = braking_speed_mps(room_m, governor.reaction_s, governor.brake_mps2)
            speed_mps = min(speed_mps, max(governor.least_speed_mps, braking_mps))
        turn_rad = wrap_rad(self._heading_rad - pose.yaw_rad)
        yaw_rate_radps = max(-MOST_YAW_RATE_RADPS, min(MOST_YAW_RATE_RADPS, YAW_GAIN_PER_S * turn_rad))
        wanted = Setpoint(t_s, speed_mps, climb_mps, yaw_rate_radps)
        if measurement.scan is not None and not FAULTS.careless:
            wanted = self._standing.of(wanted, measurement.scan, measurement.sides, pose)
        return self._ramp.limit(wanted)


def main(arguments: Sequence[str]) -> int:
    """Fly with the options of the gate; the exit code of the application."""
    parser = argparse.ArgumentParser(prog="validation.fault_matrix.flyer", allow_abbrev=False)
    parser.add_argument("--request-fd", type=int, required=True)
    parser.add_argument("--control", type=int, required=True)
    parser.add_argument("--wait", action="store_true")
    given = parser.parse_args(arguments)
    setattr(pipeline, "Navigator", Straight)  # noqa: B010 - a plain assignment is none that types allow
    install(given.control)
    settings = FlightRequest.unsealed(given.request_fd).settings
    # What `process_faults` changes in the file.
    typer.echo(f"flyer: speed {settings.control.speed_mps:g} m/s")
    if given.wait:
        warm_up(settings)
        typer.echo(LOADED)
        FAULTS.go.wait(GO_S)
    return application.main(["--request-fd", str(given.request_fd)])


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
