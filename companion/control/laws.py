"""The control laws of the paper, equations (6) to (9) and (12), as functions of numbers."""

from __future__ import annotations

import math

from companion.control.parameters import Parameters
from companion.model import Mode


def sign(x: float) -> float:
    """Paper eq. (8): 1, 0 or -1."""
    return math.copysign(1.0, x) if x != 0.0 else 0.0


def saturation(x: float) -> float:
    """The continuous stand-in for `sign`: slope 1 between -1 and 1, constant outside."""
    return max(-1.0, min(1.0, x))


def closing_speed_mps(x_m: float, gain_per_s: float, saturation_m: float) -> float:
    """X of paper eq. (9): l·x for |x| < k, else l·k·sgn(x). The speed at which the wall shall be approached."""
    if abs(x_m) < saturation_m:
        return gain_per_s * x_m
    return gain_per_s * saturation_m * sign(x_m)


def circle_yaw_rate_radps(direction: int, parameters: Parameters) -> float:
    """Paper eq. (7), R1: ±u_M, the initial circle; ``direction`` is 1 (left) or -1, drawn once."""
    return direction * parameters.max_yaw_rate_radps


def tangent_yaw_rate_radps(target_bearing_rad: float, parameters: Parameters) -> float:
    """Paper eq. (7), R2: sgn(φ)·u_M, where φ is the bearing of the intermediate target."""
    if parameters.law == "paper":
        return sign(target_bearing_rad) * parameters.max_yaw_rate_radps
    return saturation(target_bearing_rad / parameters.boundary_layer_rad) * parameters.max_yaw_rate_radps


def cruising_rate_mps(d_bearing_rad: float, parameters: Parameters) -> float:
    """ḋ = -v·cos α* for a static wall, at the speed v_c that (12) commands rather than the speed flown.

    Before a wall the governor and (12) slow the vehicle to nearly nothing. The ḋ flown then vanishes, and a law without
    sgn would turn away at a crawl; what matters is how d would change if the vehicle went on as it points. The smooth
    law takes the smaller of the two rates: it also must not rest in a corner, content that it could fly along one wall.
    """
    return -parameters.speed_mps * math.cos(d_bearing_rad)


def sliding_mps(d_m: float, d_dot_mps: float, parameters: Parameters, margin_m: float | None = None) -> float:
    """ḋ + X(d - d_s) of paper eq. (7), R3: zero where the wall is approached as fast as it shall be.

    Args:
        d_m: distance to the obstacle.
        d_dot_mps: its rate of change.
        parameters: the law's settings.
        margin_m: the distance to keep, None: d_s.
    """
    keep_m = parameters.margin_m if margin_m is None else margin_m
    x_mps = closing_speed_mps(d_m - keep_m, parameters.closing_gain_per_s, parameters.closing_saturation_m)
    return d_dot_mps + x_mps


def boundary_yaw_rate_radps(gamma: int, d_m: float, d_dot_mps: float, parameters: Parameters) -> float:
    """Paper eq. (7), R3: Γ·sgn[ḋ + X(d - d_s)]·u_M.

    Args:
        gamma: Γ, -1 when the wall to follow is on the right, 1 when on the left.
        d_m: distance to the obstacle.
        d_dot_mps: its rate of change.
        parameters: the law's settings.
    """
    return following_yaw_rate_radps(gamma, sliding_mps(d_m, d_dot_mps, parameters), parameters)


def following_yaw_rate_radps(gamma: int, sliding: float, parameters: Parameters) -> float:
    """Paper eq. (7), R3, of a sliding variable that is known, in m/s: negative turns away from the wall of Γ."""
    if parameters.law == "paper":
        return gamma * sign(sliding) * parameters.max_yaw_rate_radps
    return gamma * saturation(sliding / parameters.boundary_layer_mps) * parameters.max_yaw_rate_radps


def speed_mps(mode: Mode, d_front_m: float | None, parameters: Parameters) -> float:
    """Paper eq. (12): 0 in R1, and in R3 when d_f < d_c; else v_c. ``d_front_m`` None: nothing near in front."""
    if mode in (Mode.CIRCLE, Mode.HOLD):
        return 0.0
    if mode is Mode.BOUNDARY and d_front_m is not None and d_front_m < parameters.critical_margin_m:
        return 0.0
    return parameters.speed_mps


def climb_mps(
    height_m: float,
    h_m: float,
    roof_m: float | None,
    ground_climb_mps: float,
    parameters: Parameters,
    rise_m: float = 0.0,
) -> float:
    """Paper eq. (6): g·(H - h), with the climb rate of the ground ahead added, and roof and rises respected.

    The proportional law alone stays behind by slope·v/g on a slope; the feed-forward removes that offset. Under a low
    roof the vehicle stays ``vertical_margin_m`` below it even where H would be higher, and over a rise as much above
    that even where H would be lower. Where both cannot be, it flies in the middle between them.

    Args:
        height_m: H, the height above ground to hold.
        h_m: the height above ground now.
        roof_m: free height above the vehicle, None when not known.
        ground_climb_mps: forward speed times slope of the ground ahead, 0 when not known.
        parameters: the law's settings.
        rise_m: by how much the highest ground on the way ahead lies above that below.
    """
    margin_m = parameters.vertical_margin_m
    # Whoever asks for a height below the margin over level ground gets it.
    wanted_m = max(height_m, rise_m + min(margin_m, height_m))
    if roof_m is not None:
        room_m = h_m + roof_m
        wanted_m = min(wanted_m, max(room_m - margin_m, (room_m + rise_m) / 2.0))
    climb = parameters.height_gain_per_s * (wanted_m - h_m) + ground_climb_mps
    return max(-parameters.max_climb_mps, min(parameters.max_climb_mps, climb))
