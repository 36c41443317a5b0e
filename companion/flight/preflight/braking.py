"""The check that law and gate count on no more braking than was measured for the connected autopilot."""

from __future__ import annotations

from collections.abc import Iterator

from companion.config.settings import Settings
from companion.flight.preflight.result import CheckResult
from companion.mavlink.firmware import ARDUCOPTER_BRAKE_MPS2, AutopilotKind

BRAKING = "braking"
"""Name of the check."""


def braking(kind: AutopilotKind, settings: Settings) -> Iterator[CheckResult]:
    """The check of ``control.governor.brake_mps2`` with ArduPilot; none with PX4, for which the default was chosen.

    It does not ask for ``control.speed_law``: without the governor the gate still counts on the number, in the stopping
    budget, before its hard limit and before the fence.

    Args:
        kind: of the autopilot that is connected.
        settings: the whole configuration.
    """
    if kind is not AutopilotKind.ARDUPILOT:
        return
    counted_mps2 = settings.control.governor.brake_mps2
    ok = counted_mps2 <= ARDUCOPTER_BRAKE_MPS2
    yield CheckResult(
        BRAKING,
        ok,
        f"counted on: {counted_mps2:g} m/s²",
        f"at most {ARDUCOPTER_BRAKE_MPS2:g} m/s² with ArduPilot",
        f"ArduCopter was measured to brake with {ARDUCOPTER_BRAKE_MPS2:g} m/s²: with more in the settings it slows "
        "down too late, and the stopping budget does not hold.",
        ""
        if ok
        else f"set control.governor.brake_mps2: {ARDUCOPTER_BRAKE_MPS2:g} in the settings file (--fix changes only "
        f"parameters); if this vehicle was measured to brake harder, --skip {BRAKING}",
    )
