"""What the two autopilots call things: modes by number and name, and what each needs to fly. Pure tables.

A mode is known by the ``custom_mode`` of the autopilot's HEARTBEAT. PX4 packs two numbers into it, main mode << 16 and
sub mode << 24; ArduPilot has one number.
"""

from __future__ import annotations

from dataclasses import dataclass

from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavModeFlag, MavResult

_RESULTS: dict[int, str] = {
    MavResult.ACCEPTED: "accepted",
    MavResult.TEMPORARILY_REJECTED: "rejected for now",
    MavResult.DENIED: "denied",
    MavResult.UNSUPPORTED: "unsupported",
    MavResult.FAILED: "failed",
    MavResult.IN_PROGRESS: "in progress",
    MavResult.CANCELLED: "cancelled",
}

_PX4_AUTO = 4
_PX4_MAIN = {
    1: "manual",
    2: "altitude",
    3: "position",
    5: "acro",
    6: "offboard",
    7: "stabilized",
    8: "rattitude",
    10: "termination",
    11: "altitude cruise",
}
_PX4_AUTO_SUB = {
    1: "ready",
    2: "takeoff",
    3: "hold",
    4: "mission",
    5: "return",
    6: "land",
    8: "follow",
    9: "precision land",
    10: "vtol takeoff",
}
_ARDUPILOT = {
    0: "stabilize",
    1: "acro",
    2: "alt_hold",
    3: "auto",
    4: "guided",
    5: "loiter",
    6: "rtl",
    7: "circle",
    9: "land",
    11: "drift",
    13: "sport",
    14: "flip",
    15: "autotune",
    16: "poshold",
    17: "brake",
    18: "throw",
    19: "avoid_adsb",
    20: "guided_nogps",
    21: "smart_rtl",
    22: "flowhold",
    23: "follow",
    24: "zigzag",
    25: "systemid",
    26: "autorotate",
    27: "auto_rtl",
    28: "turtle",
}


def px4_mode(main: int, sub: int = 0) -> int:
    """The ``custom_mode`` of a PX4 mode."""
    return main << 16 | sub << 24


@dataclass(frozen=True, slots=True)
class Personality:
    """The modes that we ask for, as ``custom_mode`` numbers.

    Attributes:
        kind: which autopilot.
        offboard: the mode in which it follows our setpoints.
        hold: the mode in which it stops and stays; ArduPilot does not arm in it (BRAKE).
        land: the mode in which it lands and disarms.
        taking_off: every mode that it may show between our take-off command and the height reached. PX4 changes from
            take-off to hold by itself, below the height asked for.
        mission: the mode in which it flies a mission that may hand it over (NAV_GUIDED_ENABLE); None: none does.
        streams_before_mode: whether setpoints must be streaming before the mode is taken (PX4), or must not be, since
            they suppress the take-off (ArduPilot).
    """

    kind: AutopilotKind
    offboard: int
    hold: int
    land: int
    taking_off: frozenset[int]
    mission: int | None
    streams_before_mode: bool

    def passing_to(self, custom_mode: int) -> frozenset[int]:
        """Modes that may show on the way to one that was asked for.

        When setpoints stop before it is taken, the autopilot's failsafe holds meanwhile.
        """
        return frozenset() if custom_mode == self.offboard else frozenset({self.hold})

    def set_mode_parameters(self, custom_mode: int) -> tuple[float, float, float]:
        """The first three parameters of DO_SET_MODE that ask for a mode."""
        flag = float(MavModeFlag.CUSTOM_MODE_ENABLED)
        if self.kind is AutopilotKind.PX4:
            return flag, float(custom_mode >> 16 & 0xFF), float(custom_mode >> 24 & 0xFF)
        return flag, float(custom_mode), 0.0


_PX4 = Personality(
    kind=AutopilotKind.PX4,
    offboard=px4_mode(6),
    hold=px4_mode(_PX4_AUTO, 3),
    land=px4_mode(_PX4_AUTO, 6),
    taking_off=frozenset({px4_mode(_PX4_AUTO, 2), px4_mode(_PX4_AUTO, 3)}),
    mission=None,
    streams_before_mode=True,
)
_ARDUCOPTER = Personality(
    kind=AutopilotKind.ARDUPILOT,
    offboard=4,
    hold=17,
    land=9,
    taking_off=frozenset({4}),
    mission=3,
    streams_before_mode=False,
)


def personality(kind: AutopilotKind) -> Personality:
    """The tables of an autopilot."""
    return _PX4 if kind is AutopilotKind.PX4 else _ARDUCOPTER


def mode_name(kind: AutopilotKind, custom_mode: int) -> str:
    """A mode as its autopilot's users call it; a number that is not in the table is named by its number."""
    if kind is AutopilotKind.ARDUPILOT:
        return _ARDUPILOT.get(custom_mode, f"mode {custom_mode}")
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    name = _PX4_AUTO_SUB.get(sub) if main == _PX4_AUTO else _PX4_MAIN.get(main)
    return name or f"mode {main}/{sub}"


def result_name(result: int) -> str:
    """A MAV_RESULT in words."""
    return _RESULTS.get(result, f"result {result}")
