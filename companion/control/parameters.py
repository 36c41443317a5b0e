"""The numbers of the navigation law: the paper's Tables I and II, and what the tables leave open.

The one definition: the configuration inherits fields, defaults, bounds and meanings, and adds the rules between them.
"""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Lt, doc

from companion.mavlink.firmware import MEASURED_BRAKE_MPS2


class Governor:
    """The speed governor, which bounds the speed by what can be braked and turned."""

    reaction_s: Annotated[float, Ge(0.0), Le(3.0), doc("time from seeing an obstacle to braking, in s")] = 0.6
    brake_mps2: Annotated[
        float,
        Gt(0.0),
        Le(10.0),
        doc(
            "deceleration that the vehicle surely reaches, in m/s²; the safety gate counts on it too, with any "
            f"speed_law. PX4 and ArduPilot were measured to reach {MEASURED_BRAKE_MPS2:g}, pre-flight refuses more"
        ),
    ] = MEASURED_BRAKE_MPS2
    turn_share: Annotated[
        float, Gt(0.0), Le(1.0), doc("share of the largest yaw rate that is counted on to turn away from a wall")
    ] = 0.6
    side_margin_m: Annotated[
        float, Ge(0.0), Le(1.0), doc("how far inside d_s a turn may swing before the vehicle slows, in m")
    ] = 0.1
    least_speed_mps: Annotated[
        float, Gt(0.0), Le(0.5), doc("slowest forward speed while there is still room, in m/s")
    ] = 0.05


class Parameters:
    """The navigation law. The symbol of the paper stands at the end of each meaning."""

    period_s: Annotated[float, Ge(0.01), Le(0.5), doc("sampling period, in s")] = 0.05
    speed_mps: Annotated[float, Gt(0.0), Le(5.0), doc("forward speed, in m/s (v_c, and v_M of the assumptions)")] = 0.5
    max_yaw_rate_radps: Annotated[float, Gt(0.0), Le(3.0), doc("largest yaw rate, in rad/s (u_M)")] = 0.6
    max_climb_mps: Annotated[float, Gt(0.0), Le(3.0), doc("largest climb and descent rate, in m/s")] = 0.4
    max_accel_mps2: Annotated[
        float,
        Ge(0.2),
        Le(5.0),
        doc("largest growth of the commanded speed and climb, in m/s²; slowing down is never limited"),
    ] = 1.0
    height_m: Annotated[float, Ge(0.3), Le(20.0), doc("height above ground, in m (H)")] = 1.5
    margin_m: Annotated[float, Ge(0.3), Le(10.0), doc("safety margin to walls, in m (d_s)")] = 1.0
    critical_margin_m: Annotated[
        float, Ge(0.1), Le(10.0), doc("below this distance in front or beside, stop and turn, in m (d_c)")
    ] = 0.8
    vertical_margin_m: Annotated[
        float, Ge(0.2), Le(10.0), doc("least distance to the roof, and between the layers of several vehicles, in m")
    ] = 0.6
    edge_bearing_rad: Annotated[
        float, Gt(0.0), Le(0.7), doc("an edge within this bearing of the heading can be an exit, in rad (ᾱ)")
    ] = 0.6
    edge_jump_m: Annotated[
        float, Gt(0.0), Le(20.0), doc("jump of the range between neighbouring bearings that makes an edge, in m (r̄)")
    ] = 2.0
    target_radius_m: Annotated[
        float, Gt(0.0), Le(2.0), doc("the intermediate target counts as reached within this distance, in m (ē)")
    ] = 0.2
    tangent_probability: Annotated[
        float, Gt(0.0), Lt(1.0), doc("probability of leaving the wall along a tangent (p, strictly between 0 and 1)")
    ] = 0.3
    choice: Annotated[
        Literal["coin", "frontier", "informed"],
        doc(
            "at a tangent: coin is the paper's fixed p; frontier prefers the way to unseen ground; informed also "
            "leaves a boundary for it over known ground"
        ),
    ] = "informed"
    least_probability: Annotated[
        float, Gt(0.0), Lt(0.5), doc("frontier and informed keep every outcome's probability at or above this (p_min)")
    ] = 0.1
    height_gain_per_s: Annotated[float, Gt(0.0), Le(5.0), doc("gain of the height law (6), in 1/s (g)")] = 1.0
    closing_gain_per_s: Annotated[float, Gt(0.0), Le(5.0), doc("slope of the saturation (9), in 1/s (l)")] = 0.35
    closing_saturation_m: Annotated[float, Gt(0.0), Le(10.0), doc("range of the saturation (9), in m (k)")] = 1.0
    law: Annotated[
        Literal["paper", "smooth"],
        doc("paper: sgn as printed in (7); smooth: a saturation in its place (boundary layer)"),
    ] = "smooth"
    boundary_layer_mps: Annotated[
        float, Gt(0.0), Le(5.0), doc("smooth law in R3: full yaw rate from this sliding variable on, in m/s (ε)")
    ] = 0.12
    boundary_layer_rad: Annotated[
        float, Gt(0.0), Le(3.0), doc("smooth law in R2: full yaw rate from this bearing of the target on, in rad")
    ] = 0.4
    speed_law: Annotated[
        Literal["paper", "governor"], doc("paper: (12) alone; governor: (12), lowered to what can be braked and turned")
    ] = "governor"
    governor: Governor
    climb_feed_forward: Annotated[bool, doc("add the climb rate of the ground ahead to (6)")] = True
    pause_s: Annotated[
        float, Ge(0.0), Le(120.0), doc("after a declined tangent, look for none during this time, in s")
    ] = 4.0
    target_timeout_factor: Annotated[
        float,
        Ge(1.0),
        Le(20.0),
        doc("give a target up when it has come no nearer for this many times the duration of half a turn"),
    ] = 2.5
