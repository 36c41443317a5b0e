"""The loop that flies: one observation, one measurement and at most one setpoint a tick."""

from __future__ import annotations

import math
import time
from collections.abc import AsyncIterator, Callable

from companion.clock import Clock
from companion.control.homing.homing import WayHome
from companion.control.separation import Clearance
from companion.flight.company import Company
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.model import Input, Measurement, Mode, Pose, Setpoint
from companion.pipeline import Explorer, Order, Tick
from companion.sensors.synchronizer import Synchronizer

Watcher = Callable[[Tick], None]
"""Whoever wants to know of each tick: recording, reporting, the map. Takes no longer than a millisecond or two."""

Ticked = Callable[[float, Pose | None, Measurement | None], None]
"""What the gate is told of each completed tick: time, and what its setpoint rests on; None while no pose is known."""


class Rate:
    """A fixed rate without catching up: gives one time a period. A tick that came too late is counted and not repeated.

    Args:
        period_s: the sampling period.
    """

    def __init__(self, clock: Clock, period_s: float) -> None:
        self.missed = 0
        """Periods in which no tick could begin."""
        self._clock = clock
        self._period_s = period_s

    async def ticks(self) -> AsyncIterator[float]:
        """The time of each tick, for ever."""
        next_s = self._clock.now_s()
        while True:
            now_s = self._clock.now_s()
            late_s = now_s - next_s
            if late_s >= self._period_s:
                missed = int(late_s / self._period_s)
                self.missed += missed
                next_s += missed * self._period_s
            yield now_s
            next_s += self._period_s
            await self._clock.sleep(max(0.0, next_s - self._clock.now_s()))


class ControlLoop:
    """Looks always, steers while the flight explores and comes home.

    A tick whose pose is missing sends nothing: a velocity means nothing to an autopilot that may not know its own, and
    silence is what the layers below react to. A tick that lacks anything else sends zero: to stop needs no depth.

    Args:
        inputs: where observations come from.
        explorer: what makes setpoints of them.
        rate: when to tick.
        flight: knows the phase.
        send: sends a setpoint to the vehicle and says whether it went out; None: there is nothing to send, as in a
            pre-flight check.
        watchers: who is told of every tick.
        ticked: tells the gate of every tick before its setpoint goes out; without it no setpoint passes.
        company: the other vehicles; None: it flies alone.
    """

    def __init__(
        self,
        inputs: Synchronizer,
        explorer: Explorer,
        rate: Rate,
        flight: PhaseMachine,
        send: Callable[[Setpoint], bool] | None,
        watchers: tuple[Watcher, ...] = (),
        ticked: Ticked | None = None,
        company: Company | None = None,
    ) -> None:
        self.measurement: Measurement | None = None
        """Of the newest tick, None when it had no pose."""
        self.pose: Pose | None = None
        self.fresh_s = -math.inf
        """When a tick last had all its inputs."""
        self._inputs = inputs
        self._explorer = explorer
        self._rate = rate
        self._flight = flight
        self._send = send
        self._watchers = watchers
        self._ticked = ticked
        self._company = company

    def measured_height_m(self) -> float | None:
        """Height above ground, measured by the beam that looks down; None when it is not known now."""
        return None if self.measurement is None else self.measurement.h_m

    def is_way_left(self) -> bool | None:
        """Whether known ground has a way to something unseen; None where that is not known, as without a pose."""
        return None if self.pose is None else self._explorer.navigator.is_way_left(self.pose)

    def way_home(self, anew: bool = False) -> WayHome | None:
        """How far home is, as of the last seconds or searched anew; None where no way is known, or home is not."""
        if self.pose is None or self.measurement is None:
            return None
        return self._explorer.navigator.way_home(self.measurement, self.pose, anew)

    @property
    def lands_elsewhere(self) -> bool:
        """Whether home could not be got to, and it lands beside it."""
        return self._explorer.navigator.homing.lands_elsewhere

    @property
    def goes_back(self) -> bool:
        """Whether the ground below has ended, and it is on its way back to where there was some."""
        return self._explorer.goes_back

    @property
    def way_is_closed(self) -> bool:
        """Whether no way home was found, and it lands as near to home as it gets."""
        return self._explorer.navigator.homing.is_closed

    def off_home_m(self) -> float | None:
        """How far home is as the crow flies, by what the vehicle recognises; None without a pose or a home."""
        homing = self._explorer.navigator.homing
        return None if self.pose is None or homing.began_at is None else homing.off_home_m(homing.pose(self.pose))

    @property
    def unsure_m(self) -> float:
        """How far `off_home_m` may be wrong by the drift of the position."""
        return self._explorer.navigator.homing.unsure_m

    @property
    def is_home(self) -> bool:
        """Whether the vehicle has come home and stands there."""
        return self._explorer.navigator.is_home

    async def run(self) -> None:
        """Tick until cancelled."""
        async for now_s in self._rate.ticks():
            self.tick(now_s)

    def tick(self, now_s: float) -> Tick:
        """One sampling period."""
        began = time.perf_counter()
        steered, order = self._flight.phase.steered, self._order()
        observation = self._inputs.observe(now_s)
        measurement: Measurement | None = None
        setpoint: Setpoint | None = None
        clearance = None if observation is None else self._clearance(now_s, observation.pose)
        if observation is not None and steered:
            if clearance is not None:
                self._explorer.navigator.height_m = clearance.height_m
                order = Order.WAIT if clearance.holds else order
            beneath = () if self._company is None else self._company.beneath()
            steering = self._explorer.step(observation, order, beneath)
            measurement, setpoint = steering.measurement, steering.setpoint
            if clearance is not None and self._company is not None:
                yaw_rad = self._company.shared_yaw_rad(observation.pose)
                setpoint = self._explorer.apart(setpoint, clearance, yaw_rad)
        elif observation is not None:
            measurement = self._explorer.look(observation)
        missing = (Input.POSE,) if measurement is None else measurement.missing
        if Input.POSE in missing:
            setpoint = None
        self.measurement = measurement
        self.pose = None if observation is None else observation.pose
        if not missing:
            self.fresh_s = now_s
        # Only here, where everything before has succeeded: a tick that failed must not look like one that did.
        if self._ticked is not None:
            self._ticked(now_s, self.pose, measurement)
        sent = setpoint is not None and self._send is not None and self._send(setpoint)
        navigator = self._explorer.navigator
        tick = Tick(
            t_s=now_s,
            observation=observation,
            measurement=measurement,
            setpoint=setpoint,
            mode=navigator.status.mode if steered and not missing else Mode.HOLD,
            sent=sent,
            height_m=navigator.height_m,
            duration_s=time.perf_counter() - began,
            stepped=steered and observation is not None,
            order=order,
        )
        for watch in self._watchers:
            watch(tick)
        return tick

    def _clearance(self, now_s: float, pose: Pose) -> Clearance | None:
        """What the others leave it to do; None: it flies alone."""
        if self._company is None:
            return None
        phase = self._flight.phase
        self._company.see(now_s, pose, self.measured_height_m(), phase.airborne and phase is not FlightPhase.ENDED)
        return self._company.clearance(now_s)

    def _order(self) -> Order:
        if self._flight.paused:
            return Order.WAIT
        return Order.HOME if self._flight.phase is FlightPhase.HOMING else Order.EXPLORE
