"""Which autopilots we fly, and how they brake."""

from __future__ import annotations

import enum

from companion.mavlink.ids import MavAutopilot


class AutopilotKind(enum.StrEnum):
    """The firmware of the flight controller."""

    PX4 = "px4"
    ARDUPILOT = "ardupilot"


KINDS: dict[int, AutopilotKind] = {
    MavAutopilot.PX4: AutopilotKind.PX4,
    MavAutopilot.ARDUPILOTMEGA: AutopilotKind.ARDUPILOT,
}
"""MAV_AUTOPILOT of the heartbeat."""

MEASURED_BRAKE_MPS2 = 0.43
"""How both autopilots stop under zero velocity, and when setpoints stop: 0.15 s after the order they slow down by this
much, and from 0.3 to 0.56 m/s no measured stop was longer (PX4 0.22 m from 0.38 m/s, ArduCopter 0.35 m from 0.56 m/s),
but for what they creep on afterwards. From 0.5 to 2 m/s one of 48 was, by 0.1 m, in the noise of PX4's simulator
(`python -m validation.real.braking`); from 1 m/s on they brake harder: the way of a stop grows with v rather than with
v². Pre-flight refuses settings that count on more."""

MEASURED_HOLD_CREEP_M = {AutopilotKind.PX4: 0.25, AutopilotKind.ARDUPILOT: 0.15}
"""How far they go on in a mode of their own after they have braked. PX4's hold wandered by up to 0.26 m from where it
had stood (its simulator SIH, the worst of thirty stops). ArduCopter needed 0.04 m more than braking counts (the worst
of its stops in silence, in land, and by zero velocity and then hold, `python -m validation.real.braking`), and moved by
0.01 m in 10 s. Pre-flight refuses settings that count on less."""
