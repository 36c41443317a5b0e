"""What vehicles and the ground say to each other, as plain data: how a flight stands, commands, and answers to them."""

from __future__ import annotations

import enum
from dataclasses import dataclass

Place = tuple[float, float, float]
"""x, y and z in m, in the frame of the vehicle's map."""


class Command(enum.Enum):
    """What an operator may ask of a vehicle. Each is idempotent: asked twice, it is done once."""

    START = "start"
    PAUSE = "pause"
    CONTINUE = "continue"
    HOME = "home"
    LAND = "land"
    """Where it is."""
    STOP = "stop"
    """Brake now and hold, whatever it is at."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of a command.

    Attributes:
        accepted: whether the vehicle does it.
        reason: why not, in words for the operator; empty when accepted.
    """

    accepted: bool
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Telemetry:
    """How a flight stands. Numbers that are not known are None, never NaN.

    Attributes:
        vehicle: its name (`link.name`).
        flight: the name of the flight's folder; another one is another flight, with a map of its own.
        number: grows by one with every message of a flight.
        t_s: the vehicle's clock.
        phase: of the flight: "checking", "waiting", "taking off", "exploring", "homing", "leaving", "ended".
        paused: whether a person lets it wait.
        mode: of the navigator, in words: "R2 along tangent", "hold".
        x_m: position, in the frame of the vehicle's map; so are the next two.
        y_m: see ``x_m``.
        z_m: see ``x_m``.
        yaw_rad: heading.
        frame: where the origin of the vehicle's map lies in the frame that vehicles share, x, y and z in m, and how far
            it is turned to the left, in rad; None where the vehicle is not one of several.
        d_m: the least distance to rock.
        margin_m: d_s, the distance that is kept.
        h_m: height above the ground below.
        height_m: H, the height that it wants to fly at.
        target_m: the point that it flies to now.
        battery_percent: what is left.
        home_m: the length of the way home.
        home_s: the time that it takes.
        left_at_home_percent: what would be left at home if it turned back now.
        reserve_percent: what shall be left there (`mission.reserve_percent`).
        completeness: of the map, an estimate from 0 to 1.
        frontiers: how many are left.
        warnings: what is wrong now, in words that say what to do; empty when all is well.
        ended_because: why the flight ended; empty before.
    """

    vehicle: str
    flight: str
    number: int
    t_s: float
    phase: str
    paused: bool = False
    mode: str = ""
    x_m: float | None = None
    y_m: float | None = None
    z_m: float | None = None
    yaw_rad: float | None = None
    frame: tuple[float, float, float, float] | None = None
    d_m: float | None = None
    margin_m: float | None = None
    h_m: float | None = None
    height_m: float | None = None
    target_m: Place | None = None
    battery_percent: float | None = None
    home_m: float | None = None
    home_s: float | None = None
    left_at_home_percent: float | None = None
    reserve_percent: float | None = None
    completeness: float | None = None
    frontiers: int | None = None
    warnings: tuple[str, ...] = ()
    ended_because: str = ""
