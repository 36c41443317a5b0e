"""Up and down: law (6), with what is measured of ground and roof, and of the rock beside the way. Pure."""

from __future__ import annotations

import math

from companion.control import laws
from companion.control.parameters import Parameters
from companion.model import Measurement, Pose


def climb_mps(height_m: float, measurement: Measurement, pose: Pose, holds: bool, parameters: Parameters) -> float:
    """Paper eq. (6); 0 when the height is not known, and where the way up or down leads to rock beside.

    Rock above or below moves it all the same.

    Args:
        height_m: H.
        measurement: of now.
        pose: of now.
        holds: the vehicle flies nowhere, so that the ground ahead is none of its own.
        parameters: the law's settings.
    """
    h_m, roof_m, slope = measurement.h_m, measurement.roof_m, measurement.ground_slope
    if h_m is None or not math.isfinite(h_m):
        # Over a shaft there is room below, and nothing else to hold it off the roof.
        near_m = 0.0 if roof_m is None or not measurement.over_shaft else parameters.vertical_margin_m - roof_m
        return -min(parameters.height_gain_per_s * near_m, parameters.max_climb_mps) if near_m > 0.0 else 0.0
    ground_climb_mps = 0.0
    if parameters.climb_feed_forward and slope is not None and math.isfinite(slope) and not holds:
        ground_climb_mps = pose.towards_mps(0.0) * slope
    rise_m = measurement.rise_m if math.isfinite(measurement.rise_m) else 0.0
    asked_mps = laws.climb_mps(height_m, h_m, roof_m, ground_climb_mps, parameters, rise_m)
    d_m = measurement.d_m
    if parameters.law == "paper" or d_m is None or not d_m < parameters.critical_margin_m:
        return asked_mps
    # Nearer than d_c is something at the heights that it gets to. Only rock above or below moves it there.
    under_roof = roof_m is not None and roof_m < parameters.vertical_margin_m
    over_ground = h_m - rise_m < min(parameters.vertical_margin_m, height_m)
    return max(asked_mps, 0.0) * over_ground + min(asked_mps, 0.0) * under_roof
