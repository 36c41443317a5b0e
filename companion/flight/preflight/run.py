"""From connected to checked: wait until the autopilot is ready, listen for a while, run the pre-flight checks."""

from __future__ import annotations

import numpy as np

from companion.errors import CompanionError
from companion.flight.events import Event, EventEmitter
from companion.flight.phase import FlightPhase
from companion.flight.preflight import ON_THE_GROUND, CheckResult, refusal, render, run_checks
from companion.flight.preflight.ready import until_ready
from companion.flight.request import FlightRequest
from companion.flight.session import Session
from companion.flight.tasks import background
from companion.pipeline import Explorer

SETTLE_S = 3.0
"""Rates are measured over this time before they are judged."""


class FlightRefusedError(CompanionError):
    """A pre-flight check failed."""


async def passed(
    session: Session, request: FlightRequest, events: EventEmitter, in_air: bool = False
) -> list[CheckResult]:
    """The results, when the vehicle may fly; told to the pilot when it may not.

    Args:
        session: listens.
        request: which checks are skipped, and whether parameters are set.
        events: who is told.
        in_air: it is handed over in the air: what is about a vehicle that stands is left out, and nothing is set.
    """
    results = await checked(session, request, events, in_air)
    why = refusal(results)
    if why is None:
        return results
    names = ", ".join(result.name for result in results if result.failed)
    events.emit(Event.REFUSED, results=render(results), failed=names)
    raise FlightRefusedError(why)


async def checked(
    session: Session, request: FlightRequest, events: EventEmitter, in_air: bool = False
) -> list[CheckResult]:
    """Wait until the autopilot is ready, listen for a while, and look at everything. Arguments as of `passed`."""
    settings, clock = session.settings, session.clock
    control_loop = session.control_loop(Explorer(settings, np.random.default_rng(0)))
    async with background(control_loop.run()):
        events.emit(Event.CONNECTED)
        await until_ready(session.link, session.telemetry, settings.autopilot, clock, events)
        await clock.sleep(SETTLE_S)
        for text in session.sink.warnings():
            events.emit(Event.SENSOR_WARNING, text=text)
        return await run_checks(
            session.link,
            session.telemetry,
            settings,
            session.sink.statistics(clock.now_s()),
            fix=request.fix and not in_air,
            skip=(*settings.mission.skip_checks, *request.skip, *(ON_THE_GROUND if in_air else ())),
            height_m=control_loop.measured_height_m(),
            clock=clock,
            link_problem=session.gate.link_problem,
            rc_switch=session.rc_switch,
            started=session.flight.phase >= FlightPhase.WAITING,
        )
