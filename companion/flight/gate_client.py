"""What the application says to the gate at every tick, and what becomes of what the gate says."""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import Callable

from companion.clock import Clock
from companion.errors import CompanionError
from companion.flight.events import Event, EventEmitter
from companion.flight.gate_socket import GateLink
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.gate.faults import Stage
from companion.gate.protocol import Beat, Phase
from companion.model import Measurement, Pose

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
    FlightPhase.LEAVING: Phase.ENDING,
    FlightPhase.ENDED: Phase.ENDED,
}
"""What the gate has to know of a phase of the flight."""

_STAGES = {stage.name.lower(): stage for stage in Stage}


class GateLostError(CompanionError):
    """The gate died, and with it the only way to the autopilot."""


class GateTookOverError(CompanionError):
    """The gate holds or lands the vehicle, and lets nothing pass that would climb or steer."""


class GateTalk:
    """Beats, and notices.

    Args:
        link: to the gate.
        clock: what time it is.
        events: where what the gate says goes.
        flight: knows the phase of the flight, which every beat says.

    Attributes:
        counted: how often the gate has said what.
        taken: set once the gate has begun to hold or land the vehicle.
        lost: set when the gate is gone.
    """

    def __init__(self, link: GateLink, clock: Clock, events: EventEmitter, flight: PhaseMachine) -> None:
        self.counted: Counter[str] = Counter()
        self.taken = asyncio.Event()
        self.lost = asyncio.Event()
        self._link = link
        self._clock = clock
        self._events = events
        self._flight = flight
        self._map_age_s: Callable[[], float] = lambda: math.inf
        self._stage = Stage.PASS
        self._stage_words = ""

    @property
    def phase(self) -> Phase:
        """What the next beat says that the application is doing."""
        return GATE_PHASE[self._flight.phase]

    @property
    def url(self) -> str:
        """Where the gate stands in for the autopilot."""
        return self._link.url

    @property
    def beats_unsent(self) -> int:
        """Beats for which there was no room."""
        return self._link.unsent

    @property
    def took_over(self) -> str | None:
        """The gate's own words for why it holds or lands, so that a foreign mode is its doing; None: it does not."""
        return self._stage_words if self._stage >= Stage.HOLD else None

    def has_map(self, age_s: Callable[[], float]) -> None:
        """From now on beats say how long the process of the map has been silent."""
        self._map_age_s = age_s

    def ticked(self, t_s: float, pose: Pose | None, measurement: Measurement | None) -> None:
        """A tick was completed: say how old what it rests on is."""
        pose_s = math.inf if pose is None else t_s - pose.t_s
        self._link.beat(
            Beat(
                t_s=t_s,
                depth_age_s=math.inf if measurement is None else _age(measurement.scan_age_s),
                ranges_age_s=math.inf if measurement is None else _age(measurement.ranges_age_s),
                pose_age_s=_age(pose_s),
                ahead_m=math.nan if measurement is None else measurement.ahead_m,
                map_age_s=_age(self._map_age_s()),
                phase=self.phase,
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
        """Show, record and count what the gate has said; notice when it is gone."""
        for text in self._link.notices():
            stage = _STAGES.get(text.partition(":")[0])
            if stage is not None:
                self._stage, self._stage_words = stage, text
                if stage >= Stage.HOLD:
                    self.taken.set()
            self.counted[text if text in self.counted or len(self.counted) < KINDS_OF_NOTICES else OTHERS] += 1
            self._events.emit(Event.GATE_NOTICE, text=text)
        if self._link.gone and not self.lost.is_set():
            self.lost.set()
            text = "gone; nothing reaches the autopilot any more, its own failsafe stops the vehicle"
            self._events.emit(Event.GATE_NOTICE, text=text)


def _age(value_s: float) -> float:
    """An age as the gate takes it: a stamp from the future, or none, says nothing of how old a thing is."""
    return value_s if value_s >= 0.0 else math.inf
