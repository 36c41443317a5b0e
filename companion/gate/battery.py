"""What the autopilot says of its battery, and when that is too little. Pure.

A percentage alone will not do: ArduPilot counts it from 100 % at each boot, whatever was plugged in. Voltage and the
autopilot's own warning do not depend on what the battery was taken for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from companion.mavlink.ids import MavChargeState, MavState

SAG_S = 5.0
"""A voltage must stay low for so long: it sags for a moment whenever the motors pull."""
UNKNOWN_MV = 65535
SPENT = frozenset(state for state in MavChargeState if state.is_low) - {MavChargeState.LOW}
"""What does not wait for a second opinion."""


class Battery:
    """Takes SYS_STATUS, BATTERY_STATUS and the heartbeat's ``system_status``.

    Args:
        least_percent: with less it is too little; 0: not judged.
        least_v: the same of the voltage; None: not judged.

    Attributes:
        percent: None when the autopilot does not say.
        voltage_v: None when it does not say.
    """

    def __init__(self, least_percent: float, least_v: float | None) -> None:
        self.percent: float | None = None
        self.voltage_v: float | None = None
        self._least_percent = least_percent
        self._least_v = least_v
        self._low_since_s = math.inf
        self._charge_state = 0
        self._critical = False

    def on_sys_status(self, fields: Mapping[str, Any], now_s: float) -> None:
        """One SYS_STATUS."""
        percent, millivolt = fields["battery_remaining"], fields["voltage_battery"]
        self.percent = percent if 0 <= percent <= 100 else None
        self.voltage_v = 1e-3 * millivolt if 0 < millivolt < UNKNOWN_MV else None
        if self.voltage_v is None or self._least_v is None or self.voltage_v >= self._least_v:
            self._low_since_s = math.inf
        else:
            self._low_since_s = min(self._low_since_s, now_s)

    def on_battery_status(self, fields: Mapping[str, Any]) -> None:
        """One BATTERY_STATUS; of the first battery: the others may be a payload's."""
        if fields["id"] == 0:
            self._charge_state = fields["charge_state"]

    def on_system_status(self, system_status: int) -> None:
        """Of one heartbeat."""
        self._critical = system_status in (MavState.CRITICAL, MavState.EMERGENCY)

    def too_little(self, now_s: float) -> str | None:
        """Why it has to land, in a few words; None: enough is left, as far as anybody says."""
        if self.percent is not None and self.percent < self._least_percent:
            return f"{self.percent:.0f} %"
        if self.voltage_v is not None and now_s - self._low_since_s >= SAG_S:
            return f"{self.voltage_v:.2f} V"
        if self._charge_state in SPENT:
            return "critical, says the autopilot"
        if self._charge_state == MavChargeState.LOW and self._critical:
            return "low, says the autopilot"
        return None
