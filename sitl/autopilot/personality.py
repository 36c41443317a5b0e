"""What makes one autopilot different from the other: numbers, names, and the few rules that differ in kind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Protocol

from sitl.autopilot.mavlink import Message
from sitl.autopilot.parameters import Encoding, Kind
from sitl.autopilot.state import Behaviour, Mode, State


@dataclass(frozen=True, slots=True)
class Numbers:
    """The measured numbers of one autopilot.

    Attributes:
        damping: of the horizontal velocity response.
        velocity_gain: share of a commanded velocity that is flown.
        drift_mps: slow disturbance of each axis where no position is held.
        creep_mps: how fast it goes on in zero velocity, the way that it went.
        turning_drift: by how much both are more while it turns.
        blind_drift_mps2: how fast the velocity estimate goes wrong when nothing aids it,
        blind_mps: and between which speeds that ends.
        hold_climb_gain: of the height that a hold keeps, in 1/s.
        climb_mps: of a take-off,
        climb_approach: and of the last piece of it, in 1/s of what is missing.
        land_mps: of a landing, above its last metre.
        cells: of the battery, in series.
        capacity_mah: of the battery.
    """

    damping: float
    velocity_gain: float
    drift_mps: float
    creep_mps: float
    turning_drift: float
    blind_drift_mps2: float
    blind_mps: tuple[float, float]
    hold_climb_gain: float
    climb_mps: float
    climb_approach: float
    land_mps: float
    cells: int
    capacity_mah: float


class Watch(Protocol):
    """The failsafes of one vehicle since it booted, with what they remember."""

    def step(self, state: State, dt_s: float) -> None:
        """Looks at everything once; changes what is flown."""


class Personality(ABC):
    """One kind of autopilot. It has no memory of its own: that is the `State`."""

    name: str
    autopilot: int
    """MAV_AUTOPILOT in the heartbeat."""
    encoding: Encoding
    integer: Kind
    """Of a parameter that is an integer, unless"""
    kinds: ClassVar[Mapping[str, Kind]]
    """says otherwise by its name."""
    encoding_capability: int
    version: int
    numbers: Numbers
    ready_s: float
    """From boot until it arms with GPS."""
    modes: Mapping[str, Mode]
    boot_mode: str
    hold_mode: str
    """What the autopilot falls back to."""
    land_mode: str
    return_mode: str
    pilot_mode: str
    """What a pilot's switch selects."""
    setpoint_mode: str
    parameters: ClassVar[Mapping[str, float]]
    no_gps_parameters: ClassVar[Mapping[str, float]]
    """What a vehicle without GPS is set to."""
    rates_hz: ClassVar[Mapping[str, float]]
    """Messages that come unasked."""
    on_request: frozenset[str]
    """Messages that come when asked for."""
    refuses_interval: int
    """MAV_RESULT for a message it does not have."""
    refused: int
    """MAV_RESULT of an arming or a mode that is refused."""
    refuses_reboot: int
    velocity_frames: frozenset[int]
    drifting_frames: frozenset[int]
    """Frames in which a setpoint is taken, but not flown: it drifts."""
    sync_period_s: float
    synchronises_odometry: bool
    """Whether odometry stamps are turned into own time by TIMESYNC, once that has converged."""
    acknowledges_set_mode: bool
    """Whether the message SET_MODE gets an answer."""
    acknowledges_twice: bool
    """Whether DO_SET_MODE is acknowledged at once by who received it, and then by who carries it out."""
    position_before_fix: bool
    """Whether LOCAL_POSITION_NED comes before there is a position."""
    texts_only_to_ground_stations: bool
    """Whether STATUSTEXT leaves only where the heartbeat of a ground station was heard."""
    takes_what_nobody_takes: bool
    """Whether it carries out itself what is for another component of its system that it has heard nowhere."""
    transmitter_at_boot: bool
    """Whether its simulator has a transmitter."""
    no_channel_us: int
    """In RC_CHANNELS, of a channel that there is not."""
    takes_another_origin: bool
    """Whether an origin that is told replaces the one before it."""
    pauses: bool
    """Whether DO_PAUSE_CONTINUE freezes the mode that follows setpoints, without a word."""
    no_such_message: str | None
    """The text with which it denies the interval of a message that it does not have."""
    heartbeat_with_mode: bool
    """Whether a heartbeat leaves at once when the mode has changed."""
    armed_text: str
    disarmed_text: str

    def mode(self, custom_mode: int) -> Mode | None:
        """The mode of that number."""
        return next((mode for mode in self.modes.values() if mode.custom_mode == custom_mode), None)

    @abstractmethod
    def custom_mode(self, main: float, sub: float) -> int | None:
        """What DO_SET_MODE's two numbers mean; ``None`` when nothing."""

    @abstractmethod
    def new_watch(self) -> Watch:
        """The failsafes of a vehicle that boots."""

    @abstractmethod
    def gps_set_up(self, state: State) -> bool:
        """Whether the parameters say that the estimate comes from GPS."""

    @abstractmethod
    def position_valid(self, state: State) -> bool:
        """Whether the estimator has a horizontal position."""

    @abstractmethod
    def takes_odometry(self, state: State, message: Message) -> bool | None:
        """Whether this ODOMETRY or VISION_POSITION_ESTIMATE is used.

        Returns:
            True when its axes are north and east, False when its heading is arbitrary, ``None`` when it is ignored.
        """

    @abstractmethod
    def height_from_odometry(self, state: State) -> bool:
        """Whether the height follows the odometry; else it follows the barometer."""

    @abstractmethod
    def global_position(self, state: State) -> bool:
        """Whether it knows where on the globe it is."""

    @abstractmethod
    def arming_refusals(self, state: State) -> tuple[str, ...]:
        """Why it does not arm now, as it says it to who tries; nothing when it does."""

    @abstractmethod
    def tell_arming_refused(self, state: State) -> None:
        """Says otherwise than in a text that it does not arm."""

    @abstractmethod
    def mode_refusal(self, state: State, mode: Mode) -> str | None:
        """Why this mode cannot be taken now."""

    @abstractmethod
    def tell_mode_refused(self, state: State, mode: Mode, refusal: str, source: int | None) -> None:
        """Says so, to the component ``source`` that has asked; ``None`` where it does not matter who."""

    @abstractmethod
    def unknown_mode(self, state: State, number: int) -> int:
        """The MAV_RESULT of a mode that there is not."""

    @abstractmethod
    def on_setpoint(self, state: State) -> None:
        """A usable velocity setpoint has come."""

    @abstractmethod
    def take_off(self, state: State, altitude_m: float) -> bool:
        """Begins a take-off; ``altitude_m`` is the command's parameter 7, NaN when not given. Whether it does."""

    @abstractmethod
    def disarming_refused(self, state: State) -> None:
        """Says that it does not disarm in the air."""

    @abstractmethod
    def base_mode(self, state: State) -> int:
        """As the heartbeat shows it, but for the flag of an armed vehicle."""

    @abstractmethod
    def system_status(self, state: State) -> int:
        """MAV_STATE of the heartbeat."""

    @abstractmethod
    def estimator_flags(self, state: State) -> int:
        """ESTIMATOR_STATUS_FLAGS."""

    @abstractmethod
    def battery_percent(self, state: State) -> float:
        """What it believes to be left."""

    @abstractmethod
    def battery_warning(self, state: State) -> int:
        """0: none, 1: low, 2: critical, 3: emergency."""

    @abstractmethod
    def stop_s(self, state: State) -> float:
        """The time constant of the horizontal response, as what is flown now has it."""

    @abstractmethod
    def spool_s(self, state: State) -> float:
        """From arming until the motors begin to pull."""

    @abstractmethod
    def lift_s(self, state: State) -> float:
        """From there until it leaves the ground."""

    @abstractmethod
    def in_the_air(self, state: State) -> bool:
        """Whether the land detector of a landed vehicle would take it for flying."""

    @abstractmethod
    def tell_landed(self, state: State) -> None:
        """Says that the land detector has changed its mind."""

    @abstractmethod
    def lands_at(self, state: State) -> tuple[float, float, float] | None:
        """Where a landing goes, east and north in the frame of the estimate, and how fast; ``None``: it is in place."""

    @abstractmethod
    def return_climb(self, state: State) -> tuple[float, float]:
        """To which height above home a return climbs first, and how fast."""

    @abstractmethod
    def return_mps(self, state: State) -> float:
        """How fast a return flies home."""

    @abstractmethod
    def shows_receiver(self, state: State) -> bool:
        """Whether SYS_STATUS has the receiver among what is there, and RC_CHANNELS comes."""

    @abstractmethod
    def supervise(self, state: State) -> None:
        """Changes of mode that come by themselves, and disarming, once a step."""

    def active(self, state: State) -> Behaviour:
        """What is flown now."""
        return state.shown.behaviour
