"""The safety gate: limits, thresholds and answers. Each reason at length is in docs/safety.md."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from companion.config.autopilot import LinkUrl
from companion.config.control import ControlSettings
from companion.config.reactions import Level, ReactionsSettings
from companion.config.section import Section, refuse
from companion.gate.plan import Limits
from companion.mavlink.link_url import LINK_FORMS

ABOVE_CONTROL: dict[Level, float] = {"normal": 1.1, "cautious": 1.05}
"""A limit that is left out is this many times what control asks for: what is above is not the law's."""
ACCEL_ABOVE_CONTROL: dict[Level, float] = {"normal": 2.0, "cautious": 1.5}
"""The same of the acceleration: two setpoints may come much closer to each other than they were made."""
PERIODS: dict[Level, float] = {"normal": 2.4, "cautious": 2.0}
"""A setpoint or a beat that is left out is late after so many periods: one may be lost, not two."""

Range = tuple[float, float]

CAUTIOUS: dict[str, dict[str, Any]] = {
    "stale": {
        "depth_s": 0.45,
        "ranges_s": 0.3,
        "pose_s": 0.15,
        "heartbeat_s": 2.5,
        "link_s": 0.3,
        "map_s": 15.0,
        "hang_s": 5.0,
    },
    "pose": {"jump_m": 0.3, "frozen_s": 0.2},
    "": {"messages_hz": 250.0, "battery_percent": 20.0, "recover_s": 3.0, "autopilot_delay_s": 0.25, "restarts": 1},
}
"""What `level: cautious` fills in, by section; what is not here it leaves as it is."""


def _absolute(path: str) -> str:
    if not PurePosixPath(path).is_absolute() or "\0" in path:
        raise PydanticCustomError("absolute_path", "an absolute path such as /etc/companion/signing.key")
    return path


class LimitSettings(Section):
    """What a setpoint may ask for. One that asks for more is replaced by a stop, not trimmed."""

    speed_mps: float | None = Field(
        None,
        gt=0.0,
        le=5.5,
        description="largest speed in the plane, in m/s; null: control.speed_mps and a tenth (cautious: a twentieth), "
        "since the law never asks for more than its own; the stopping budget counts with this one",
    )
    climb_mps: float | None = Field(
        None, gt=0.0, le=3.3, description="largest climb or descent rate, in m/s; null: control.max_climb_mps likewise"
    )
    yaw_rate_radps: float | None = Field(
        None, gt=0.0, le=3.3, description="largest yaw rate, in rad/s; null: control.max_yaw_rate_radps likewise"
    )
    accel_mps2: float | None = Field(
        None,
        ge=0.2,
        le=20.0,
        description="fastest growth of the commanded velocity between two setpoints, in m/s²; null: twice "
        "control.max_accel_mps2 (cautious: one and a half times), since ticks are not evenly spaced; slowing down is "
        "always allowed",
    )


class StaleSettings(Section):
    """From which age on something is too old. All ages are of the measurement, not of its arrival."""

    setpoint_s: float | None = Field(
        None,
        ge=0.03,
        le=2.0,
        description="no setpoint for this long is a fault, in s; null: 2.4 (cautious: 2) times control.period_s, 0.12 "
        "s at 20 Hz: one may be lost on the way, not two",
    )
    beat_s: float | None = Field(
        None,
        ge=0.03,
        le=2.0,
        description="no completed tick of the application for this long, in s; null: as for setpoint_s",
    )
    depth_s: float = Field(
        0.55,
        ge=0.05,
        le=5.0,
        description="age of the last look ahead, in s: of a camera with 5 Hz one frame may be lost, and the next be "
        "0.15 s on its way; beyond it a wall may have come into view unseen",
    )
    ranges_s: float = Field(
        0.4,
        ge=0.05,
        le=5.0,
        description="age of the oldest configured rangefinder, in s: just above sensors.beams.stale_after_s, from "
        "which on the law itself does without it",
    )
    pose_s: float = Field(
        0.25,
        ge=0.03,
        le=2.0,
        description="age of the autopilot's position, in s: every wall that is not in view is carried along by it",
    )
    aiding_s: float = Field(
        0.4,
        ge=0.2,
        le=10.0,
        description="the estimator's figures of merit unchanged for this long, in s: they change with each "
        "measurement, 30 or 50 odometries or 5 fixes a second; ArduCopter itself notices the loss after 7 s",
    )
    gps_s: float = Field(
        0.5,
        ge=0.3,
        le=10.0,
        description="with autopilot.gps: no position fix for this long, in s: of five a second one may be lost",
    )
    odometry_s: float = Field(
        0.25,
        ge=0.05,
        le=5.0,
        description="odometry that passes through the gate (safety.attached, may: odometry) silent, or repeating "
        "itself, for this long, in s: seven of 30 Hz are missing",
    )
    heartbeat_s: float = Field(
        3.0, ge=1.5, le=10.0, description="no heartbeat of the autopilot for this long, in s: three of 1 Hz are lost"
    )
    link_s: float = Field(
        0.4,
        ge=0.05,
        le=5.0,
        description="nothing at all from the autopilot for this long, in s: a hundred messages a second do not pause "
        "so long on a healthy link",
    )
    map_s: float = Field(
        30.0, ge=2.0, le=600.0, description="the process of the map silent for this long, in s: it restarts in less"
    )
    hang_s: float = Field(
        10.0,
        ge=1.0,
        le=120.0,
        description="an application without a beat for this long is killed, in s: no pause of memory or disk takes so "
        "long, and the vehicle stands since safety.stale.beat_s",
    )


