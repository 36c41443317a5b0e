"""What makes one autopilot different from the other: numbers, names, and the few rules that differ in kind."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from sitl.autopilot.mavlink import Message
from sitl.autopilot.parameters import Encoding, Kind
from sitl.autopilot.state import Behaviour, Mode, State


@dataclass(frozen=True, slots=True)
class Numbers:
    """The measured numbers of one autopilot."""

    natural_radps: float
    damping: float
    velocity_gain: float
    drift_mps: float
    blind_drift_mps2: float
    spool_s: float
    climb_mps: float


class Personality(ABC):
    """One kind of autopilot. It has no memory of its own: that is the `State`."""

    name: str
    autopilot: int
    """MAV_AUTOPILOT in the heartbeat."""
    encoding: Encoding
    integer: Kind
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
    hovering_frames: frozenset[int]
    """Frames in which a setpoint is taken as zero velocity."""
    sync_period_s: float
    synchronises_odometry: bool
    """Whether odometry stamps are turned into own time by TIMESYNC, once that has converged."""
    acknowledges_set_mode: bool
    position_before_fix: bool
    """Whether LOCAL_POSITION_NED comes before there is a position."""

    def mode(self, custom_mode: int) -> Mode | None:
        """The mode of that number."""
        return next((mode for mode in self.modes.values() if mode.custom_mode == custom_mode), None)

    @abstractmethod
    def custom_mode(self, main: float, sub: float) -> int | None:
        """What DO_SET_MODE's two numbers mean; ``None`` when nothing."""

    @abstractmethod
    def gps_used(self, state: State) -> bool:
        """Whether the estimate comes from GPS."""

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
    def arming_refusal(self, state: State) -> str | None:
        """Why it does not arm now."""

    @abstractmethod
    def mode_refusal(self, state: State, mode: Mode) -> str | None:
        """Why this mode cannot be taken now."""

    @abstractmethod
    def on_setpoint(self, state: State) -> None:
        """A usable velocity setpoint has come."""

    @abstractmethod
    def take_off(self, state: State, altitude_m: float) -> str | None:
        """Begins a take-off; ``altitude_m`` is the command's parameter 7, NaN when not given. Why not, if refused."""

    @abstractmethod
    def supervise(self, state: State) -> None:
        """Failsafes and changes of mode that come by themselves, once a step."""

    def active(self, state: State) -> Behaviour:
        """What is flown now."""
        return state.shown.behaviour
