"""From connected to checked: wait until the autopilot is ready, listen for a while, run the pre-flight checks."""

from __future__ import annotations

import numpy as np

from companion.errors import CompanionError
from companion.flight.events import Event, EventEmitter
from companion.flight.preflight import CheckResult, refusal, render, run_checks
from companion.flight.request import FlightRequest
from companion.flight.session import Session
from companion.flight.tasks import background
from companion.pipeline import Explorer

SETTLE_S = 3.0
"""Rates are measured over this time before they are judged."""

LOOK_PERIOD_S = 0.2
"""How often it is asked whether something has come about."""


class FlightRefusedError(CompanionError):
    """A pre-flight check failed."""


async def passed(session: Session, request: FlightRequest, events: EventEmitter) -> list[CheckResult]:
    """The results, when the vehicle may fly; told to the pilot when it may not."""
    results = await checked(session, request, events)
    why = refusal(results)
    if why is None:
        return results
    names = ", ".join(result.name for result in results if result.failed)
    events.emit(Event.REFUSED, results=render(results), failed=names)
    raise FlightRefusedError(why)


async def checked(session: Session, request: FlightRequest, events: EventEmitter) -> list[CheckResult]:
    """Wait until the autopilot knows its position, listen for a while, and look at everything."""
    settings, clock = session.settings, session.clock
    control_loop = session.control_loop(Explorer(settings, np.random.default_rng(0)))
    async with background(control_loop.run()):
        await _until_position(session, events)
        await clock.sleep(SETTLE_S)
        return await run_checks(
            session.link,
            session.telemetry,
            settings,
            session.sink.statistics(clock.now_s()),
            fix=request.fix,
            skip=(*settings.mission.skip_checks, *request.skip),
            height_m=control_loop.measured_height_m(),
            clock=clock,
        )


async def _until_position(session: Session, events: EventEmitter) -> None:
    """An autopilot that has just been switched on needs up to a minute: what it lacks then is no failure yet."""
    events.emit(Event.CONNECTED)
    clock, timeout_s = session.clock, session.settings.autopilot.ready_timeout_s
    began_s = clock.now_s()
    announced = False
    while not session.telemetry.state(clock.now_s()).position_valid and clock.now_s() < began_s + timeout_s:
        if not announced and clock.now_s() > began_s + SETTLE_S:
            announced = True
            events.emit(Event.NO_POSITION_YET, timeout_s=timeout_s)
        await clock.sleep(LOOK_PERIOD_S)
