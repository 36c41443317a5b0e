"""A beat to the gate at every tick, and the gate's notices."""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Callable

from companion.clock import Clock
from companion.errors import CompanionError
from companion.flight.events import Event, EventEmitter
from companion.flight.gate_socket import GateSocket
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.gate.faults import Stage
from companion.gate.protocol import LINK, Beat, Notice, Phase
from companion.model import Measurement, Pose
from companion.sides import NOTHING_AROUND

LOOK_S = 0.1
"""How often it is looked whether the gate has said something."""
KINDS_OF_NOTICES = 64
"""Different texts that are counted each by itself; the rest is counted together."""
OTHERS = "others"

GATE_PHASE = {
    FlightPhase.CHECKING: Phase.GROUND,
    FlightPhase.WAITING: Phase.GROUND,
    FlightPhase.TAKING_OFF: Phase.CLIMBING,
    FlightPhase.EXPLORING: Phase.EXPLORING,
    FlightPhase.HOMING: Phase.EXPLORING,
    FlightPhase.LEAVING: Phase.ENDING,
    FlightPhase.ENDED: Phase.ENDED,
}
"""What the gate has to know of a phase of the flight."""


class GateLostError(CompanionError):
    """The gate died, and with it the only way to the autopilot."""


class GateTookOverError(CompanionError):
    """The gate holds or lands the vehicle, and lets nothing pass that would climb or steer."""


class GateClient:
    """Beats, and notices.

    Args:
        events: where its notices go.
        flight: knows the phase of the flight, which every beat says.

    Attributes:
        socket: to the gate, which is the way to the autopilot.
        counted: how often the gate has said what.
        taken: set once the gate has begun to hold or land the vehicle.
        lost: set when the gate is gone.
        link_problem: what the gate says is wrong with the link to the autopilot; empty: nothing.
    """

    def __init__(self, socket: GateSocket, clock: Clock, events: EventEmitter, flight: PhaseMachine) -> None:
        self.counted: Counter[str] = Counter()
        self.taken = asyncio.Event()
        self.lost = asyncio.Event()
        self.link_problem = ""
        self.socket = socket
        self._clock = clock
        self._events = events
        self._flight = flight
        self._map_age_s: Callable[[], float] = lambda: math.inf
        self._notice = Notice(Stage.PASS)

    @property
    def phase(self) -> Phase:
        """What the next beat says that the application is doing."""
        return GATE_PHASE[self._flight.phase]

    @property
    def took_over(self) -> str | None:
        """What the gate does and why, so that a foreign mode is its doing; None while it neither holds nor lands."""
        stage, fault = self._notice.stage, self._notice.fault
        return f"{stage.name.lower()}: {fault or 'no fault named'}" if stage >= Stage.HOLD else None

    def has_map(self, age_s: Callable[[], float]) -> None:
        """From now on beats say how long the process of the map has been silent."""
        self._map_age_s = age_s

    def ticked(self, t_s: float, pose: Pose | None, measurement: Measurement | None) -> None:
        """A tick was completed: say how old what it rests on is."""
        pose_s = math.inf if pose is None else t_s - pose.t_s
        self.socket.beat(
            Beat(
                t_s=t_s,
                depth_age_s=math.inf if measurement is None else _age(measurement.scan_age_s),
                ranges_age_s=math.inf if measurement is None else _age(measurement.ranges_age_s),
                pose_age_s=_age(pose_s),
                ahead_m=math.nan if measurement is None else measurement.ahead_m,
                map_age_s=_age(self._map_age_s()),
                phase=self.phase,
                sides=NOTHING_AROUND if measurement is None else measurement.sides,
            )
        )

    def ended(self) -> None:
        """The flight has ended, and nothing ticks any more: a map takes its time to be written.

        Said again and again: the gate that missed it would take the silence for a hang.
        """
        self.ticked(self._clock.now_s(), None, None)

    async def run(self) -> None:
        """Listen until cancelled.

        Raises:
            GateLostError: the gate is gone, and nothing flies yet.
        """
        while True:
            self.look()
            if self.lost.is_set() and self.phase is Phase.GROUND:
                raise GateLostError("the safety gate is gone: without it nothing flies; nothing was armed")
            if self.phase is Phase.ENDED:
                self.ended()
            await self._clock.sleep(LOOK_S)

    def look(self) -> None:
        """Show, record and count the notices; find out when the gate is gone."""
        for notice in self.socket.notices():
            text = notice.text
            if text.startswith(LINK):
                self.link_problem = text.removeprefix(LINK).strip()
                if not self.link_problem:
                    continue
            self.counted[text if text in self.counted or len(self.counted) < KINDS_OF_NOTICES else OTHERS] += 1
            self._events.emit(Event.GATE_NOTICE, text=text)
        self._notice = self.socket.stage or self._notice
        if self._notice.stage >= Stage.HOLD:
            self.taken.set()
        if self.socket.gone and not self.lost.is_set():
            self.lost.set()
            text = "gone; nothing reaches the autopilot any more, its own failsafe stops the vehicle"
            self._events.emit(Event.GATE_NOTICE, text=text)


def _age(value_s: float) -> float:
    """An age as the gate takes it: a stamp from the future, or none, says nothing of how old a thing is."""
    return value_s if value_s >= 0.0 else math.inf