class PoseSettings(Section):
    """Positions that cannot be true."""

    jump_m: float = Field(
        0.5,
        ge=0.05,
        le=10.0,
        description="a position this far from where the last one and its velocity lead is a jump, in m: above the "
        "corrections of a healthy visual odometry, below d_c",
    )
    frozen_s: float = Field(
        0.3,
        ge=0.05,
        le=5.0,
        description="positions that repeat each other to the last bit for this long, in s: the noise of an estimator "
        "changes them all the time",
    )


class DistanceSettings(Section):
    """The last line before a wall, whatever the law believes."""

    hard_limit_m: float | None = Field(
        None,
        gt=0.05,
        le=10.0,
        description="least distance ahead, from the middle of the body, that may be left when the vehicle has stopped, "
        "in m; null: midway between vehicle.body_radius_m and control.critical_margin_m (d_c)",
    )


class FenceSettings(Section):
    """Where the vehicle may be, in the autopilot's local frame; its origin is where the autopilot was started."""

    north_m: Range | None = Field(None, description="[least, most] to the north, in m; null: anywhere")
    east_m: Range | None = Field(None, description="[least, most] to the east, in m; null: anywhere")
    height_m: Range | None = Field(None, description="[least, most] above the origin, in m; null: anywhere")
    radius_m: float | None = Field(
        None, ge=1.0, le=100_000.0, description="largest distance from the origin in the plane, in m; null: anywhere"
    )

    @model_validator(mode="after")
    def _around_the_start(self) -> Self:
        for name in ("north_m", "east_m", "height_m"):
            bounds: Range | None = getattr(self, name)
            if bounds is None:
                continue
            key = f"safety.fence.{name}"
            least_m, most_m = bounds
            if least_m >= most_m:
                raise refuse(f"{key} = [{least_m:g}, {most_m:g}] must be [least, most]", key)
            if not least_m < 0.0 < most_m:
                raise refuse(
                    f"{key} = [{least_m:g}, {most_m:g}] must hold 0, the origin, where the flight starts: it would "
                    "begin outside of the fence",
                    key,
                )
        return self


class AttachedSettings(Section):
    """Somebody else who is given the autopilot's messages."""

    url: LinkUrl = Field(description=f"where it is: {LINK_FORMS}")
    may: Literal["read", "command", "odometry"] = Field(
        "read",
        description="what may come back: read (nothing), command (all but setpoints: a ground station) or odometry "
        "(where the vehicle is, nothing else)",
    )


class SigningSettings(Section):
    """MAVLink 2 signing towards the autopilot."""

    key_file: Annotated[str, AfterValidator(_absolute)] | None = Field(
        None,
        description="file with the secret key, 32 bytes or 64 hex digits, readable by its owner only; null: unsigned",
    )
    link_id: int = Field(1, ge=0, le=255, description="number of this link; every signing sender has its own")


