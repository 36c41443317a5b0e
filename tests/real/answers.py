"""What the real PX4 and the real ArduCopter answer, in their simulators, and how far an answer may be from it.

PX4: v1.17.0-alpha1, SIH. ArduCopter: 4.7.0-dev, SITL. The stub has to answer the same; where it does not,
`STUB_DIFFERS` says so, and a test sees to it that nothing stands there that is no longer so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Expected:
    """An answer.

    Attributes:
        answer: that of the real one: a value, or values by name.
        within: a number may differ by so much.
        share: or by this share of it.
    """

    answer: Any
    within: float = 0.0
    share: float = 0.0

    def met_by(self, answer: Any) -> bool:
        """Whether an answer is the same, as far as it has to be."""
        if isinstance(self.answer, Mapping):
            return isinstance(answer, Mapping) and all(
                Expected(value, self.within, self.share).met_by(answer.get(name)) for name, value in self.answer.items()
            )
        if isinstance(answer, int | float) and not isinstance(answer, bool) and (self.within or self.share):
            slack = max(self.within, self.share * abs(self.answer))
            return math.isfinite(answer) and abs(answer - self.answer) <= slack
        return bool(answer == self.answer)


ON_THE_GROUND: dict[str, dict[str, Expected]] = {
    "px4": {
        "arming refused: results": Expected([1]),
        "arming refused: says why": Expected(True),
        "rates, Hz": Expected(
            {
                "LOCAL_POSITION_NED": 30.0,
                "ATTITUDE": 99.0,
                "SYS_STATUS": 5.0,
                "GLOBAL_POSITION_INT": 50.0,
                "EXTENDED_SYS_STATE": 10.0,
                "GPS_RAW_INT": 8.0,
            },
            share=0.25,
        ),
        "heartbeat: type, base_mode, status": Expected((2, 29, 3)),
        "parameter types": Expected(
            {"COM_OF_LOSS_T": 9, "COM_OBL_RC_ACT": 6, "EKF2_EV_CTRL": 6, "MPC_XY_VEL_MAX": 9, "NAV_RCL_ACT": 6}
        ),
        "unknown parameter": Expected(None),
        "unknown interval: results": Expected([4]),
        "unknown command: results": Expected([3]),
        # A mode that there is not is accepted on the ground, and so is every other.
        "unknown mode: results": Expected([0, 0]),
        "hold on the ground: results": Expected([0, 0]),
        "estimator flags on the ground": Expected(1023),
        "forwards to the companion": Expected(True),
        "texts reach the companion": Expected(False),
    },
    "ardupilot": {
        "arming refused: results": Expected([4]),
        "arming refused: says why": Expected(True),
        "rates, Hz": Expected(
            {
                "LOCAL_POSITION_NED": 0.0,
                "ATTITUDE": 0.0,
                "SYS_STATUS": 0.0,
                "GLOBAL_POSITION_INT": 0.0,
                "EXTENDED_SYS_STATE": 10.0,
                "GPS_RAW_INT": 0.0,
            },
            share=0.25,
            within=0.1,
        ),
        "heartbeat: type, base_mode, status": Expected((2, 81, 3)),
        "parameter types": Expected(
            {
                "GUID_TIMEOUT": 9,
                "GUID_OPTIONS": 6,
                "AVOID_ENABLE": 2,
                "FS_THR_ENABLE": 2,
                "BATT_LOW_VOLT": 9,
                "RTL_ALT": 6,
            }
        ),
        "unknown parameter": Expected(None),
        "unknown interval: results": Expected([2]),
        "unknown command: results": Expected([3]),
        "unknown mode: results": Expected([4]),
        "hold on the ground: results": Expected([0]),
        "estimator flags on the ground": Expected(831),
        "forwards to the companion": Expected(True),
        "texts reach the companion": Expected(True),
    },
}
"""Without a flight."""

IN_FLIGHT: dict[str, dict[str, Expected]] = {
    "px4": {
        "take-off: 0.05 m after, s": Expected(4.2, within=0.8),
        "take-off: 0.5 m after, s": Expected(5.0, within=0.8),
        "take-off: 1.2 m after, s": Expected(7.5, within=2.0),
        "estimator flags in the air": Expected(895),
        "offboard: results": Expected([0, 0]),
        "zero velocity: from, m/s": Expected(0.46, within=0.1),
        "zero velocity: way, m": Expected(0.42, within=0.2),
        "silence: way, m": Expected(0.55, within=0.2),
        "hold: way, m": Expected(0.40, within=0.15),
        "land: way, m": Expected(0.5, within=0.25),
        "pause: results": Expected([3]),
        "pause: stands": Expected(False),
        "landing: disarmed after, s": Expected(5.0, within=3.0),
    },
    "ardupilot": {
        "take-off: 0.05 m after, s": Expected(3.7, within=1.0),
        "take-off: 0.5 m after, s": Expected(4.3, within=1.0),
        "take-off: 1.2 m after, s": Expected(5.1, within=1.0),
        "estimator flags in the air": Expected(831),
        "offboard: results": Expected([0]),
        "zero velocity: from, m/s": Expected(0.505, within=0.03),
        "zero velocity: way, m": Expected(0.33, within=0.1),
        "silence: way, m": Expected(0.52, within=0.08),
        "hold: way, m": Expected(0.70, within=0.1),
        "land: way, m": Expected(0.31, within=0.06),
        "pause: results": Expected([0]),
        "pause: stands": Expected(True),
        "landing: disarmed after, s": Expected(2.1, within=1.5),
    },
}
"""With one: at 0.5 m/s asked for, each stop from there, ways until 4 s after the order."""

STUB_DIFFERS: dict[str, frozenset[str]] = dict.fromkeys(("px4", "ardupilot"), frozenset({"rates, Hz"}))
"""Questions to which the stub's answer is another: it has one rate for all connections, and the world asks for more."""


def wrong(expected: Mapping[str, Expected], answers: Mapping[str, Any]) -> dict[str, str]:
    """The questions that were answered otherwise, and how; those without an answer too."""
    return {
        question: f"expected {one.answer}, got {answers.get(question, 'nothing')}"
        for question, one in expected.items()
        if question not in answers or not one.met_by(answers[question])
    }
