"""What the gate is told when it starts: plain numbers, checked by whoever wrote them, read from one JSON text."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from companion.gate.faults import Fault, Stage

CYCLE_S = 0.01
"""The gate looks at everything this often at least; the stopping budget counts with it."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a setpoint may ask for."""

    speed_mps: float
    climb_mps: float
    yaw_rate_radps: float
    accel_mps2: float
    """Growth of the commanded velocity; to slow down is always allowed."""


@dataclass(frozen=True, slots=True)
class Geofence:
    """Where the vehicle may be, in the autopilot's local north-east-down frame; None: anywhere.

    Attributes:
        north_m: least and most.
        east_m: least and most.
        down_m: least and most; the height is its negative.
        radius_m: about the origin of the frame, in the plane.
    """

    north_m: tuple[float, float] | None = None
    east_m: tuple[float, float] | None = None
    down_m: tuple[float, float] | None = None
    radius_m: float | None = None


@dataclass(frozen=True, slots=True)
class Thresholds:
    """From when on something is a fault: ages in s, distances in m."""

    setpoint_s: float
    beat_s: float
    depth_s: float
    ranges_s: float
    pose_s: float
    pose_jump_m: float
    pose_frozen_s: float
    heartbeat_s: float
    link_s: float
    map_s: float
    hang_s: float
    """An application without a beat for this long is killed."""
    aiding_s: float
    """The estimator's figures of merit stand still for this long."""
    gps_s: float
    """No position fix for this long, on a vehicle that flies by GPS."""
    odometry_s: float
    """No odometry through the gate for this long, where it passes."""
    not_obeyed_mps: float
    """Asked to stand, it must be slower."""
    hard_limit_m: float
    """Least distance ahead, from the centre of the body, at which the vehicle must have stopped."""
    battery_percent: float
    battery_v: float | None
    """None: the voltage is not judged."""
    messages_hz: float
    """More than this from the application is a flood."""


@dataclass(frozen=True, slots=True)
class Reaction:
    """The answer to one fault: at once ``first``, later what its delays say, counted from when the fault began.

    ``Stage.PASS`` as ``first`` only tells the pilot.
    """

    first: Stage
    hold_after_s: float | None
    land_after_s: float | None


@dataclass(frozen=True, slots=True)
class Stopping:
    """How the vehicle stops: the delay until it begins to, its deceleration, and how far it then creeps on."""

    delay_s: float
    brake_mps2: float
    creep_m: float

    def distance_m(self, speed_mps: float, since_s: float = 0.0) -> float:
        """How far it goes from a speed until its place is kept, when it is stopped ``since_s`` from now."""
        return speed_mps * (since_s + self.delay_s) + speed_mps**2 / (2.0 * self.brake_mps2) + self.creep_m


@dataclass(frozen=True, slots=True)
class Attached:
    """Somebody else who is given the autopilot's messages, and what may come back: read, command or odometry."""

    url: str
    may: str


@dataclass(frozen=True, slots=True)
class Signing:
    """MAVLink signing towards the autopilot."""

    key_file: str
    link_id: int


@dataclass(frozen=True, slots=True)
class Plan:
    """Everything.

    Attributes:
        autopilot_url: where the flight controller is, as in the configuration.
        system_id: of the vehicle.
        gps: whether the autopilot flies by GPS.
        period_s: of the application's ticks.
        silence_s: the autopilot's own failsafe acts when setpoints stop for this long.
        limits: of setpoints.
        fence: of places.
        thresholds: of faults.
        reactions: of every fault.
        recover_s: a fault must be gone for this long.
        stopping: for the distance that a stop takes.
        attached: ground stations and the like.
        signing: None: the link is not signed.
        command: how the application is started.
        restart_command: how it is started again after it died, so that nothing flies by itself.
        restarts: how often at most.
        inherit: file descriptors that the application inherits, besides its socket to the gate.
        realtime: whether to ask the kernel for precedence.
    """

    autopilot_url: str
    system_id: int
    gps: bool
    period_s: float
    silence_s: float
    limits: Limits
    fence: Geofence
    thresholds: Thresholds
    reactions: dict[Fault, Reaction]
    recover_s: float
    stopping: Stopping
    attached: tuple[Attached, ...]
    signing: Signing | None
    command: tuple[str, ...]
    restart_command: tuple[str, ...]
    restarts: int
    inherit: tuple[int, ...]
    realtime: bool

    def dumps(self) -> str:
        """As JSON."""
        return json.dumps(asdict(self), allow_nan=False)

    @classmethod
    def loads(cls, text: str) -> Plan:
        """From JSON.

        Raises:
            ValueError: it is not what `dumps` writes.
        """
        try:
            found: dict[str, Any] = json.loads(text)
            fence: dict[str, Any] = {
                key: tuple(value) if isinstance(value, list) else value for key, value in found["fence"].items()
            }
            made = {
                "limits": Limits(**found["limits"]),
                "fence": Geofence(**fence),
                "thresholds": Thresholds(**found["thresholds"]),
                "reactions": {
                    Fault(fault): Reaction(Stage(it["first"]), it["hold_after_s"], it["land_after_s"])
                    for fault, it in found["reactions"].items()
                },
                "stopping": Stopping(**found["stopping"]),
                "attached": tuple(Attached(**one) for one in found["attached"]),
                "signing": None if found["signing"] is None else Signing(**found["signing"]),
                "command": tuple(found["command"]),
                "restart_command": tuple(found["restart_command"]),
                "inherit": tuple(found["inherit"]),
            }
            plan = cls(**(found | made))
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"no plan of a gate: {error!r}") from error
        if set(plan.reactions) != set(Fault):
            raise ValueError("no plan of a gate: every fault needs a reaction")
        return plan
