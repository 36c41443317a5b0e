"""PX4 as it was measured: main of August 2025 with its built-in simulator SIH."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

from companion.mavlink.ids import MavSeverity
from sitl.autopilot.events import Event
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.origin import ORIGIN_ALT_M, zero_from
from sitl.autopilot.parameters import Encoding, Kind
from sitl.autopilot.personality import Numbers, Personality, Watch
from sitl.autopilot.px4_failsafes import Px4Failsafes
from sitl.autopilot.px4_modes import DESCEND, LABELS, MODES, STICKS
from sitl.autopilot.px4_parameters import NO_GPS_PARAMETERS, ON_REQUEST, PARAMETERS, RATES_HZ
from sitl.autopilot.state import Behaviour, Mode, State

_ORIGIN_WAIT_S = 5.0
_EV_POSITION, _EV_YAW = 1, 8
_SHORT_OF_HEIGHT_M = 0.6
"""The take-off is over this far below the height that was asked for."""
_VISUAL = (
    m.MAV_ESTIMATOR_TYPE_UNKNOWN,
    m.MAV_ESTIMATOR_TYPE_NAIVE,
    m.MAV_ESTIMATOR_TYPE_VISION,
    m.MAV_ESTIMATOR_TYPE_VIO,
)
_UNHEALTHY = "Arming denied: Resolve system health failures first\t"
_FLY_OFF_SHARE = 0.8
"""Of MPC_XY_CRUISE: 4 m/s were measured with the default."""
_OFFBOARD_RAMP_S = 1.2
"""A climb that offboard asks for needs so much longer to lift off than a take-off."""
_DETECTED_S = 0.9
"""After this long a pull the land detector believes that it flies, 3.5 s before it does."""
_ALWAYS = m.ESTIMATOR_ATTITUDE | m.ESTIMATOR_VELOCITY_VERT | m.ESTIMATOR_POS_VERT_ABS | m.ESTIMATOR_POS_VERT_AGL
_AIDED = (
    m.ESTIMATOR_VELOCITY_HORIZ | m.ESTIMATOR_POS_HORIZ_REL | m.ESTIMATOR_POS_HORIZ_ABS | m.ESTIMATOR_PRED_POS_HORIZ_REL
)
_MISSION_PLANNER = 190


class _Px4(Personality):
    name = "px4"
    autopilot = m.MAV_AUTOPILOT_PX4
    encoding = Encoding.BYTEWISE
    integer = Kind.INT32
    kinds: ClassVar[Mapping[str, Kind]] = {}
    encoding_capability = m.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
    version = 1 << 24 | 17 << 16
    # From 0.35 m/s: 0.15 m after 0.5 s, 0.22 at 1 s, 0.28 at 2 s, then it creeps at 0.02 to 0.06 m/s.
    numbers = Numbers(
        damping=0.9, velocity_gain=0.92, drift_mps=0.015, creep_mps=0.04, turning_drift=1.6, blind_drift_mps2=0.35,
        blind_mps=(0.5, 1.75), hold_climb_gain=0.24, climb_mps=0.6, climb_approach=2.0, land_mps=0.7, cells=4,
        capacity_mah=5000.0,
    )  # fmt: skip
    ready_s = 6.0
    modes = MODES
    descend = DESCEND
    boot_mode = hold_mode = "AUTO.LOITER"
    land_mode = "AUTO.LAND"
    return_mode = "AUTO.RTL"
    pilot_mode = "POSCTL"
    setpoint_mode = "OFFBOARD"
    parameters = PARAMETERS
    no_gps_parameters = NO_GPS_PARAMETERS
    rates_hz = RATES_HZ
    on_request = ON_REQUEST
    refuses_interval = m.MAV_RESULT_FAILED
    refused = m.MAV_RESULT_TEMPORARILY_REJECTED
    refuses_reboot = m.MAV_RESULT_DENIED
    velocity_frames = frozenset({m.MAV_FRAME_LOCAL_NED, m.MAV_FRAME_BODY_NED})
    drifting_frames: frozenset[int] = frozenset()
    sync_period_s = 0.1
    synchronises_odometry = True
    acknowledges_set_mode = False
    acknowledges_twice = True
    position_before_fix = True
    texts_only_to_ground_stations = True
    takes_what_nobody_takes = False
    transmitter_at_boot = False
    no_channel_us = 65535
    takes_another_origin = True
    pauses = False
    no_such_message = None
    heartbeat_with_mode = False
    armed_text = "Armed by external command\t"
    disarmed_text = "Disarmed by external command\t"

    def custom_mode(self, main: float, sub: float) -> int | None:
        if not (0.0 <= main < 256.0 and 0.0 <= sub < 256.0):
            return None
        return int(main) << 16 | int(sub) << 24

    def new_watch(self) -> Watch:
        return Px4Failsafes(self)

    def gps_set_up(self, state: State) -> bool:
        return state.parameters["SYS_HAS_GPS"] != 0 and state.parameters["EKF2_GPS_CTRL"] != 0

    def position_valid(self, state: State) -> bool:
        if self.gps_set_up(state):
            if state.since_boot_s < 0.5 * self.ready_s * state.hurry:
                return False
        else:
            wanted = _EV_POSITION | _EV_YAW
            if int(state.parameters["EKF2_EV_CTRL"]) & wanted != wanted:
                return False
        # Dead reckoning ends a little before the time that the parameter says.
        blind_s = max(0.1, state.parameters["EKF2_NOAID_TOUT"] * 1e-6 - 0.25)
        return state.estimator.alone_s(state.t_s) < blind_s

    def takes_odometry(self, state: State, message: Message) -> bool | None:
        if int(state.parameters["EKF2_EV_CTRL"]) == 0:
            return None
        if message.get_type() == "VISION_POSITION_ESTIMATE":
            return True
        if message.estimator_type not in _VISUAL:
            return None
        return {m.MAV_FRAME_LOCAL_NED: True, m.MAV_FRAME_LOCAL_FRD: False}.get(message.frame_id)

    def height_from_odometry(self, state: State) -> bool:
        return int(state.parameters["EKF2_HGT_REF"]) == 3

    def global_position(self, state: State) -> bool:
        """Only with axes that are known to be north and east; an origin alone does not give it."""
        if not self.position_valid(state):
            return False
        if self.gps_set_up(state):
            return True
        return state.estimator.ned and state.t_s - state.origin_s >= _ORIGIN_WAIT_S * state.hurry

    def can_run(self, state: State, mode: Mode) -> bool:
        """Whether a mode can be flown now."""
        if mode.behaviour is Behaviour.SETPOINTS:
            return not self.offboard_lost(state)
        if mode.name in STICKS:
            sticks = not state.transmitter.lost
            return sticks and (mode.name != "POSCTL" or self.position_valid(state))
        if mode.name in ("AUTO.LOITER", "AUTO.RTL"):
            return self.global_position(state)
        return self.position_valid(state)

    def offboard_lost(self, state: State) -> bool:
        if not self.position_valid(state):
            return True
        since_s = 0.0 if state.target is None else state.target.t_s
        # 0.03 to 0.12 s late, differently each time, and the same again in a repeated run.
        late_s = 0.03 + 0.09 * ((since_s * 7.31) % 1.0)
        limit_s = state.parameters["COM_OF_LOSS_T"]
        if state.failsafe is None and state.mode.behaviour is Behaviour.SETPOINTS:
            return state.target_age_s() >= limit_s + late_s
        return state.target_age_s() >= limit_s or not (state.failsafe is not None or state.streaming())

    def arming_refusals(self, state: State) -> tuple[str, ...]:
        if state.since_boot_s < self.ready_s * state.hurry:
            return _UNHEALTHY, "Preflight Fail: ekf2 missing data"
        if not self.global_position(state) and state.parameters["COM_ARM_WO_GPS"] == 0:
            return _UNHEALTHY, "Preflight Fail: Global position estimate required"
        if not self.position_valid(state):
            return _UNHEALTHY, "Preflight Fail: horizontal position unstable"
        no_station = state.parameters["NAV_DLL_ACT"] != 0 and state.ground_station.lost
        if no_station or not state.shown.armable or not self.can_run(state, state.mode) or state.airframe.crashed:
            return (_UNHEALTHY,)
        return ()

    def tell_arming_refused(self, state: State) -> None:
        state.tell(Event("commander_arm_denied_resolve_failures", 2, 6))

    def mode_refusal(self, state: State, mode: Mode) -> str | None:
        """While disarmed every mode is taken, and a landing always is."""
        if not state.armed or mode.behaviour is Behaviour.LAND or self.can_run(state, mode):
            return None
        return f"Switching to {LABELS[mode.name][0]} is currently not available\t"

    def tell_mode_refused(self, state: State, mode: Mode, refusal: str, source: int | None) -> None:
        """To a command that changes the mode, only Mission Planner's number gets words: others hear a tone."""
        if source in (None, _MISSION_PLANNER):
            state.say(MavSeverity.CRITICAL, refusal)
            arguments = mode.custom_mode.to_bytes(4, "little") + bytes([LABELS[mode.name][1]])
            state.tell(Event("commander_modeswitch_not_avail", 2, 6, arguments))

    def unknown_mode(self, state: State, number: int) -> int:
        if number >> 16 & 0xFF != 4:
            return int(m.MAV_RESULT_ACCEPTED)
        state.say(MavSeverity.CRITICAL, "Unsupported auto mode\t")
        state.tell(Event("commander_unsupported_auto_mode", 3, 3))
        return int(self.refused)

    def on_setpoint(self, state: State) -> None:
        """Nothing: PX4 looks at the age of the setpoints only."""

    def take_off(self, state: State, altitude_m: float) -> bool:
        mode = self.modes["AUTO.TAKEOFF"]
        if not self.can_run(state, mode):
            self.tell_mode_refused(state, mode, "Switching to Takeoff is currently not available\t", None)
            return False
        state.enter(mode)
        state.takeoff_height_m = state.parameters["MIS_TAKEOFF_ALT"]
        if math.isfinite(altitude_m):
            ground_m = state.airframe.pose.z_m - state.airframe.height_m
            state.takeoff_height_m = max(0.0, altitude_m - ORIGIN_ALT_M - ground_m)
        else:
            state.say(MavSeverity.INFO, f"Using default takeoff altitude: {state.takeoff_height_m:.1f} m\t")
        return True

    def disarming_refused(self, state: State) -> None:
        state.say(MavSeverity.CRITICAL, "Disarming denied: not landed\t")
        state.tell(Event("commander_disarm_denied_not_landed", 2, 6))

    def base_mode(self, state: State) -> int:
        mode = state.shown
        flags = m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        if mode.name in STICKS:
            return int(flags | m.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED | m.MAV_MODE_FLAG_STABILIZE_ENABLED)
        if mode.behaviour is Behaviour.SETPOINTS:
            stabilized = state.target_age_s() < state.parameters["COM_OF_LOSS_T"]
            return int(flags | (m.MAV_MODE_FLAG_STABILIZE_ENABLED if stabilized else 0))
        auto = m.MAV_MODE_FLAG_AUTO_ENABLED | m.MAV_MODE_FLAG_STABILIZE_ENABLED | m.MAV_MODE_FLAG_GUIDED_ENABLED
        return int(flags | auto)

    def system_status(self, state: State) -> int:
        if state.armed:
            return int(m.MAV_STATE_ACTIVE if state.failsafe is None else m.MAV_STATE_CRITICAL)
        return int(m.MAV_STATE_UNINIT if self.arming_refusals(state) else m.MAV_STATE_STANDBY)

    def estimator_flags(self, state: State) -> int:
        """CONST_POS_MODE says that it is at rest, whatever aids it."""
        flags = _ALWAYS | (m.ESTIMATOR_CONST_POS_MODE if state.airframe.on_ground else 0)
        if not self.position_valid(state):
            return int(flags)
        by_gps = m.ESTIMATOR_PRED_POS_HORIZ_ABS if self.gps_set_up(state) else 0
        return int(flags | _AIDED | by_gps)

    def battery_percent(self, state: State) -> float:
        battery = state.battery
        if battery.measured_v is None:
            return battery.percent
        return max(0.0, min(100.0, battery.percent_of(battery.measured_v)))

    def battery_warning(self, state: State) -> int:
        share = self.battery_percent(state) / 100.0
        return sum(share < state.parameters[name] for name in ("BAT_LOW_THR", "BAT_CRIT_THR", "BAT_EMERGEN_THR"))

    def stop_s(self, state: State) -> float:
        """Of zero velocity, besides what it creeps on; of a hold that was asked for, and of a failsafe's."""
        if self.active(state) is Behaviour.SETPOINTS:
            return 0.62
        return 0.68 if state.failsafe is None else 0.88

    def lift_s(self, state: State) -> float:
        ramp_s = state.parameters["MPC_TKO_RAMP_T"]
        return ramp_s + (_OFFBOARD_RAMP_S if state.shown.behaviour is Behaviour.SETPOINTS else 0.0)

    def spool_s(self, state: State) -> float:
        return state.parameters["COM_SPOOLUP_TIME"]

    def in_the_air(self, state: State) -> bool:
        return state.hover_s >= _DETECTED_S or not state.airframe.on_ground

    def tell_landed(self, state: State) -> None:
        words = "Landing detected" if state.landed else "Takeoff detected"
        state.say(MavSeverity.INFO, f"{words}\t")
        state.tell(Event(f"commander_{words.lower().replace(' ', '_')}", 6, 6))

    def lands_at(self, state: State) -> tuple[float, float, float] | None:
        """With an origin, but axes that are not north and east, the place to land at was never written: 0/0."""
        if self.gps_set_up(state) or state.estimator.ned or state.origin is None:
            return None
        return *zero_from(state.origin), _FLY_OFF_SHARE * state.parameters["MPC_XY_CRUISE"]

    def return_climb(self, state: State) -> tuple[float, float]:
        return state.parameters["RTL_RETURN_ALT"], 1.2

    def return_mps(self, state: State) -> float:
        return state.parameters["MPC_XY_CRUISE"]

    def shows_receiver(self, state: State) -> bool:
        """While it hears a transmitter."""
        return not state.transmitter.lost

    def supervise(self, state: State) -> None:
        if not state.armed:
            return
        if state.mode.armable:
            state.mode_after_disarming = state.mode
        self._watch_takeoff(state)
        limit_s = state.parameters["COM_DISARM_LAND" if state.flown else "COM_DISARM_PRFLT"]
        if limit_s > 0.0 and state.on_ground_s > limit_s + (1.0 if state.flown else 0.0):
            state.disarm("Disarmed by landing\t" if state.flown else "Disarmed by auto preflight disarming\t")

    def _watch_takeoff(self, state: State) -> None:
        if state.shown.behaviour is not Behaviour.TAKEOFF:
            return
        if state.takeoff_s is None:
            state.takeoff_s, state.takeoff_from_m = state.t_s, state.estimator.pose.z_m
        pose, to_m = state.estimator.pose, state.takeoff_from_m + state.takeoff_height_m
        over = pose.z_m >= to_m - min(_SHORT_OF_HEIGHT_M, 0.5 * state.takeoff_height_m)
        # Without a hold to go to it stays in take-off, at the height that was asked for.
        if over and self.global_position(state):
            state.enter(self.modes[self.hold_mode])
            state.hold_m = (pose.x_m, pose.y_m, to_m)


PX4 = _Px4()
"""The PX4 personality."""
