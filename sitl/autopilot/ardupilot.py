"""ArduCopter as it was measured: 4.7-dev of May 2025 in SITL."""

from __future__ import annotations

import math

from companion.mavlink.ids import MavSeverity
from sitl.autopilot import explore_script
from sitl.autopilot.ardupilot_failsafes import LOST_S, NEEDS_NO_POSITION, ArduPilotFailsafes
from sitl.autopilot.ardupilot_parameters import (
    EXTERNAL,
    GPS,
    KINDS,
    NO_GPS_PARAMETERS,
    ON_REQUEST,
    PARAMETERS,
    RATES_HZ,
)
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from sitl.autopilot.parameters import Encoding, Kind
from sitl.autopilot.personality import Numbers, Personality, Watch
from sitl.autopilot.state import Behaviour, Mode, State

_MODES = {
    "STABILIZE": Mode("STABILIZE", 0, Behaviour.COAST),
    "ALT_HOLD": Mode("ALT_HOLD", 2, Behaviour.COAST),
    "GUIDED": Mode("GUIDED", 4, Behaviour.SETPOINTS),
    "LOITER": Mode("LOITER", 5, Behaviour.HOLD),
    "RTL": Mode("RTL", 6, Behaviour.RETURN, armable=False),
    "LAND": Mode("LAND", 9, Behaviour.LAND, armable=False),
    "POSHOLD": Mode("POSHOLD", 16, Behaviour.HOLD),
    "BRAKE": Mode("BRAKE", 17, Behaviour.HOLD, armable=False),
    explore_script.EXPLORE.name: explore_script.EXPLORE,
}
_READY_S = 2.3
"""From boot until "ArduPilot Ready"."""
_ACCELS_S, _GYROS_S, _EXTERNAL_S = 10.0, 20.0, 3.0
"""From there until the inertial sensors agree, and with external navigation until there is a position."""
_SENSORS_S = 21.0
_COMPLAINS_S = 30.0
_LIFTED_M = 0.3
_SEEN_FLYING_M = 0.15
"""The land detector lets go 0.4 s after it has left the ground."""
_STOP_S = {"LOITER": 0.88, "POSHOLD": 0.88, "LAND": 0.62, "RTL": 0.62}
"""Distance to stop per speed."""
_BRAKE_ACCELERATION_MPS2 = 7.5
_LEAST_STOP_S = 0.48
_VALID = (
    m.ESTIMATOR_ATTITUDE | m.ESTIMATOR_VELOCITY_HORIZ | m.ESTIMATOR_VELOCITY_VERT | m.ESTIMATOR_POS_HORIZ_REL
    | m.ESTIMATOR_POS_HORIZ_ABS | m.ESTIMATOR_POS_VERT_ABS | m.ESTIMATOR_PRED_POS_HORIZ_REL
    | m.ESTIMATOR_PRED_POS_HORIZ_ABS
)  # fmt: skip
_WAITING = (
    m.ESTIMATOR_ATTITUDE | m.ESTIMATOR_VELOCITY_HORIZ | m.ESTIMATOR_VELOCITY_VERT | m.ESTIMATOR_POS_VERT_ABS
    | m.ESTIMATOR_CONST_POS_MODE
)  # fmt: skip
_LOST = m.ESTIMATOR_ATTITUDE | m.ESTIMATOR_VELOCITY_VERT | m.ESTIMATOR_POS_VERT_ABS