class SafetySettings(Section):
    """The gate between the application and the flight controller."""

    level: Level = Field(
        "normal", description="fills what the file leaves out: normal, or cautious with stricter numbers throughout"
    )
    limits: LimitSettings = Field(LimitSettings(), description="what a setpoint may ask for")
    stale: StaleSettings = Field(StaleSettings(), description="from which age on something is too old")
    pose: PoseSettings = Field(PoseSettings(), description="positions that cannot be true")
    distance: DistanceSettings = Field(DistanceSettings(), description="the last line before a wall")
    messages_hz: float = Field(
        400.0,
        ge=100.0,
        le=10_000.0,
        description="more messages a second from the application are a flood, and the surplus is dropped: ten times "
        "what it sends, far below what fills a serial line of 921600 baud",
    )
    battery_percent: float = Field(
        15.0,
        ge=0.0,
        le=90.0,
        description="with less left it lands where it is, in percent; below mission.battery_low_percent, so that the "
        "application ends the flight first; 0: not watched",
    )
    battery_v: float | None = Field(
        None,
        gt=0.0,
        le=1000.0,
        description="with a lower voltage for 5 s it lands where it is, in V; null: not judged. A percentage is what "
        "the autopilot counts, ArduPilot from 100 % at each boot; the voltage is measured",
    )
    not_obeyed_mps: float = Field(
        0.2,
        ge=0.15,
        le=2.0,
        description="a vehicle that is asked to stand and flies faster than this, in m/s, does not obey, nor does one "
        "that is asked for more and stands: twice what the autopilots' estimates were measured to wander; what keeps a "
        "place asks for up to 0.1",
    )
    fence: FenceSettings = Field(FenceSettings(), description="where the vehicle may be")
    recover_s: float = Field(
        1.0, ge=0.1, le=60.0, description="a fault must be gone for this long before the application flies again, in s"
    )
    autopilot_delay_s: float = Field(
        0.15,
        ge=0.0,
        le=2.0,
        description="from a setpoint on the wire until the vehicle begins to brake, in s: link, the autopilot's loop, "
        "tilting; with control.governor.brake_mps2 it covers what PX4 was measured to need",
    )
    creep_m: float = Field(
        0.15,
        ge=0.0,
        le=2.0,
        description="how far it goes on after it has braked until its place is kept, in m: PX4 was measured to creep "
        "at 0.06 m/s, a place is kept after 2 s at most, and its position is wrong by some centimetres",
    )
    hold_creep_m: float = Field(
        0.25,
        ge=0.0,
        le=2.0,
        description="the same in a mode of the autopilot's own, in m: hold, land, its failsafe when setpoints stop. "
        "PX4 was measured to wander so far, ArduCopter less than 0.15; pre-flight refuses less than that",
    )
    attached: tuple[AttachedSettings, ...] = Field(
        (),
        max_length=8,
        description="others who get the autopilot's messages, as {url: URL, may: read}; may is read, command or "
        "odometry. Nothing listens anywhere that is not named here or in autopilot.url",
    )
    signing: SigningSettings = Field(SigningSettings(), description="signing towards the autopilot")
    restarts: int = Field(
        3, ge=0, le=100, description="the application is started again after a crash this often at most; never to fly"
    )
    realtime: bool = Field(
        True, description="ask the kernel to run the gate before everything else on this computer (SCHED_RR)"
    )
    reactions: ReactionsSettings = Field(ReactionsSettings(), description="the answer to each fault")

    def effective_limits(self, control: ControlSettings) -> Limits:
        """What the gate lets pass: as given, or what is above the law's own."""
        given, above = self.limits, ABOVE_CONTROL[self.level]
        return Limits(
            speed_mps=_or(given.speed_mps, above * control.speed_mps),
            climb_mps=_or(given.climb_mps, above * control.max_climb_mps),
            yaw_rate_radps=_or(given.yaw_rate_radps, above * control.max_yaw_rate_radps),
            accel_mps2=_or(given.accel_mps2, ACCEL_ABOVE_CONTROL[self.level] * control.max_accel_mps2),
        )

    def setpoint_late_s(self, control: ControlSettings) -> float:
        """From when on a setpoint is late."""
        return _or(self.stale.setpoint_s, PERIODS[self.level] * control.period_s)

    def beat_late_s(self, control: ControlSettings) -> float:
        """From when on a beat is late."""
        return _or(self.stale.beat_s, PERIODS[self.level] * control.period_s)

    @model_validator(mode="after")
    def _fill_by_level(self) -> Self:
        """What the file leaves out is the level's. In place: this is still the making of a frozen object."""
        for name, values in CAUTIOUS.items() if self.level == "cautious" else ():
            section: Section = getattr(self, name) if name else self
            left_out = {key: value for key, value in values.items() if key not in section.model_fields_set}
            self.__dict__.update({name: section.model_copy(update=left_out)} if name else left_out)
        self.__dict__["reactions"] = self.reactions.completed(self.level)
        return self

    @model_validator(mode="after")
    def _reactions_make_sense(self) -> Self:
        for fault, reaction in self.reactions.by_fault().items():
            reaction.check(fault)
        return self


def _or(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value
