"""State of the vehicle as its autopilot reports it, and how its messages are read. Pure."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from companion.autopilot.interface import Message
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavChargeState, MavSysStatusSensor

NOT_MEASURED_MV = 65535
LARGEST_INTEGER, LARGEST_NUMBER = 2**64 - 1, 3.5e38
"""Of what MAVLink can say: 64-bit integers and 32-bit floats."""

_CHARGE_STATES = frozenset(MavChargeState) - {MavChargeState.UNDEFINED}
_VERSION_TYPES = ((255, ""), (192, "-rc"), (128, "-beta"), (64, "-alpha"), (0, "-dev"))


@dataclass(frozen=True, slots=True)
class StatusText:
    """One STATUSTEXT: severity 0 (emergency) to 7 (debug), as MAV_SEVERITY."""

    received_s: float
    severity: int
    text: str


class PrearmState(enum.StrEnum):
    """Whether the autopilot would be armed now, as it says itself. On PX4 that is about the mode that it is in."""

    UNKNOWN = "not told"
    OFF = "its arming checks are off"
    FAILING = "it would refuse to arm"
    PASSED = "it can be armed"


@dataclass(frozen=True, slots=True)
class VehicleState:
    """The vehicle at one moment, as far as it has reported. What is unknown or too old is None, or False where a bool.

    Attributes:
        armed: by the newest heartbeat, up to 1 s late.
        mode: as the users of the autopilot call it; "unknown" before the first heartbeat.
        landed: None when the autopilot does not say.
        battery_percent: 0 to 100; None when not measured. On ArduPilot a coulomb count from 100 % at each boot.
        heartbeat_age_s: infinite before the first.
        pose_age_s: of the newest complete pose, by the time at which it was measured.
        position_valid: the estimator knows attitude, velocity and a position (relative is enough, GPS is not needed).
        estimator_flags: in which it says so: ESTIMATOR_STATUS (PX4) or EKF_STATUS_REPORT (ArduPilot).
        origin_set: it says that it has an origin on the globe; asked for without GPS only.
        global_position: it says where on the globe it is; asked of PX4 without GPS only.
        voltage_v: of the battery; None when not measured.
        low_voltage_s: for how long it has been below ``mission.battery_low_v``; 0 when it is not, or is not judged.
        charge_state: the worst of its batteries as the autopilot judges them; None when it does not say.
        speed_mps: the median of what it says to move at, over the last 3 s; None when it does not say.
        prearm: what its own checks before arming say.
        critical: its heartbeat says critical or emergency: a failsafe of its own is at work.
        version: of the firmware, for example "1.15.0" or "4.7.0-dev".
    """

    armed: bool
    mode: str
    landed: bool | None
    battery_percent: float | None
    heartbeat_age_s: float
    pose_age_s: float
    position_valid: bool
    version: str | None
    estimator_flags: int | None = None
    origin_set: bool = False
    global_position: bool = False
    voltage_v: float | None = None
    low_voltage_s: float = 0.0
    charge_state: MavChargeState | None = None
    critical: bool = False
    prearm: PrearmState = PrearmState.UNKNOWN
    speed_mps: float | None = None


def number(message: Message, name: str) -> float:
    """A field as a number; NaN when it is missing or none."""
    value = message.fields.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    # An integer may be too large for a float.
    return float(value) if abs(value) <= LARGEST_NUMBER else math.nan


def integer(message: Message, name: str) -> int | None:
    """A field as an integer; None when it is missing or none."""
    value = message.fields.get(name)
    if isinstance(value, bool) or not isinstance(value, int):
        return None
    return value if abs(value) <= LARGEST_INTEGER else None


def landed(message: Message) -> bool | None:
    """Of an EXTENDED_SYS_STATE; taking off and landing are in the air."""
    state = integer(message, "landed_state")
    return None if state not in (1, 2, 3, 4) else state == 1


def battery_percent(message: Message) -> float | None:
    """Of a SYS_STATUS or BATTERY_STATUS; -1 on the wire is not measured."""
    percent = number(message, "battery_remaining")
    return percent if 0.0 <= percent <= 100.0 else None


def prearm(kind: AutopilotKind, message: Message) -> PrearmState:
    """Of a SYS_STATUS. PX4 does not say whether its checks are on."""
    enabled = integer(message, "onboard_control_sensors_enabled")
    healthy = integer(message, "onboard_control_sensors_health")
    if enabled is None or healthy is None:
        return PrearmState.UNKNOWN
    if kind is AutopilotKind.ARDUPILOT and not enabled & MavSysStatusSensor.PREARM_CHECK:
        return PrearmState.OFF
    return PrearmState.PASSED if healthy & MavSysStatusSensor.PREARM_CHECK else PrearmState.FAILING


def voltage_v(message: Message) -> float | None:
    """Of a SYS_STATUS, or of the cells of a BATTERY_STATUS: what is 0 or 65535 mV there is not measured."""
    cells = message.fields.get("voltages", [message.fields.get("voltage_battery")])
    if not isinstance(cells, list):
        return None
    total_mv = sum(cell for cell in cells if type(cell) is int and 0 < cell < NOT_MEASURED_MV)
    return 1e-3 * total_mv if total_mv > 0 else None


def charge_state(message: Message) -> MavChargeState | None:
    """Of a BATTERY_STATUS."""
    state = integer(message, "charge_state")
    return MavChargeState(state) if state in _CHARGE_STATES else None


def version(message: Message) -> str | None:
    """Of an AUTOPILOT_VERSION: major, minor, patch and the kind of release."""
    packed = integer(message, "flight_sw_version")
    if not packed:
        return None
    release = next(words for least, words in _VERSION_TYPES if packed & 0xFF >= least)
    return f"{packed >> 24 & 0xFF}.{packed >> 16 & 0xFF}.{packed >> 8 & 0xFF}{release}"
