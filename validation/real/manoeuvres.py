"""What a hovering vehicle is put through: brought to a speed and stopped, and turned; and what comes of it."""

from __future__ import annotations

import enum
import math
import time
from dataclasses import dataclass

from companion.config.settings import Settings
from companion.flight.preflight.parameter_rules import rules
from companion.frames import BodyVelocity
from companion.mavlink.firmware import AutopilotKind
from companion.station_keeping import PATIENCE_S, STANDS_MPS, StationKeeper
from sitl.autopilot.mavlink import dialect as m
from tests.integration.witness import speed_mps
from tests.shared.beside import wait_until
from validation.fault_matrix.standstill import Standstill
from validation.fault_matrix.true_way import TrueWay
from validation.real.sortie import MODES, Stream
from validation.real.station import Station
from validation.real.track import CREEP_S, Cruise, Stop, Turn, cruise, stop, turn

HEIGHT_M, LOW_M, CLIMB_MPS = 12.0, 8.0, 1.0
"""A landing that is watched for a dozen seconds ends in the air."""
CLIMBING_S = 30.0
CRUISE_S, TURN_S, OVERRUN_S, STOPPING_S = 5.0, 6.0, 2.0, 8.0
"""Until a speed is steady; until a yaw rate is; until the turning is over; and no stop is waited for longer."""
SETTLE_S, LOOK_S, LED_EVERY_S = 1.0, 0.2, 0.02
TURN_AT_MPS = 1.5


class Order(enum.StrEnum):
    """What stops it. Led back is what law and gate do: to where it came to stand."""

    ZERO = "zero velocity"
    LED_BACK = "zero velocity, led back"
    SILENCE = "silence"
    STAND_HOLD = "zero velocity, then hold"
    HOLD = "hold at once"
    LAND = "land"


@dataclass(frozen=True, slots=True)
class Stopped:
    """A stop.

    Attributes:
        order: what stopped it.
        asked_mps: the horizontal speed that was asked for.
        diagonal: whether it was asked for forward and sideways at once, in equal parts.
        cruise: before.
        stop: how.
        waited_s: how long anybody had to wait for a processor meanwhile, at most.
    """

    order: Order
    asked_mps: float
    diagonal: bool
    cruise: Cruise
    stop: Stop
    waited_s: float

    def __str__(self) -> str:
        sideways = " diagonally" if self.diagonal else ""
        return f"{self.order} from {self.cruise.at_order_mps:.2f} m/s{sideways}: {self.stop.way_m:.2f} m"


@dataclass(frozen=True, slots=True)
class Turned:
    """A turn, clockwise.

    Attributes:
        asked_mps: forward.
        asked_radps: yaw rate.
        turn: how.
        waited_s: as for a stop.
    """

    asked_mps: float
    asked_radps: float
    turn: Turn
    waited_s: float

    def __str__(self) -> str:
        return f"{self.asked_radps:g} rad/s at {self.asked_mps:g} m/s: {self.turn.reached_radps:.2f} rad/s"


def settings_at(speed_mps: float, gps: bool) -> Settings:
    """Settings of an application that flies so fast: what its pre-flight demands depends on it."""
    settings = Settings()
    return settings.model_copy(
        update={
            "control": settings.control.model_copy(update={"speed_mps": speed_mps}),
            "autopilot": settings.autopilot.model_copy(update={"gps": gps}),
        }
    )


