"""Faults of what the autopilot says of itself: where it is, and whether it knows."""

from __future__ import annotations

import math
from collections.abc import Callable

from companion.config.settings import Settings
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from tests.integration.relay import Alter, repacked
from validation.fault_matrix.injection import Final, Injection
from validation.fault_matrix.scene import Flight

JUMP_M = 2.0
ESTIMATOR_S = 0.2
"""Period of the message that tells of it: the application asks for 5 a second."""
STALE = Settings().safety.stale
FROZEN_S = Settings().safety.pose.frozen_s
"""As the flights have it: they do not set it."""

STOPPED = frozenset({Final.BRAKED, Final.HELD, Final.LANDED})
POSES = ("LOCAL_POSITION_NED", "ATTITUDE", "ATTITUDE_QUATERNION", "GLOBAL_POSITION_INT", "ODOMETRY")
PLACE, SPEED = ("x", "y", "z"), ("vx", "vy", "vz")


def altered(make: Callable[[], Alter]) -> Callable[[Flight], None]:
    """Injects a change of what the autopilot says, made anew for each flight: some remember."""

    def inject(flight: Flight) -> None:
        flight.relay.alter_down = make()

    return inject


def without(*names: str) -> Alter:
    """No message of these names."""
    return lambda message: [] if message.get_type() in names else None


def _with(names: tuple[str, ...], change: Callable[[Message], None]) -> Alter:
    """Messages of these names, changed."""

    def alter(message: Message) -> list[bytes] | None:
        if message.get_type() not in names:
            return None
        change(message)
        return [repacked(message)]

    return alter


def shifted_east(by_m: float) -> Alter:
    """The flights of the matrix lead east."""

    def shift(message: Message) -> None:
        message.y += by_m

    return _with(("LOCAL_POSITION_NED",), shift)


def _shifted_north(by_m: float) -> Alter:
    def shift(message: Message) -> None:
        message.x += by_m

    return _with(("LOCAL_POSITION_NED",), shift)


def _no_numbers(message: Message) -> None:
    for name in (*PLACE, *SPEED):
        setattr(message, name, math.nan)


def _frozen() -> Alter:
    first: dict[str, float] = {}

    def freeze(message: Message) -> None:
        for name in (*PLACE, *SPEED):
            setattr(message, name, first.setdefault(name, getattr(message, name)))

    return _with(("LOCAL_POSITION_NED",), freeze)


def _backwards() -> Alter:
    first_ms: list[int] = []

    def turn(message: Message) -> None:
        first_ms.append(message.time_boot_ms)
        del first_ms[1:]
        message.time_boot_ms = max(0, 2 * first_ms[0] - message.time_boot_ms)

    return _with(("LOCAL_POSITION_NED", "ATTITUDE"), turn)


def _estimator_gives_up(message: Message) -> None:
    known = m.ESTIMATOR_VELOCITY_HORIZ | m.ESTIMATOR_POS_HORIZ_REL | m.ESTIMATOR_POS_HORIZ_ABS
    message.flags = message.flags & ~known | m.ESTIMATOR_CONST_POS_MODE


def changes_worked(flight: Flight) -> str | None:
    """Whether what was to be injected was: for `Injection.verify`."""
    return f"the change itself failed: {flight.relay.errors[-1]!r}" if flight.relay.errors else None


def _pose(
    name: str, what: str, make: Callable[[], Alter], limit_s: float = STALE.pose_s, landed: bool = False
) -> Injection:
    return Injection(
        f"pose {name}",
        "pose",
        what,
        altered(make),
        frozenset({Final.LANDED}) if landed else STOPPED,
        limit_s=limit_s,
        careless=True,
        verify=changes_worked,
    )


POSE_FAULTS = (
    Injection(
        "pose jump",
        "pose",
        f"the position leaps by {JUMP_M:g} m to the side and stays there: it brakes, and may go on",
        altered(lambda: _shifted_north(JUMP_M)),
        STOPPED | {Final.FLEW_ON},
        verify=changes_worked,
    ),
    _pose(
        "frozen while moving",
        "the same position and velocity to the last bit, each with a new stamp: it lands",
        _frozen,
        FROZEN_S,
        landed=True,
    ),
    _pose("NaN", "position and velocity are no numbers", lambda: _with(("LOCAL_POSITION_NED",), _no_numbers)),
    _pose("silent", "neither position nor attitude comes any more", lambda: without(*POSES)),
    _pose("without attitude", "positions come, attitudes do not", lambda: without("ATTITUDE", "ATTITUDE_QUATERNION")),
    _pose("stamps going back", "the stamps of position and attitude run backwards", _backwards),
    _pose(
        "not known to the estimator",
        "the autopilot says that it knows neither its horizontal velocity nor its position: it lands",
        lambda: _with(("ESTIMATOR_STATUS", "EKF_STATUS_REPORT"), _estimator_gives_up),
        ESTIMATOR_S,
        landed=True,
    ),
)
