"""Faults of the vehicle, its fence, and what people order."""

from __future__ import annotations

import math
from collections.abc import Callable

from companion.config.settings import Settings
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd
from companion.mavlink.modes import personality
from sitl.autopilot.mavlink import dialect as m
from tests.integration.relay import GROUND_STATION, pack
from validation.fault_matrix.corridor import TO_WALL_M
from validation.fault_matrix.injection import Final, Injection
from validation.fault_matrix.pose_faults import STOPPED, altered, changes_worked, shifted_east
from validation.fault_matrix.scene import Flight

FENCE_M = 1.4
"""Before the wall, so far that nothing but the fence stops it there."""
NEAR_FENCE_M = FENCE_M + 0.5
"""From the wall. The gate lets nothing pass that leads over the fence: with ArduPilot from 0.4 m before it."""
DRIFT_M = 0.58
"""From there to behind the fence."""
JUMP_M = 0.7
"""What counts as a jump here: more than the drift."""
HANDS_OFF_S = 0.1
BATTERY_S = 1.0
"""Period of the message that tells of it, as the application asks for it."""
GATE, APPLICATION = 192, 191


def _order(component: int, command: int) -> Callable[[Flight], None]:
    """As an autopilot passes on what a ground station says to the companion."""
    order = m.MAVLink_command_long_message(1, component, command, 0, *[0.0] * 7)
    return lambda flight: flight.relay.send_down(pack(order, GROUND_STATION))


def _change_mode(flight: Flight) -> None:
    """A ground station, on a link of its own, selects what the pilot's switch would select."""
    mode = (3.0, 0.0) if flight.personality == "px4" else (5.0, 0.0)
    order = m.MAVLink_command_long_message(1, 1, m.MAV_CMD_DO_SET_MODE, 0, 1.0, *mode, 0.0, 0.0, 0.0, 0.0)
    flight.relay.send_up(pack(order, GROUND_STATION))


def hands_off(flight: Flight) -> str | None:
    """Nothing of ours flies it once a heartbeat has told that somebody else does."""
    kind = AutopilotKind.PX4 if flight.personality == "px4" else AutopilotKind.ARDUPILOT
    offboard = personality(kind).offboard
    # ArduCopter may leave the mode once more while it boots.
    beats = [beat for beat in flight.relay.seen.heartbeats() if beat.armed]
    engaged_s = next((beat.t_s for beat in beats if beat.custom_mode == offboard), math.inf)
    told_s = next((beat.t_s for beat in beats if beat.t_s > engaged_s and beat.custom_mode != offboard), None)
    if told_s is None:
        return "no heartbeat told of the other mode"
    late = flight.relay.seen.setpoints(told_s + HANDS_OFF_S)
    if late:
        return f"{len(late)} setpoints after the heartbeat, the last {late[-1].t_s - told_s:.2f} s after"
    moving = (
        MavCmd.DO_SET_MODE,
        MavCmd.COMPONENT_ARM_DISARM,
        MavCmd.NAV_TAKEOFF,
        m.MAV_CMD_NAV_LAND,
        m.MAVLINK_MSG_ID_SET_MODE,
    )
    orders = [seen for seen in flight.relay.seen.commands(told_s + HANDS_OFF_S) if seen.command in moving]
    return f"command {orders[0].command} after the heartbeat" if orders else None


# The flight begins at the origin and leads east.
_FENCED = {"safety": {"fence": {"east_m": [-20.0, round(TO_WALL_M - FENCE_M, 3)]}, "pose": {"jump_m": JUMP_M}}}


VEHICLE_FAULTS = (
    Injection(
        "battery low",
        "vehicle",
        "5 % are left all of a sudden: it lands",
        lambda flight: flight.tell_autopilot("battery 5"),
        frozenset({Final.LANDED}),
        limit_s=BATTERY_S,
        careless=True,
    ),
    Injection(
        "fence",
        "vehicle",
        f"the application ignores a fence {FENCE_M:g} m before the wall: no setpoint leads over it",
        lambda _flight: None,
        frozenset({Final.BRAKED, Final.HELD}),
        # It reaches the place where the stop begins in this time.
        limit_s=(NEAR_FENCE_M - FENCE_M) / Settings().control.speed_mps,
        careless=True,
        trigger_m=NEAR_FENCE_M,
        settings=_FENCED,
    ),
    Injection(
        "outside of the fence",
        "vehicle",
        f"a correction of the position by {DRIFT_M:g} m puts the vehicle on the other side of the fence",
        altered(lambda: shifted_east(DRIFT_M)),
        frozenset({Final.BRAKED, Final.HELD}),
        careless=True,
        trigger_m=NEAR_FENCE_M,
        settings=_FENCED,
        verify=changes_worked,
    ),
)

PEOPLES_ORDERS = (
    Injection(
        "transmitter takeover",
        "people",
        "the pilot's switch: from the next heartbeat on nothing of ours flies it",
        lambda flight: flight.tell_autopilot("takeover"),
        frozenset({Final.PILOT}),
        needs_stop=False,
        verify=hands_off,
    ),
    Injection(
        "mode changed by a ground station",
        "people",
        "a ground station selects the pilot's mode: the same",
        _change_mode,
        frozenset({Final.PILOT}),
        needs_stop=False,
        verify=hands_off,
    ),
    Injection(
        "ground stop to the gate",
        "people",
        "a ground station orders the gate to stop (DO_PAUSE_CONTINUE)",
        _order(GATE, m.MAV_CMD_DO_PAUSE_CONTINUE),
        STOPPED,
        careless=True,
    ),
    Injection(
        "landing ordered of the application",
        "people",
        "a ground station orders the application to land where it is (NAV_LAND)",
        _order(APPLICATION, m.MAV_CMD_NAV_LAND),
        STOPPED,
        careless=True,
    ),
)