class _ArduPilot(Personality):
    name = "ardupilot"
    autopilot = m.MAV_AUTOPILOT_ARDUPILOTMEGA
    encoding = Encoding.C_CAST
    integer = Kind.INT8
    kinds = KINDS
    encoding_capability = m.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    version = 4 << 24 | 7 << 16
    # 63 % after 0.61 s, 90 % after 0.98 s; from 0.42 m/s zero velocity takes 0.24 m and 1.0 s; nothing drifts.
    numbers = Numbers(
        damping=0.8, velocity_gain=1.014, drift_mps=0.0008, creep_mps=0.0, turning_drift=1.0, blind_drift_mps2=0.3,
        blind_mps=(0.1, 0.17), hold_climb_gain=1.0, climb_mps=1.0, climb_approach=2.2, land_mps=0.5, cells=3,
        capacity_mah=3300.0,
    )  # fmt: skip
    ready_s = 42.0
    modes = _MODES
    boot_mode = "STABILIZE"
    hold_mode = "BRAKE"
    land_mode = "LAND"
    return_mode = "RTL"
    pilot_mode = "LOITER"
    setpoint_mode = "GUIDED"
    parameters = PARAMETERS
    no_gps_parameters = NO_GPS_PARAMETERS
    rates_hz = RATES_HZ
    on_request = ON_REQUEST
    refuses_interval = m.MAV_RESULT_DENIED
    refused = m.MAV_RESULT_FAILED
    refuses_reboot = m.MAV_RESULT_FAILED
    velocity_frames = frozenset({m.MAV_FRAME_LOCAL_NED, m.MAV_FRAME_BODY_NED, m.MAV_FRAME_BODY_OFFSET_NED})
    drifting_frames = frozenset({m.MAV_FRAME_BODY_FRD})
    sync_period_s = 5.0
    synchronises_odometry = False
    acknowledges_set_mode = True
    acknowledges_twice = False
    position_before_fix = False
    texts_only_to_ground_stations = False
    takes_what_nobody_takes = True
    transmitter_at_boot = True
    no_channel_us = 0
    takes_another_origin = False
    pauses = True
    no_such_message = "No ap_message for mavlink id ({})"
    heartbeat_with_mode = True
    armed_text = "Arming motors"
    disarmed_text = "Disarming motors"

    def custom_mode(self, main: float, sub: float) -> int | None:  # noqa: ARG002
        return int(main) if 0.0 <= main < 256.0 else None

    def new_watch(self) -> Watch:
        return ArduPilotFailsafes(self)

    def gps_set_up(self, state: State) -> bool:
        return state.parameters["GPS1_TYPE"] != 0 and state.parameters["EK3_SRC1_POSXY"] == GPS

    def position_valid(self, state: State) -> bool:
        if state.estimator.alone_s(state.t_s) >= LOST_S:
            return False
        if self.gps_set_up(state):
            return state.since_boot_s >= self.ready_s * state.hurry
        fed_since_s = state.estimator.fed_since_s
        if state.origin is None or state.parameters["EK3_SRC1_POSXY"] != EXTERNAL or fed_since_s is None:
            return False
        if state.t_s - max(fed_since_s, state.boot_s + _READY_S * state.hurry) < _EXTERNAL_S * state.hurry:
            return False
        fed_speed_s = state.estimator.fed_speed_s
        by_speed = state.parameters["EK3_SRC1_VELXY"] == EXTERNAL
        return not by_speed or (fed_speed_s is not None and state.t_s - fed_speed_s < LOST_S)

    def takes_odometry(self, state: State, message: Message) -> bool | None:
        if state.parameters["VISO_TYPE"] == 0:
            return None
        if message.get_type() == "VISION_POSITION_ESTIMATE":
            return True
        frames = (message.frame_id, message.child_frame_id)
        return False if frames == (m.MAV_FRAME_LOCAL_FRD, m.MAV_FRAME_BODY_FRD) else None

    def height_from_odometry(self, state: State) -> bool:
        return state.parameters["EK3_SRC1_POSZ"] == EXTERNAL

    def global_position(self, state: State) -> bool:
        return state.origin is not None and self.position_valid(state)

    def arming_refusals(self, state: State) -> tuple[str, ...]:
        if not state.shown.armable:
            return (f"Arm: {state.shown.name} mode not armable",)
        return tuple(f"Arm: {words}" for words in self._complaints(state))

    def _complaints(self, state: State) -> list[str]:
        """What its checks find, several at a time."""
        if state.airframe.crashed:
            return ["Crashed"]
        if state.parameters["ARMING_CHECK"] == 0:
            return []
        ready_s, hurry = state.since_boot_s - _READY_S * state.hurry, state.hurry
        if ready_s < 0.0:
            return ["System not initialised"]
        found = []
        if ready_s < _ACCELS_S * hurry:
            found.append("Accels inconsistent")
        elif ready_s < (_GYROS_S if self.gps_set_up(state) else _SENSORS_S) * hurry:
            found.append("Gyros inconsistent")
        if not self.position_valid(state):
            found += ["AHRS: waiting for home"] if state.origin is None else []
            found.append("Need Position Estimate")
        return found

    def tell_arming_refused(self, state: State) -> None:
        """Nothing but texts."""

    def mode_refusal(self, state: State, mode: Mode) -> str | None:
        if mode is explore_script.EXPLORE:
            return explore_script.refusal(state)
        if mode.name in NEEDS_NO_POSITION or self.position_valid(state) or not state.armed:
            return None
        return f"Mode change to {mode.name} failed: requires position"

    def tell_mode_refused(self, state: State, mode: Mode, refusal: str, source: int | None) -> None:  # noqa: ARG002
        state.say(MavSeverity.WARNING, refusal)

    def unknown_mode(self, state: State, number: int) -> int:
        state.say(MavSeverity.WARNING, f"No such mode {number}")
        return int(self.refused)

    def on_setpoint(self, state: State) -> None:
        if not state.armed or state.shown.behaviour is not Behaviour.SETPOINTS:
            return
        # A velocity ends the take-off: on the ground that means it never begins.
        state.takeoff_s = None
        if state.airframe.height_m < _LIFTED_M:
            state.takeoff_suppressed = True

    def take_off(self, state: State, altitude_m: float) -> bool:
        if not state.armed or state.mode.name != "GUIDED" or not state.landed:
            return False
        if not math.isfinite(altitude_m) or altitude_m <= 0.0:
            return False
        if not state.takeoff_suppressed:
            state.takeoff_s, state.takeoff_from_m = state.t_s, state.estimator.pose.z_m
            state.takeoff_height_m = altitude_m
        return True

    def disarming_refused(self, state: State) -> None:
        """Without a word."""

    def base_mode(self, state: State) -> int:
        flags = m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | m.MAV_MODE_FLAG_STABILIZE_ENABLED
        flags |= m.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        # Where the horizontal position is controlled.
        if self.active(state) not in (Behaviour.COAST, Behaviour.DESCEND):
            flags |= m.MAV_MODE_FLAG_GUIDED_ENABLED
        return int(flags)

    def system_status(self, state: State) -> int:
        if state.critical or state.airframe.crashed:
            return int(m.MAV_STATE_CRITICAL)
        if state.landed:
            return int(m.MAV_STATE_STANDBY)
        return int(m.MAV_STATE_ACTIVE)

    def estimator_flags(self, state: State) -> int:
        if self.position_valid(state):
            return int(_VALID)
        # Before there was a position it takes itself for standing; afterwards it knows that it is lost.
        had = math.isfinite(state.estimator.alone_s(state.t_s)) and state.estimator.alone_s(state.t_s) >= LOST_S
        return int(_LOST if had else _WAITING)

    def battery_percent(self, state: State) -> float:
        return state.battery.counted_percent

    def battery_warning(self, state: State) -> int:
        return state.battery_level

    def stop_s(self, state: State) -> float:
        """Of the time constant of its jerk-limited control: acceleration over jerk."""
        if state.shown.name in _STOP_S:
            return _STOP_S[state.shown.name]
        jerk_mps3 = max(0.1, state.parameters["PSC_JERK_XY"])
        braking = state.shown.name == "BRAKE"
        acceleration_mps2 = _BRAKE_ACCELERATION_MPS2 if braking else state.parameters["WPNAV_ACCEL"] / 100.0
        return float((_LEAST_STOP_S**4 + (0.96 * acceleration_mps2 / jerk_mps3) ** 4) ** 0.25)

    def spool_s(self, state: State) -> float:  # noqa: ARG002
        return 0.0

    def lift_s(self, state: State) -> float:  # noqa: ARG002
        return 2.6

    def in_the_air(self, state: State) -> bool:
        return state.airframe.height_m > _SEEN_FLYING_M

    def tell_landed(self, state: State) -> None:
        """Without a word."""

    def lands_at(self, state: State) -> tuple[float, float, float] | None:  # noqa: ARG002
        return None

    def return_climb(self, state: State) -> tuple[float, float]:
        return state.parameters["RTL_ALT"] / 100.0, 1.5

    def return_mps(self, state: State) -> float:
        return state.parameters["WPNAV_SPEED"] / 100.0

    def active(self, state: State) -> Behaviour:
        behaviour = state.shown.behaviour
        if behaviour in (Behaviour.LAND, Behaviour.RETURN) and not self.position_valid(state):
            return Behaviour.DESCEND
        if behaviour is not Behaviour.SETPOINTS:
            return behaviour
        if state.paused:
            return Behaviour.HOLD
        if state.takeoff_s is not None:
            return Behaviour.TAKEOFF
        fresh = state.target_age_s() < state.parameters["GUID_TIMEOUT"]
        return Behaviour.SETPOINTS if fresh and state.airframe.height_m >= _LIFTED_M else Behaviour.HOLD

    def shows_receiver(self, state: State) -> bool:
        """From the first word of a transmitter on, for good."""
        return state.transmitter.heard_s is not None

    def supervise(self, state: State) -> None:
        self._watch_boot(state)
        if not state.armed:
            return
        pose, to_m = state.estimator.pose, state.takeoff_from_m + state.takeoff_height_m
        if state.takeoff_s is not None and pose.z_m >= to_m - 0.02 and pose.vz_mps < 0.2:
            state.takeoff_s = None
            state.hold_m = (pose.x_m, pose.y_m, to_m)
        landing = state.flown and state.shown.behaviour in (Behaviour.LAND, Behaviour.RETURN)
        limit_s = 2.0 if landing else state.parameters["DISARM_DELAY"]
        if limit_s > 0.0 and state.on_ground_s > limit_s:
            state.disarm("Disarming motors")

    def _watch_boot(self, state: State) -> None:
        since_s = state.since_boot_s
        if not state.ready and since_s >= _READY_S * state.hurry:
            state.ready = True
            state.say(MavSeverity.INFO, "ArduPilot Ready")
            # The mode switch is read now, whatever was set before.
            if state.mode.name != self.boot_mode and not state.armed:
                state.enter(self.modes[self.boot_mode])
        if not state.armed and since_s >= state.complains_s:
            state.complains_s = max(since_s, state.complains_s) + _COMPLAINS_S
            for words in self._complaints(state):
                state.say(MavSeverity.CRITICAL, f"PreArm: {words}")


ARDUPILOT = _ArduPilot()
"""The ArduCopter personality."""
