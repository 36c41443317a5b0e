"""Everything that an autopilot remembers from one step to the next."""

from __future__ import annotations

import enum
import math
from collections import Counter, deque
from dataclasses import dataclass, field

from companion.mavlink.ids import MavSeverity
from sitl.autopilot.airframe import Airframe, Motion
from sitl.autopilot.battery import Battery
from sitl.autopilot.estimator import Estimator
from sitl.autopilot.events import Event
from sitl.autopilot.mavlink import Message
from sitl.autopilot.origin import GlobalPosition
from sitl.autopilot.parameters import Parameters

CHANNELS, NEUTRAL_US = 16, 1500
"""Of the transmitter."""


class Behaviour(enum.Enum):
    """What a mode does with the vehicle; several modes may do the same."""

    HOLD = "brakes and stays; also what a pilot's mode does with the sticks in the middle"
    COAST = "levels out, keeps its height, and rolls on"
    TAKEOFF = "climbs to the height that was asked for"
    LAND = "descends where it is, or where it believes that it is to land"
    DESCEND = "descends without knowing where it is"
    RETURN = "climbs, flies to where it was armed, and lands there"
    SETPOINTS = "follows a computer"


@dataclass(frozen=True, slots=True)
class Mode:
    """A flight mode: its number on the wire, what it does, and whether it may be armed in."""

    name: str
    custom_mode: int
    behaviour: Behaviour
    armable: bool = True


@dataclass(frozen=True, slots=True)
class Target:
    """A velocity setpoint as it was understood when it came: in the frame of the estimate, east-north-up."""

    t_s: float
    vx_mps: float
    vy_mps: float
    vz_mps: float
    yaw_rate_radps: float


@dataclass(frozen=True, slots=True)
class Obstacles:
    """OBSTACLE_DISTANCE: where the nearest obstacle is, clockwise from the nose."""

    t_s: float
    bearing_rad: float
    range_m: float


@dataclass(slots=True)
class Contact:
    """When somebody on whom a failsafe waits was last heard; ``lost`` until he is heard again."""

    heard_s: float | None = None
    lost: bool = True

    def heard(self, t_s: float) -> None:
        """He is there."""
        self.heard_s, self.lost = t_s, False

    def silent_for(self, t_s: float, limit_s: float) -> bool:
        """Whether he was there and is silent for longer than that; says so once."""
        if self.lost or self.heard_s is None or t_s - self.heard_s <= limit_s:
            return False
        self.lost = True
        return True


@dataclass
class State:
    """The autopilot's memory.

    ``mode`` is what was asked for, ``failsafe`` what is flown instead; a heartbeat shows `shown`.
    """

    boot_s: float
    t_s: float
    parameters: Parameters
    airframe: Airframe
    estimator: Estimator
    battery: Battery
    mode: Mode
    gps_present: bool
    hurry: float = 1.0
    """Share of the real waiting times after boot."""
    failsafe: Mode | None = None
    armed: bool = False
    armed_s: float = 0.0
    flown: bool = False
    """It has left the ground since it was armed."""
    on_ground_s: float = 0.0
    """For how long it has stood on the ground."""
    hold_m: tuple[float, float, float] | None = None
    takeoff_s: float | None = None
    takeoff_from_m: float = 0.0
    takeoff_height_m: float = 0.0
    takeoff_suppressed: bool = False
    target: Target | None = None
    went: tuple[float, float] = (0.0, 0.0)
    """The way of the last setpoint that was to move, of length 1, in the frame of the estimate."""
    target_times_s: deque[float] = field(default_factory=lambda: deque(maxlen=2))
    obstacles: Obstacles | None = None
    origin: GlobalPosition | None = None
    origin_s: float = math.inf
    home_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where it was armed, by the estimate."""
    landed: bool = True
    """What the land detector believes."""
    hover_s: float = 0.0
    """For how long the motors have pulled at a vehicle that is still on the ground."""
    mode_after_disarming: Mode | None = None
    transmitter: Contact = field(default_factory=Contact)
    transmitter_on: bool = False
    """Whether somebody holds a transmitter that is switched on."""
    channels_us: list[int] = field(default_factory=lambda: [NEUTRAL_US] * CHANNELS)
    """Pulses of the receiver: the sticks, throttle included, are in the middle, and all switches too."""
    ground_station: Contact = field(default_factory=Contact)
    companion: Contact = field(default_factory=Contact)
    ready: bool = False
    """ArduPilot has said that it is."""
    complains_s: float = 15.0
    """Since boot, when it says next why it would not arm."""
    returning_home: bool = False
    """A return has climbed as far as it wants to."""
    paused: bool = False
    """A ground station has frozen the mode that follows setpoints."""
    motion: Motion | None = None
    battery_level: int = 0
    """ArduPilot's battery failsafe: 0: none, 1: low, 2: critical."""
    critical: bool = False
    """A failsafe has triggered: the heartbeat says so."""
    texts: deque[tuple[MavSeverity, str]] = field(default_factory=lambda: deque(maxlen=32))
    events: deque[Event] = field(default_factory=lambda: deque(maxlen=32))
    later: deque[tuple[float, Message]] = field(default_factory=lambda: deque(maxlen=32))
    """Messages that leave not before their time."""
    heartbeat_due: bool = False
    """A heartbeat leaves at once: the mode has changed."""
    counts: Counter[str] = field(default_factory=Counter)
    """What was ignored, by reason; the reasons are a fixed set."""

    @property
    def shown(self) -> Mode:
        """The mode in the heartbeat."""
        return self.mode if self.failsafe is None else self.failsafe

    @property
    def since_boot_s(self) -> float:
        """Time since the autopilot started."""
        return self.t_s - self.boot_s

    @property
    def flying(self) -> bool:
        """Armed and off the ground."""
        return self.armed and not self.airframe.on_ground

    def say(self, severity: MavSeverity, text: str) -> None:
        """Queues a STATUSTEXT."""
        self.texts.append((severity, text))

    def tell(self, event: Event) -> None:
        """Queues an EVENT."""
        self.events.append(event)

    def enter(self, mode: Mode) -> None:
        """Takes a mode that was asked for."""
        self.mode = mode
        self.heartbeat_due = True
        self.paused = False
        self.settle()

    def settle(self) -> None:
        """Forgets what the mode before was about: where it held, where it was climbing to."""
        self.hold_m = None
        self.takeoff_s = None
        self.takeoff_suppressed = False
        self.returning_home = False

    def fall_back(self, mode: Mode | None) -> None:
        """Flies ``mode`` instead of what was asked for; ``None``: what was asked for again."""
        if self.failsafe is not mode:
            self.failsafe = mode
            self.settle()

    def disarm(self, text: str) -> None:
        """Stops the motors."""
        self.armed = False
        self.failsafe = None
        self.settle()
        self.say(MavSeverity.INFO, text)

    def target_age_s(self) -> float:
        """Since the last setpoint; infinite when none came."""
        return math.inf if self.target is None else self.t_s - self.target.t_s

    def streaming(self) -> bool:
        """Whether setpoints come more often than twice a second."""
        times = self.target_times_s
        return len(times) == 2 and times[1] - times[0] < 0.5 and self.t_s - times[1] < 0.5
