"""The check of PX4's origin on the globe, without GPS: with one, and no position on the globe, it lands at 0°/0°."""

from __future__ import annotations

from collections.abc import Callable

from companion.autopilot.interface import Link, LinkError
from companion.autopilot.message_rates import POLLED
from companion.autopilot.vehicle_state import VehicleState
from companion.config.autopilot import AutopilotSettings
from companion.flight.preflight.result import CheckResult
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd, MavResult

ORIGIN = "origin"


async def origin(
    link: Link, state: Callable[[], VehicleState], autopilot: AutopilotSettings
) -> tuple[CheckResult, ...]:
    """The check; none where it cannot matter.

    That no origin was heard proves nothing on a link that loses messages: the autopilot is asked, and has to deny it.

    Args:
        link: to the autopilot.
        state: what is known of the vehicle now.
        autopilot: the settings.
    """
    if autopilot.gps or link.kind is not AutopilotKind.PX4:
        return ()
    local_ned = autopilot.odometry_frame == "local_ned"
    if not state().global_position and not state().origin_set:
        try:
            answer = await link.command(MavCmd.REQUEST_MESSAGE, float(POLLED["GPS_GLOBAL_ORIGIN"]))
        except LinkError as error:
            return (_result(local_ned, False, f"not known whether one is set: {error}", "ask again on a better link"),)
        if answer == MavResult.ACCEPTED and not state().origin_set:
            return (_result(local_ned, False, "one is set, but was not heard", "ask again on a better link"),)
    if state().global_position:
        return (_result(local_ned, True, "set, and the autopilot knows where on the globe it is"),)
    if state().origin_set:
        return (_result(local_ned, False, "one is set, but no GLOBAL_POSITION_INT comes", _cure(local_ned)),)
    if local_ned:
        fix = "is odometry fed to it? Reboot the autopilot; if it never takes one, autopilot.odometry_frame: local_frd"
        return (_result(local_ned, False, "told, and not taken: without one PX4 cannot hold", fix),)
    return (_result(local_ned, True, "none is set: every hold will be a landing, in place"),)


def _cure(local_ned: bool) -> str:
    if local_ned:
        return (
            "send the odometry as LOCAL_NED (MAV_FRAME 1; without GPS and compass any heading will do) and reboot the "
            "autopilot; if it can only come as LOCAL_FRD, set autopilot.odometry_frame: local_frd, let nobody set an "
            "origin, and reboot"
        )
    return (
        "reboot the autopilot and let nobody set an origin (a ground station may have, or the odometry's source); or "
        "send LOCAL_NED and set autopilot.odometry_frame: local_ned"
    )


def _result(local_ned: bool, ok: bool, found: str, fix: str = "") -> CheckResult:
    wanted = "set, and GLOBAL_POSITION_INT comes" if local_ned else "none, or GLOBAL_POSITION_INT comes as well"
    reason = (
        "With an origin and no global position every landing, whoever orders it, would fly to 0°/0°: PX4 was measured "
        "to fly off at 4 m/s, into walls. Odometry as LOCAL_FRD never gives it one."
    )
    return CheckResult(ORIGIN, ok, found, wanted, reason, fix)
