"""The link to the ground in a flight: telemetry goes out, commands come in, and its silence may end the exploring."""

from __future__ import annotations

import logging
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from companion.clock import Clock
from companion.config.settings import Settings
from companion.flight.events import Event, EventEmitter
from companion.flight.operator_commands import OperatorCommands, UnfinishedError
from companion.flight.phase import PhaseMachine
from companion.flight.situation import Situation
from companion.flight.tasks import background
from companion.link.drawing import Drawing
from companion.link.vehicle.client import LinkClient
from companion.link.words import Answer, Command
from companion.mapping.process.client import MapClient
from companion.pipeline import Explorer

DRAW_PERIOD_S = 5.0
DRAW_SHARE = 0.02
"""Of the time: a large graph is made into bytes in a thread that shares the interpreter with the loop that steers."""

_THEN = {"go_on": "it goes on", "home": "coming home", "land": "landing"}
_ORDERS = {"home": Command.HOME, "land": Command.LAND}

_log = logging.getLogger(__name__)


class GroundLink:
    """The link of one flight, while `linked` has it open.

    Args:
        settings: of the flight.
        journal: folder of the map's journal.
        situation: how the flight stands.
        explorer: has the navigation graph.
        mapper: has the frontiers.
        operator: does what is asked.
        phases: know the phase.
        events: where it is told.
        clock: the time.
    """

    def __init__(
        self,
        settings: Settings,
        journal: Path,
        situation: Situation,
        explorer: Explorer,
        mapper: MapClient,
        operator: OperatorCommands,
        phases: PhaseMachine,
        events: EventEmitter,
        clock: Clock,
    ) -> None:
        self.client = LinkClient(settings.link, journal, self.obey, self._trouble, clock, settings.fleet.number)
        self._mission = settings.mission
        self._period_s = 1.0 / settings.link.telemetry_hz
        self._situation = situation
        self._explorer = explorer
        self._mapper = mapper
        self._operator = operator
        self._phases = phases
        self._events = events
        self._clock = clock
        self._next_drawing_s = -math.inf
        self._airborne_s: float | None = None
        self._told_lost = False
        self._failed = False

    def obey(self, command: Command, who: str) -> Answer:
        """Do what somebody at the ground asks."""
        answer = self._operator.ask(command)
        told = "done" if answer.accepted else answer.reason
        self._events.emit(Event.LINK_COMMAND, who=who, command=command.value, answer=told)
        return answer

    async def run(self) -> None:
        """Tell, and watch the silence, until cancelled. Nothing that fails here ends a flight."""
        while True:
            try:
                self.client.offer(self._situation.telemetry())
                self._watch_silence()
                await self._draw()
            except Exception:  # noqa: BLE001 - the flight does not need the link
                if not self._failed:
                    _log.exception("the link could not be told how the flight stands; the flight goes on")
                self._failed = True
            await self._clock.sleep(self._period_s)

    async def finish(self) -> None:
        """After the flight: let the ground fetch what is missing of the map, unless a person does not want to wait."""
        self.client.offer(self._situation.telemetry())
        self._tell_finishing()
        try:
            await self._operator.finish(self.client.finish(), self._tell_finishing)
        except UnfinishedError:
            _log.warning("broken off: the ground may not have all of the map; it is whole in the flight's folder")

    def _tell_finishing(self) -> None:
        # Several vehicles have a link without a ground, too.
        if math.isfinite(self.client.silent_s):
            self._events.emit(Event.LINK_FINISHING)

    def _watch_silence(self) -> None:
        if not self._phases.phase.steered:
            self._airborne_s = None
            return
        now_s = self._clock.now_s()
        self._airborne_s = now_s if self._airborne_s is None else self._airborne_s
        # Who was never heard is as silent as who is not heard any more, from the beginning of the exploring on.
        silent_s = min(self.client.silent_s, now_s - self._airborne_s)
        if silent_s < self._mission.link_lost_s:
            self._told_lost = False
        elif not self._told_lost:
            self._told_lost = True
            then = self._mission.link_lost
            self._events.emit(Event.LINK_LOST, silent_s=silent_s, then=_THEN[then])
            if then in _ORDERS:
                self._operator.ask(_ORDERS[then])

    async def _draw(self) -> None:
        now_s = self._clock.now_s()
        if now_s < self._next_drawing_s:
            return
        drawing = Drawing(self._explorer.navigator.graph.so_far(), self._mapper.status.frontiers_m)
        await self.client.draw(drawing)
        took_s = self._clock.now_s() - now_s
        self._next_drawing_s = now_s + max(DRAW_PERIOD_S, took_s / DRAW_SHARE)

    def _trouble(self, text: str) -> None:
        self._events.emit(Event.LINK_TROUBLE, text=text)


@asynccontextmanager
async def linked(link: GroundLink) -> AsyncIterator[GroundLink]:
    """Have the link open in the block."""
    async with link.client, background(link.run()):
        yield link
