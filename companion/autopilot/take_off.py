"""From the ground to the measured height. Each autopilot has its own order of steps; the height is measured by us.

PX4 with GPS: hold, arm, take off. PX4 without GPS: it may have no global origin, without which it cannot hold, so it
arms in offboard and climbs by our setpoints. ArduPilot: guided (it does not arm in brake), arm, take off, and no
setpoint before it flies: velocity setpoints suppress the take-off.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

from companion.autopilot.interface import Link
from companion.autopilot.mode_control import POLL_S, FlightError, ModeControl, ModeRefused
from companion.autopilot.offboard import OffboardControl
from companion.clock import Clock
from companion.config.settings import Settings
from companion.control import laws
from companion.control.ramp import Ramp
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.mode_monitor import DISARMED
from companion.model import Setpoint

NEAR_M = 0.2
"""Within this of the height asked for ..."""
SETTLED_S = 1.0
"""... for this long, it is reached."""
LIFTED_M = 0.2
"""Higher than this above where it stood, the vehicle flies."""
RISING_M = 0.05
STALLED_S = 2.0
"""PX4 ends its take-off below the height and then creeps; when it rises less than `RISING_M` in this time we go on."""
LEAD_M = 0.4
"""PX4's take-off is taken over so far below the height: it counts from an altitude that may have drifted since the
boot, and rose to 2.65 m instead of 1.5 m, into a roof. ArduPilot's ends by itself; it is taken over when too high."""
BLIND_RISE_M = 0.5
"""Near the ground the beam may see nothing yet: so far the climb may go on by the autopilot's own estimate."""
TAKE_OFF_HEIGHT = "MIS_TAKEOFF_ALT"

_log = logging.getLogger(__name__)
Height = Callable[[], float | None]


class TakeOff:
    """One take-off.

    Args:
        settings: the whole configuration; the climb by our own setpoints is the height law (6).
        measured_m: the measured height above ground, None while it is not known.
        risen_m: how far the autopilot's own estimate has risen since it was armed, None when it is not known.
    """

    def __init__(
        self,
        link: Link,
        clock: Clock,
        modes: ModeControl,
        offboard: OffboardControl,
        settings: Settings,
        measured_m: Height,
        risen_m: Height,
    ) -> None:
        self._link = link
        self._clock = clock
        self._modes = modes
        self._offboard = offboard
        self._law = settings.control
        self._ramp = Ramp(self._law.max_accel_mps2, POLL_S)
        self._gps = settings.autopilot.gps
        self._timeout_s = settings.mission.take_off_timeout_s
        self._takes_over_m = -LEAD_M if link.kind is AutopilotKind.PX4 else NEAR_M
        self._measured_m = measured_m
        self._risen_m = risen_m

    async def run(self, height_m: float) -> None:
        """Arm and climb until the measured height has stayed within 0.2 m of ``height_m`` for 1 s.

        Args:
            height_m: above ground.

        Raises as `ModeControl` does, and FlightError when it is not reached in time.
        """
        modes, began_s = self._modes, self._clock.now_s()
        if modes.armed:
            raise FlightError("cannot take off: the vehicle is armed already, and not by this application")
        if self._link.kind is AutopilotKind.ARDUPILOT:
            await modes.offboard()
            await modes.arm()
            await modes.take_off(*(0.0,) * 6, height_m)
        elif self._gps:
            await modes.hold()
            await self._set_height(height_m)
            await modes.arm()
            # Not finite: here, as high as its parameter says.
            await modes.take_off(0.0, 0.0, 0.0, *(math.nan,) * 4)
        else:
            await self._offboard.engage()
            await self._offboard.while_still(modes.arm())
        await self._climb(height_m, began_s)

    async def take_over(self, height_m: float) -> None:
        """Climb or sink to the height as `run` does, with a vehicle that its own mission hands over in the air."""
        began_s = self._clock.now_s()
        if not self._modes.armed:
            raise FlightError("cannot take the vehicle over: it is not armed")
        # Before it is asked for: whatever goes wrong from then on, it may follow us, and must not be left flying.
        self._modes.take_charge()
        try:
            await self._offboard.engage()
        except ModeRefused:
            self._modes.give_back()
            raise
        await self._climb(height_m, began_s)

    async def _set_height(self, height_m: float) -> None:
        link = self._link
        found = await link.get_param(TAKE_OFF_HEIGHT)
        if found is None:
            _log.warning("the autopilot has no %s: it takes off to a height of its own", TAKE_OFF_HEIGHT)
        elif not math.isclose(found, height_m, abs_tol=0.01):
            await link.set_param(TAKE_OFF_HEIGHT, height_m)

    async def _climb(self, height_m: float, began_s: float) -> None:
        modes, clock = self._modes, self._clock
        ground_m = self._measured_m() or 0.0
        highest_m, highest_s = -math.inf, clock.now_s()
        near_s: float | None = None
        while True:
            now_s, now_m = clock.now_s(), self._measured_m()
            if modes.taken_over == DISARMED:
                raise modes.failure("the autopilot disarmed before the height was reached", began_s)
            modes.check_ours()
            if now_s - began_s > self._timeout_s:
                shown = "not measured" if now_m is None else f"{now_m:.2f} m"
                raise modes.failure(
                    f"{height_m:g} m above ground not reached within {self._timeout_s:g} s: the height is {shown}",
                    began_s,
                )
            if now_m is not None and now_m > highest_m + RISING_M:
                highest_m, highest_s = now_m, now_s
            if now_m is None or abs(now_m - height_m) > NEAR_M:
                near_s = None
            elif near_s is None:
                near_s = now_s
            elif now_s - near_s >= SETTLED_S:
                return
            if self._offboard.engaged:
                self._offboard.send(self._ramp.limit(Setpoint(now_s, 0.0, self._climb_mps(height_m, now_m), 0.0)))
            elif now_m is not None and now_m > height_m + self._takes_over_m:
                _log.info("taking over the autopilot's take-off at %.2f m", now_m)
                await self._offboard.engage()
            elif near_s is None and highest_m > ground_m + LIFTED_M and now_s - highest_s > STALLED_S:
                _log.info("the autopilot's take-off ended at %.2f m: climbing on by setpoints", highest_m)
                await self._offboard.engage()
            await clock.sleep(POLL_S)

    def _climb_mps(self, height_m: float, now_m: float | None) -> float:
        """The height law (6) of the paper; nothing when the height is not known, except near the ground."""
        if now_m is None:
            now_m = self._risen_m()
            if now_m is None or now_m > BLIND_RISE_M:
                return 0.0
        return laws.climb_mps(height_m, now_m, None, 0.0, self._law)
