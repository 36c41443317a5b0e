"""The driver `mavlink`: ranges from the autopilot, as DISTANCE_SENSOR and OBSTACLE_DISTANCE.

Both are stamped with their time of arrival: their own stamps say, depending on the sender, when the sensor measured,
when the message was made, or nothing. They are used only to tell a repetition from a new reading.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from companion.autopilot.interface import Link, LinkError, Message
from companion.clock import Clock
from companion.config.settings import Settings
from companion.errors import InputError
from companion.frames import bearing_from_frd
from companion.mavlink.ids import MavCmd, MavFrame
from companion.model import Beam, RangeReading
from companion.sensors.drivers.choice import Choice, Wanted
from companion.sensors.drivers.driver import DriverContext
from companion.sensors.sink import PLANAR, RawPlanar, SensorSink

DISTANCE, OBSTACLES = "DISTANCE_SENSOR", "OBSTACLE_DISTANCE"
MESSAGE_IDS = {DISTANCE: 132, OBSTACLES: 330}

BEAMS = {0: Beam.FRONT, 2: Beam.RIGHT, 4: Beam.BACK, 6: Beam.LEFT, 24: Beam.UP, 25: Beam.DOWN}
"""MAV_SENSOR_ORIENTATION; turns are clockwise, so 90° of yaw is the right."""

INVALID_SIGNAL = 1
"""``signal_quality`` of a failed reading; 0 says that the quality is not known."""

UNKNOWN_CM = 65535
BINS = 72
RAY_DEG = 1.0
"""A sector of OBSTACLE_DISTANCE becomes rays about this far apart: it speaks for its whole width."""

TOUCHING_M = 0.01
"""0 in OBSTACLE_DISTANCE is an obstacle that touches; a planar scan of ours means by it that nothing was measured."""

MALFORMED, REPEATED, WRONG_FRAME = "malformed message", "repeated or out of order", "bearings not from the heading"

SILENT_S, ASK_AGAIN_S = 2.0, 5.0
"""What has not come for the first is asked for, with the second between questions: the autopilot may have rebooted."""

RESTARTED_S = 1.0
"""After this long without a reading, stamps that begin lower are those of a restarted sender."""

MOST_SENDERS = 64

_log = logging.getLogger(__name__)


def create(settings: Settings, context: DriverContext) -> MavlinkDriver:
    """The entry point: beams always, the scan around where ``sensors.planar.enabled``.

    Raises:
        InputError: there is no link to an autopilot.
    """
    if context.link is None:
        raise InputError("sensors.drivers: mavlink needs the link to an autopilot, and here there is none")
    planar = settings.sensors.planar
    rates_hz = {DISTANCE: settings.sensors.beams.rate_hz}
    if planar.enabled:
        rates_hz[OBSTACLES] = planar.rate_hz
    chosen = settings.sensors.mavlink
    wanted = {
        Beam.DOWN: Wanted(chosen.down_component, chosen.down_id),
        Beam.UP: Wanted(chosen.up_component, chosen.up_id),
    }
    return MavlinkDriver(context.link, context.clock, rates_hz, wanted)


class MavlinkDriver:
    """Ranges in MAVLink messages, from the autopilot or any other component of our vehicle.

    Args:
        rates_hz: wanted rate of each message that is to be taken, by its name.
        wanted: which sensor is believed for a direction, where several look there.
    """

    name = "mavlink"

    def __init__(
        self, link: Link, clock: Clock, rates_hz: Mapping[str, float], wanted: Mapping[Beam, Wanted] | None = None
    ) -> None:
        self._link = link
        self._clock = clock
        self._rates_hz = rates_hz
        self._sink: SensorSink | None = None
        self._subscribed = False
        self._arrived_s = dict.fromkeys(rates_hz, -math.inf)
        self._answers: dict[str, str] = {}
        self._choice = Choice(wanted or {})
        self._senders: dict[tuple[object, ...], tuple[float, float]] = {}  # stamp in ms, arrival

    async def run(self, sink: SensorSink) -> None:
        """Take readings as they come, until cancelled; ask for messages that do not come unasked."""
        self._sink = sink
        if not self._subscribed:
            self._subscribed = True
            takers = {DISTANCE: self._take_distance, OBSTACLES: self._take_obstacles}
            for name in self._rates_hz:
                self._link.events(name, self._handler(takers[name]), anyone=True)
        try:
            while True:
                # The first readings get the chance to come unasked.
                await asyncio.sleep(SILENT_S)
                await self._ask()
                await asyncio.sleep(ASK_AGAIN_S - SILENT_S)
        finally:
            self._sink = None

    async def _ask(self) -> None:
        for name, rate_hz in self._rates_hz.items():
            if self._clock.now_s() - self._arrived_s[name] <= SILENT_S:
                continue
            try:
                result = await self._link.command(MavCmd.SET_MESSAGE_INTERVAL, float(MESSAGE_IDS[name]), 1e6 / rate_hz)
                answer = f"asked for {name} at {rate_hz:g} Hz: result {result}"
            except LinkError as error:
                answer = f"{name} does not come and cannot be asked for: {error}"
            # An autopilot without such a sensor says the same for the whole flight.
            if self._answers.get(name) != answer:
                self._answers[name] = answer
                _log.info(answer)

    def _handler(self, take: Callable[[Message, SensorSink], None]) -> Callable[[Message], None]:
        def handle(message: Message) -> None:
            # A rangefinder may be a component of its own; one of another vehicle says nothing about ours.
            if self._sink is not None and message.system_id == self._link.system_id:
                self._arrived_s[message.name] = message.received_s
                take(message, self._sink)

        return handle

    def _take_distance(self, message: Message, sink: SensorSink) -> None:
        fields = message.fields
        orientation = _number(fields, "orientation")
        beam = None if orientation is None else BEAMS.get(int(orientation))
        if beam is None:
            return
        now_cm, least_cm, most_cm = (
            _number(fields, name) for name in ("current_distance", "min_distance", "max_distance")
        )
        if now_cm is None or least_cm is None or most_cm is None or not 0.0 <= least_cm < most_cm <= UNKNOWN_CM:
            sink.drop(beam.value, MALFORMED)
            return
        if self._is_repeated(message, (beam, _number(fields, "id")), _number(fields, "time_boot_ms")):
            sink.drop(beam.value, REPEATED)
            return
        # Beyond its range a sensor measures nothing, and 65535 is what many say then.
        in_range = least_cm <= now_cm <= most_cm and 0.0 < now_cm < UNKNOWN_CM
        measured = in_range and _number(fields, "signal_quality") != INVALID_SIGNAL
        sender = (message.component_id, int(_number(fields, "id") or 0))
        why_not = self._choice.against(beam, sender, measured=measured)
        if measured and (told := self._choice.contradiction(beam, sender, now_cm / 100.0, message.received_s)):
            sink.warn(told)
        if why_not:
            sink.drop(beam.value, why_not)
            return
        range_m = now_cm / 100.0 if measured else None
        sink.ranges([RangeReading(beam, message.received_s, range_m, most_cm / 100.0)])

    def _take_obstacles(self, message: Message, sink: SensorSink) -> None:
        fields = message.fields
        if _number(fields, "frame") != MavFrame.BODY_FRD:
            sink.drop(PLANAR, WRONG_FRAME)
            return
        time_us = _number(fields, "time_usec")
        if self._is_repeated(message, (PLANAR,), None if time_us is None else time_us / 1000.0):
            sink.drop(PLANAR, REPEATED)
            return
        scan = planar_scan(fields, message.received_s)
        if scan is None:
            sink.drop(PLANAR, MALFORMED)
        else:
            sink.planar(scan)

    def _is_repeated(self, message: Message, what: tuple[object, ...], stamp_ms: float | None) -> bool:
        """Whether this reading, or a later one of the same sender, has been here before."""
        if not stamp_ms:
            return False  # many senders leave it at zero
        sender = (message.component_id, *what)
        last_ms, arrived_s = self._senders.get(sender, (-math.inf, -math.inf))
        if stamp_ms <= last_ms and message.received_s - arrived_s <= RESTARTED_S:
            return True
        if sender not in self._senders and len(self._senders) >= MOST_SENDERS:
            self._senders.clear()
        self._senders[sender] = (stamp_ms, message.received_s)
        return False


def planar_scan(fields: Mapping[str, Any], t_s: float) -> RawPlanar | None:
    """The sectors of an OBSTACLE_DISTANCE as rays; None when they make no sense.

    Each sector is centred on its bearing and gives its distance to every ray in it: somewhere in there is the obstacle.
    """
    offset_deg, most_cm = _number(fields, "angle_offset") or 0.0, _number(fields, "max_distance")
    width_deg = _number(fields, "increment_f") or _number(fields, "increment")
    distances = fields.get("distances")
    if width_deg is None or most_cm is None or not isinstance(distances, list | tuple):
        return None
    if (
        not 0.0 < width_deg <= 360.0
        or not 0.0 < most_cm <= UNKNOWN_CM
        or abs(offset_deg) > 360.0
        or not 0 < len(distances) <= BINS
    ):
        return None
    # Sectors beyond the full turn would say two things of one bearing.
    sectors = int(min(len(distances), 360.0 / width_deg + 1e-3))
    ranges_m = [_sector_m(distance, most_cm) for distance in distances[:sectors]]
    rays = max(1, math.ceil(width_deg / RAY_DEG))
    bearing_of: dict[float, float] = {}
    for sector, range_m in enumerate(ranges_m):
        for ray in range(rays):
            clockwise_deg = offset_deg + (sector + (ray + 0.5) / rays - 0.5) * width_deg
            bearing_of[bearing_from_frd(math.radians(clockwise_deg))] = range_m
    bearings_rad = sorted(bearing_of)
    return RawPlanar(
        t_s, np.array(bearings_rad), np.array([bearing_of[bearing] for bearing in bearings_rad]), most_cm / 100.0
    )


def _sector_m(distance: object, most_cm: float) -> float:
    """The range of a sector in m: NaN where unknown, the largest where no obstacle is."""
    cm = _finite(distance)
    if cm is None or cm < 0.0 or cm >= UNKNOWN_CM:
        return math.nan
    return most_cm / 100.0 if cm > most_cm else max(cm / 100.0, TOUCHING_M)


def _number(fields: Mapping[str, Any], name: str) -> float | None:
    return _finite(fields.get(name))


def _finite(value: object) -> float | None:
    """A number, or None for whatever else a message may hold: JSON turns a NaN into null."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