class Manoeuvres:
    """A vehicle that hovers, and the manoeuvres that begin and end so."""

    def __init__(
        self,
        personality: str,
        gps: bool,
        ground: Station,
        companion: Station,
        way: TrueWay,
        stream: Stream,
        standstill: Standstill,
    ) -> None:
        self._kind = AutopilotKind(personality)
        self._gps = gps
        self._modes = MODES[personality]
        self._ground, self._companion, self._way = ground, companion, way
        self._stream, self._standstill = stream, standstill

    def demand(self, speed_mps: float) -> None:
        """Set what pre-flight demands of a vehicle that flies so fast, where it is not so."""
        self._ready()
        for rule in rules(self._kind, settings_at(speed_mps, self._gps)):
            for one in rule.either[0]:
                found = self._ground.parameter(one.name)
                value = None if found is None or one.met_by(found[0]) else one.fixed(found[0])
                if value is not None:
                    self._ground.set_parameters({one.name: value})

    def stopped(self, order: Order, asked_mps: float, diagonal: bool) -> Stopped:
        """Brought to this speed and stopped."""
        share = math.sqrt(0.5) if diagonal else 0.0
        right_mps = asked_mps * share
        forward_mps = right_mps if diagonal else asked_mps
        self._ready()
        self._stream.fly(BodyVelocity(forward_mps, right_mps, 0.0, 0.0))
        begun_s = self._stream.changed_s
        time.sleep(CRUISE_S)
        ordered_s = self._order(order)
        keeper = StationKeeper() if order is Order.LED_BACK else None
        give_up_s = ordered_s + STOPPING_S
        while time.monotonic() < give_up_s:
            self._stay(keeper, LOOK_S)
            if self._stop(begun_s, ordered_s).stopped_s is not None:
                break
        self._stay(keeper, CREEP_S)
        done = self._stop(begun_s, ordered_s)
        poses = self._way.poses(begun_s)
        return Stopped(order, asked_mps, diagonal, cruise(poses, begun_s, ordered_s), done, self._waited_s(begun_s))

    def turned(self, asked_mps: float, asked_radps: float) -> Turned:
        """Turned on the spot, or in flight."""
        self._ready()
        self._stream.fly(BodyVelocity(asked_mps, 0.0, 0.0, 0.0))
        time.sleep(CRUISE_S if asked_mps else SETTLE_S)
        self._stream.fly(BodyVelocity(asked_mps, 0.0, 0.0, asked_radps))
        begun_s = self._stream.changed_s
        time.sleep(TURN_S)
        self._stream.fly(BodyVelocity(asked_mps, 0.0, 0.0, 0.0))
        ordered_s = self._stream.changed_s
        time.sleep(OVERRUN_S)
        done = turn(self._way.poses(begun_s), begun_s, ordered_s, moving=asked_mps > 0.0)
        return Turned(asked_mps, asked_radps, done, self._waited_s(begun_s))

    def _order(self, order: Order) -> float:
        """Stop it; when that was said, and for silence when the last setpoint was sent."""
        if order is Order.SILENCE:
            self._stream.silent()
            return self._stream.changed_s
        if order in (Order.ZERO, Order.LED_BACK, Order.STAND_HOLD):
            self._stream.zero()
            ordered_s = self._stream.changed_s
            if order is Order.STAND_HOLD:
                while speed_mps(self._ground.pose()) > STANDS_MPS and time.monotonic() < ordered_s + PATIENCE_S:
                    time.sleep(0.01)
                self._ground.set_mode(self._modes["hold"])
            return ordered_s
        # As the gate does: zero velocity until the mode shows.
        ordered_s = time.monotonic()
        self._ground.set_mode(self._modes["hold" if order is Order.HOLD else "land"])
        self._stream.zero()
        return ordered_s

    def _stay(self, keeper: StationKeeper | None, time_s: float) -> None:
        """For so long, led back by what the autopilot says of its place, if at all."""
        until_s = time.monotonic() + time_s
        while keeper is not None and time.monotonic() < until_s:
            pose = self._ground.pose()
            heading_rad = math.pi / 2.0 - self._companion.heard[-1].message.yaw
            ahead_mps, left_mps, up_mps = keeper.velocity(
                (pose.x_m, pose.y_m, pose.z_m),
                (pose.vx_mps, pose.vy_mps, pose.vz_mps),
                heading_rad,
                time.monotonic(),
            )
            self._stream.fly(BodyVelocity(ahead_mps, -left_mps, -up_mps, 0.0))
            time.sleep(LED_EVERY_S)
        time.sleep(max(0.0, until_s - time.monotonic()))

    def _stop(self, begun_s: float, ordered_s: float) -> Stop:
        return stop(self._way.poses(begun_s), ordered_s)

    def _ready(self) -> None:
        """Hovering by our setpoints, high enough."""
        self._stream.zero()
        self._engage()
        if self._way.now().height_m < LOW_M:
            self._stream.fly(BodyVelocity(0.0, 0.0, -CLIMB_MPS, 0.0))
            wait_until(lambda: self._way.now().height_m > HEIGHT_M, "climbed", CLIMBING_S, 0.02)
            self._stream.zero()
        time.sleep(SETTLE_S)

    def _engage(self) -> None:
        results = self._ground.ask(m.MAV_CMD_DO_SET_MODE, *self._modes["offboard"])
        assert results[-1:] == [0], f"it does not take our setpoints: {results}, {self._ground.texts[-5:]}"

    def _waited_s(self, begun_s: float) -> float:
        return self._standstill.longest(begun_s, time.monotonic()).lasted_s
