"""Telemetry of the autopilot: poses by its own clock, and the state of the vehicle."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Callable, Mapping

from companion.autopilot import global_origin, vehicle_state
from companion.autopilot.interface import Link, Message, Stream
from companion.autopilot.message_rates import MessageRates, ask, polled_ids, wanted_hz
from companion.autopilot.vehicle_state import PrearmState, StatusText, VehicleState, integer, number
from companion.clock import CRYSTAL_RATE, Clock, ClockAlignment
from companion.config.settings import Settings
from companion.frames import NedPose, pose_from_ned
from companion.mavlink.estimator import ESTIMATOR, estimator_valid
from companion.mavlink.ids import MavChargeState, MavCmd, MavModeFlag, MavState
from companion.mavlink.modes import mode_name
from companion.mavlink.position_jump import Motion, position_jump_m
from companion.model import ABSURD, Pose
from companion.pose_buffer import PoseBuffer
from companion.text_table import printable

PERIOD_S = 0.1
TIMESYNC_FIRST_S = 5.0
TIMESYNC_QUICK_S, TIMESYNC_S = 0.2, 1.0
"""Quick at first, while the clocks are not known well, and with an autopilot whose clock is a simulation's: how fast it
runs changes from second to second."""
UNCERTAIN_S = 0.02
VERSION_S = 5.0
QUESTIONS = 16
"""TIMESYNC questions that may be open; older ones are forgotten."""
TEXTS = 20
SAID_TWICE_S = 0.5
LONGEST_TEXT = 200
"""A STATUSTEXT has 50 bytes, and one in several pieces is not put together here."""
STALE_S = 3.0
"""Answers of the estimator and of the landing detector, asked for at 2 Hz, count no longer than this."""
SPEED_WINDOW_S, SPEEDS = 3.0, 1024
BATTERY_STALE_S = 10.0
BATTERIES = 16
"""Of which the state is kept; ArduPilot knows as many."""
OLDEST_S = 2.0
"""A pose that says to have been measured longer ago than `PoseBuffer` remembers is one sent again, or garbage."""
AUTOPILOT_VERSION_ID = 148
NANOSECONDS = 1e-9

_ATTITUDE = {"roll_rad": "roll", "pitch_rad": "pitch", "yaw_rad": "yaw", "yaw_rate_radps": "yawspeed"}
_POSITION = {"north_m": "x", "east_m": "y", "down_m": "z", "v_north_mps": "vx", "v_east_mps": "vy", "v_down_mps": "vz"}
"""Fields of `NedPose`, and of the messages that hold them."""


class Telemetry:
    """Feeds `poses` and knows the `state` of the vehicle. `run` asks the autopilot for what is missing.

    Poses are stamped with the autopilot's ``time_boot_ms``, moved to our clock by TIMESYNC round trips, which also tell
    how much faster or slower it runs. Where the answers are about another clock than ``time_boot_ms`` the least delay
    of the messages is used (`ClockAlignment`).

    Args:
        settings: the rates to ask for, and how far a position may be from where the last one leads.

    Attributes:
        poses: of the last seconds, in ENU/FLU.
        restarts: how often the autopilot's clock began anew.
        leaps: how often its estimate of the position did.
        malformed: messages without the numbers that they should have, or with absurd ones.
    """

    def __init__(self, link: Link, clock: Clock, settings: Settings) -> None:
        self.poses = PoseBuffer()
        self.restarts = 0
        self.leaps = 0
        self.malformed = 0
        self._link = link
        self._clock = clock
        self._jump_m = settings.safety.pose.jump_m
        self._alignment = ClockAlignment()
        self._rates = MessageRates(
            link, wanted_hz(link.kind, settings.autopilot, settings.mission), polled_ids(settings.autopilot)
        )
        self._questions: deque[tuple[int, float]] = deque(maxlen=QUESTIONS)  # ts1, when
        self._begun_s: float | None = None
        self._asked_time_s = -math.inf
        self._asked_version_s = -math.inf
        self._position: Pose | None = None
        self._speeds: deque[tuple[float, float]] = deque(maxlen=SPEEDS)  # when, m/s
        self._texts: deque[StatusText] = deque(maxlen=TEXTS)
        self._piece, self._whole = (0, 0), ""  # number and place of the newest piece, and the text up to it
        self._heartbeat: Message | None = None  # the newest that could be read
        self._heartbeats = link.watch("HEARTBEAT")
        self._version = link.watch("AUTOPILOT_VERSION")
        self._system = link.watch("SYS_STATUS")
        self._battery_status = link.watch("BATTERY_STATUS")
        self._landed = link.watch("EXTENDED_SYS_STATE")
        self._estimator = link.watch(ESTIMATOR[link.kind])
        self._origin = link.watch(global_origin.ORIGIN_MESSAGE)
        self._global_position = link.watch(global_origin.POSITION_MESSAGE)
        self._batteries: dict[int, Message] = {}  # the newest BATTERY_STATUS of each
        self._low_v = settings.mission.battery_low_v
        self._low_since_s: float | None = None
        link.events("HEARTBEAT", self._on_heartbeat)
        link.events("SYS_STATUS", self._on_voltage)
        link.events("BATTERY_STATUS", self._on_battery)
        link.events("ATTITUDE", self._on_attitude)
        link.events("LOCAL_POSITION_NED", self._on_position)
        link.events("TIMESYNC", self._on_timesync)
        link.events("STATUSTEXT", self._on_text)

    async def run(self) -> None:
        """Keep asking, until cancelled."""
        while True:
            self.ask(self._clock.now_s())
            await self._clock.sleep(PERIOD_S)

    def ask(self, now_s: float) -> None:
        """Ask for whatever is due at ``now_s``: rates, the time, the version."""
        if self._begun_s is None:
            self._begun_s = now_s
        self._rates.ask_where_missing(now_s)
        quick = now_s - self._begun_s < TIMESYNC_FIRST_S or self._clock_uncertain(now_s)
        if now_s - self._asked_time_s >= (TIMESYNC_QUICK_S if quick else TIMESYNC_S):
            self._ask_time(now_s)
        if self._version.newest is None and now_s - self._asked_version_s >= VERSION_S:
            self._asked_version_s = now_s
            ask(self._link, MavCmd.REQUEST_MESSAGE, float(AUTOPILOT_VERSION_ID))

    @property
    def clock_residual_s(self) -> float | None:
        """Bound of the error of what the autopilot stamps now, in s; None until its clock is aligned with ours."""
        return self._alignment.residual_s(self._clock.now_s())

    @property
    def clock_rate(self) -> float | None:
        """Seconds of the autopilot's clock in one of ours: 0.98 runs 2 % slow; None until it has been heard."""
        return self._alignment.rate

    @property
    def clock_round_trip_s(self) -> float | None:
        """The quickest TIMESYNC round trip of late; None when none is answered, or not by the clock of the stamps."""
        return self._alignment.round_trip_s

    @property
    def texts(self) -> tuple[StatusText, ...]:
        """The last STATUSTEXTs, oldest first."""
        return tuple(self._texts)

    def state(self, now_s: float) -> VehicleState:
        """Everything that is known at ``now_s``."""
        if self._heartbeats.newest is not None:
            # Its event may still be on the way.
            self._on_heartbeat(self._heartbeats.newest)
        heartbeat = self._heartbeat
        custom_mode = None if heartbeat is None else integer(heartbeat, "custom_mode")
        status = None if heartbeat is None else integer(heartbeat, "system_status")
        flags = 0 if heartbeat is None else integer(heartbeat, "base_mode") or 0
        pose = self.poses.newest()
        landed = _fresh(self._landed, now_s, STALE_S)
        system = _fresh(self._system, now_s, STALE_S)
        estimator = _fresh(self._estimator, now_s, STALE_S)
        estimator_flags = None if estimator is None else integer(estimator, "flags")
        return VehicleState(
            armed=bool(flags & MavModeFlag.SAFETY_ARMED),
            mode="unknown" if custom_mode is None else mode_name(self._link.kind, custom_mode),
            landed=None if landed is None else vehicle_state.landed(landed),
            battery_percent=self._battery(vehicle_state.battery_percent, now_s),
            heartbeat_age_s=math.inf if heartbeat is None else now_s - heartbeat.received_s,
            pose_age_s=math.inf if pose is None else now_s - pose.t_s,
            position_valid=estimator_flags is not None and estimator_valid(self._link.kind, estimator_flags),
            version=None if self._version.newest is None else vehicle_state.version(self._version.newest),
            estimator_flags=estimator_flags,
            origin_set=self._origin.age_s(now_s) <= global_origin.HEARD_S,
            voltage_v=self._battery(vehicle_state.voltage_v, now_s),
            low_voltage_s=0.0 if self._low_since_s is None else max(0.0, now_s - self._low_since_s),
            charge_state=self._charge_state(now_s),
            critical=status in (MavState.CRITICAL, MavState.EMERGENCY),
            prearm=PrearmState.UNKNOWN if system is None else vehicle_state.prearm(self._link.kind, system),
            speed_mps=self._median_speed_mps(now_s),
            global_position=self._global_position.age_s(now_s) <= global_origin.HEARD_S,
        )

    def _battery(self, read: Callable[[Message], float | None], now_s: float) -> float | None:
        """What one of the two messages of a battery says, the lesser of all batteries first."""
        for stream in (self._system, self._battery_status):
            message = _fresh(stream, now_s, BATTERY_STALE_S)
            value = None if message is None else read(message)
            if value is not None:
                return value
        return None

    def _clock_uncertain(self, now_s: float) -> bool:
        residual_s, rate = self._alignment.residual_s(now_s), self._alignment.rate
        return residual_s is None or residual_s > UNCERTAIN_S or rate is None or abs(rate - 1.0) > CRYSTAL_RATE

    def _charge_state(self, now_s: float) -> MavChargeState | None:
        """The worst that is told of any battery; charging is none that matters."""
        fresh = [one for one in self._batteries.values() if now_s - one.received_s <= BATTERY_STALE_S]
        states = [state for one in fresh if (state := vehicle_state.charge_state(one)) is not None]
        return max((state for state in states if state.is_low), default=min(states, default=None))

    def _median_speed_mps(self, now_s: float) -> float | None:
        recent = [speed_mps for t_s, speed_mps in self._speeds if t_s > now_s - SPEED_WINDOW_S]
        return statistics.median(recent) if recent else None

    def _on_battery(self, message: Message) -> None:
        number = integer(message, "id") or 0
        if 0 <= number < BATTERIES:
            self._batteries[number] = message
        self._on_voltage(message)

    def _on_voltage(self, message: Message) -> None:
        """A battery sags when the motors pull: only what stays low counts."""
        voltage_v = self._battery(vehicle_state.voltage_v, message.received_s)
        if self._low_v is None or (voltage_v is not None and voltage_v >= self._low_v):
            self._low_since_s = None
        elif voltage_v is not None and self._low_since_s is None:
            self._low_since_s = message.received_s

    def _ask_time(self, now_s: float) -> None:
        self._asked_time_s = now_s
        # Its own clock, so that the time is that of the sending and not that of a tick which began earlier.
        sent_s = self._clock.now_s()
        question = int(sent_s / NANOSECONDS)
        self._questions.append((question, sent_s))
        self._link.send("TIMESYNC", {"tc1": 0, "ts1": question})

    def _on_timesync(self, message: Message) -> None:
        answer, question = integer(message, "tc1"), integer(message, "ts1")
        if not answer or answer < 0:
            return  # a question of the autopilot's own
        for asked, sent_s in self._questions:
            if asked == question:
                self._questions.remove((asked, sent_s))
                self._alignment.add(sent_s, answer * NANOSECONDS, message.received_s)
                return

    def _stamp_s(self, message: Message) -> float | None:
        """When a message was measured, on our clock: never later than it arrived. None: not known, or long ago."""
        boot_ms = number(message, "time_boot_ms")
        restarts = self._alignment.restarts
        self._alignment.add_one_way(1e-3 * boot_ms, message.received_s)
        if self._alignment.restarts != restarts:
            self._restarted(message.received_s)
        stamp_s = self._alignment.to_local_s(1e-3 * boot_ms)
        if stamp_s is None or stamp_s < message.received_s - OLDEST_S:
            return None
        return min(stamp_s, message.received_s)

    def _restarted(self, now_s: float) -> None:
        self.restarts += 1
        self.poses.clear()
        self._position = None
        self._speeds.clear()
        self._questions.clear()
        self._rates.restart()
        self._begun_s = now_s

    def _on_attitude(self, message: Message) -> None:
        pose = self._pose(message, _ATTITUDE)
        if pose is not None:
            self.poses.add_attitude(pose.t_s, pose.roll_rad, pose.pitch_rad, pose.yaw_rad, pose.yaw_rate_radps)

    def _on_position(self, message: Message) -> None:
        pose = self._pose(message, _POSITION)
        if pose is None:
            return
        if self._position is not None and self._jumped(self._position, pose):
            self.leaps += 1
            self.poses.clear()
        if self._position is None or pose.t_s > self._position.t_s:
            self._position = pose
        self._speeds.append((pose.t_s, math.hypot(pose.vx_mps, pose.vy_mps, pose.vz_mps)))
        self.poses.add_position(pose.t_s, pose.x_m, pose.y_m, pose.z_m, pose.vx_mps, pose.vy_mps, pose.vz_mps)

    def _jumped(self, before: Pose, after: Pose) -> bool:
        """Whether the estimator has set the position anew."""
        return position_jump_m(_motion(before), _motion(after), after.t_s - before.t_s) > self._jump_m

    def _pose(self, message: Message, names: Mapping[str, str]) -> Pose | None:
        """The numbers of one message, in our frames; what it does not say is zero."""
        ned = {field: number(message, name) for field, name in names.items()}
        t_s = self._stamp_s(message)
        if t_s is None or not all(abs(value) < ABSURD for value in ned.values()):
            self.malformed += 1
            return None
        return pose_from_ned(NedPose(**(dict.fromkeys(NedPose.__slots__, 0.0) | ned | {"t_s": t_s})))

    def _on_heartbeat(self, message: Message) -> None:
        # One that cannot be read says neither that the vehicle disarmed, nor that the autopilot lives.
        if integer(message, "custom_mode") is not None and integer(message, "base_mode") is not None:
            self._heartbeat = message

    def _on_text(self, message: Message) -> None:
        text, severity = message.fields.get("text"), integer(message, "severity")
        if not isinstance(text, str) or severity is None:
            self.malformed += 1
            return
        piece = integer(message, "id") or 0, integer(message, "chunk_seq") or 0
        if 0 not in piece and self._texts and self._piece == (piece[0], piece[1] - 1):
            # What is longer than one message comes in pieces.
            self._texts.pop()
            text = self._whole + text
        self._piece, self._whole = piece, text[:LONGEST_TEXT]
        said = StatusText(message.received_s, severity, printable(self._whole.strip()))
        # PX4 says the same in STATUSTEXTs and in EVENTs where it has heard a ground station, several in a row.
        since_s = said.received_s - SAID_TWICE_S
        if not any(text.text == said.text and text.received_s >= since_s for text in self._texts):
            self._texts.append(said)


def _fresh(stream: Stream, now_s: float, longest_s: float) -> Message | None:
    return stream.newest if stream.age_s(now_s) <= longest_s else None


def _motion(pose: Pose) -> Motion:
    return pose.x_m, pose.y_m, pose.z_m, pose.vx_mps, pose.vy_mps, pose.vz_mps
