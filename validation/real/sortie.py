"""A flight by setpoints alone: armed, taken off, and flown by velocities as the application sends them."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Iterator

from companion.frames import BodyVelocity
from sitl.autopilot.mavlink import dialect as m
from tests.shared.beside import wait_until
from validation.fault_matrix.true_way import TrueWay
from validation.real.station import Station

COMPANION = (1, 191)
MODES = {
    "px4": {"offboard": (1.0, 6.0, 0.0), "hold": (1.0, 4.0, 3.0), "land": (1.0, 4.0, 6.0)},
    "ardupilot": {"offboard": (1.0, 4.0, 0.0), "hold": (1.0, 17.0, 0.0), "land": (1.0, 9.0, 0.0)},
}
"""Parameters of DO_SET_MODE: what flies our setpoints, and what the gate orders."""
PERIOD_S = 0.05
READY_S, ASK_EVERY_S, CLIMB_S = 90.0, 1.0, 45.0
STANDING = BodyVelocity(0.0, 0.0, 0.0, 0.0)


class Stream:
    """Setpoints of a companion, twenty a second.

    Args:
        companion: whose link they go out on.

    Attributes:
        ended: ends it.
        sent_s: when the last was sent.
        changed_s: when what is asked for now was sent for the first time, and before a silence when the last was.
    """

    def __init__(self, companion: Station) -> None:
        self.ended = threading.Event()
        self.sent_s = self.changed_s = -math.inf
        self._companion = companion
        self._wanted: BodyVelocity | None = STANDING
        self._flown: BodyVelocity | None = None

    def fly(self, velocity: BodyVelocity) -> None:
        """So from now on; returns when it has been sent."""
        self._want(velocity)

    def zero(self) -> None:
        """Stand."""
        self._want(STANDING)

    def silent(self) -> None:
        """Send nothing more; returns when the last has been sent."""
        self._want(None)

    def run(self) -> None:
        """Until `ended`."""
        while not self.ended.wait(PERIOD_S):
            wanted = self._wanted
            if wanted is not None:
                self._send(wanted)
                self.sent_s = time.monotonic()
            if wanted != self._flown:
                self._flown, self.changed_s = wanted, self.sent_s

    def _want(self, velocity: BodyVelocity | None) -> None:
        self._wanted = velocity
        wait_until(lambda: self._flown == velocity, "the setpoints change", 20.0 * PERIOD_S)

    def _send(self, velocity: BodyVelocity) -> None:
        self._companion.send(
            m.MAVLink_set_position_target_local_ned_message(
                *(0, 1, 1, m.MAV_FRAME_BODY_NED, 0x5C7, 0.0, 0.0, 0.0),
                *(velocity.vx_mps, velocity.vy_mps, velocity.vz_mps),
                *(0.0, 0.0, 0.0, 0.0, velocity.yaw_rate_radps),
            ),
            COMPANION,
        )


@contextlib.contextmanager
def streaming(companion: Station) -> Iterator[Stream]:
    """Setpoints while the block lasts; zero velocity at first."""
    stream = Stream(companion)
    thread = threading.Thread(target=stream.run, name="setpoints")
    thread.start()
    try:
        yield stream
    finally:
        stream.ended.set()
        thread.join()


def take_off(personality: str, ground: Station, way: TrueWay, height_m: float) -> float:
    """Armed, and up to a height above the start; when it was armed, or, where that was too early, armed again."""
    if personality == "px4":
        ground.set_parameters({"MIS_TAKEOFF_ALT": height_m})
        where, first = [math.nan] * 7, []
    else:
        # Before its estimator is sure of the place it takes neither this nor a take-off.
        where, first = [*[0.0] * 6, height_m], [(m.MAV_CMD_DO_SET_MODE, *MODES[personality]["offboard"])]
    give_up_s = time.monotonic() + READY_S
    while time.monotonic() < give_up_s:
        if all(_takes(ground, *order) for order in first):
            armed_s = time.monotonic()
            if _takes(ground, m.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) and _takes(ground, m.MAV_CMD_NAV_TAKEOFF, *where):
                break
        time.sleep(ASK_EVERY_S)
    else:
        raise AssertionError(f"it does not take off: {ground.mode}, {ground.texts[-5:]}")
    wait_until(lambda: way.now().height_m > 0.9 * height_m, "taken off", CLIMB_S, 0.02)
    return armed_s


def _takes(ground: Station, command: int, *parameters: float) -> bool:
    return ground.ask(command, *parameters)[-1:] == [0]
