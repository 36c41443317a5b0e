"""Wires the rooms together: the only place that knows them all."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Coroutine
from contextlib import AsyncExitStack, nullcontext
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from companion.autopilot.announce import Announcer
from companion.autopilot.preflight import CheckResult
from companion.autopilot.vehicle import Vehicle
from companion.background import background
from companion.clock import MonotonicClock
from companion.config.settings import Settings
from companion.config.show import dump_yaml
from companion.ending import Ending, Standing, ending
from companion.errors import EXIT_INTERRUPTED, CompanionError, InputError
from companion.explorer import Explorer
from companion.mapping.map_status import MapError
from companion.mapping.worker import MapWorker
from companion.orders import Orders
from companion.pace import Pace
from companion.pilot import Pilot
from companion.ready import LOOK_PERIOD_S, Options, checked, passed
from companion.recording import FlightInfo, Recorder
from companion.recording.content import ENDED
from companion.session import Session, open_session
from companion.warm_up import warm_up
from companion.watch import Announcements, MapFeed, Recording, Say

CHECKS_HOLD_S = 30.0
"""A start that comes later than this finds the vehicle checked anew: a battery empties, a sensor falls silent."""


class InterruptedFlightError(CompanionError):
    """Ctrl-C, or the end of the service, before the vehicle explored."""

    exit_code = EXIT_INTERRUPTED


async def check(settings: Settings, options: Options, say: Say) -> list[CheckResult]:
    """Connect, listen for a moment and run the pre-flight checks. Nothing is armed."""
    _load(settings, say)
    async with open_session(settings, MonotonicClock()) as session:
        return await checked(session, options, say)


async def fly(settings: Settings, options: Options, say: Say) -> dict[str, Any]:
    """One flight: checks, start, take-off, exploring, and the end as configured.

    Whatever happens in it, the vehicle is left holding or landing, or in its pilot's hands.

    Args:
        settings: the whole configuration.
        options: what the command line adds.
        say: shows a line to the operator.

    Returns:
        The summary, as it is written to ``summary.json`` in the flight's folder.

    Raises:
        FlightRefusedError: a check failed; nothing was armed.
        InterruptedFlightError: Ctrl-C before the vehicle was in control of itself.
        CompanionError: the flight could not begin, or broke off.
    """
    orders = Orders(by_command=settings.mission.start == "command")
    _load(settings, say)
    with orders.signals():
        try:
            async with open_session(settings, MonotonicClock()) as session:
                orders.listen(session.link)
                announcer = Announcer(session.link, session.clock)
                async with background(announcer.run()):
                    results = await passed(session, options, announcer, say)
                    return await _Flight(session, options, orders, announcer, say).run(results)
        except asyncio.CancelledError:
            if not orders.interrupted:
                raise
            raise InterruptedFlightError("stopped before the take-off; nothing was armed") from None


def _load(settings: Settings, say: Say) -> None:
    """Before anything listens: what is compiled while messages arrive makes all of them late."""
    say("loading the navigator (the first time on a computer compiles it, about a minute)")
    warm_up(settings)
    say(f"looking for the autopilot at {settings.autopilot.url}")


class _Flight:
    """From the checks to the summary."""

    def __init__(self, session: Session, options: Options, orders: Orders, announcer: Announcer, say: Say) -> None:
        drawn = int(np.random.SeedSequence().generate_state(1)[0])
        self._session = session
        self._settings = session.settings
        self._options = options
        self._orders = orders
        self._announcer = announcer
        self._seed = drawn if options.seed is None else options.seed
        self._say = say
        self._explored_s: tuple[float, float] | None = None

    async def run(self, results: list[CheckResult]) -> dict[str, Any]:
        settings, session = self._settings, self._session
        folder = _new_folder(Path(settings.record.folder))
        (folder / "settings.yaml").write_text(dump_yaml(settings), encoding="utf-8")
        rng = np.random.default_rng(self._seed)
        info = FlightInfo.of(settings, rng)
        explorer = Explorer(settings, rng)
        async with AsyncExitStack() as stack:
            recorder = stack.enter_context(Recorder(folder / "flight.mcap", settings.record, info, session.clock))
            self._say("starting the map (the first start on a computer compiles it, about a minute)")
            mapper = await stack.enter_async_context(self._mapper(folder))
            announcements = Announcements(self._announcer, session.telemetry, mapper, recorder, self._say)
            announcements.checks(results)
            results = await self._wait_for_start(announcements, results)
            vehicle = Vehicle(session.link, session.telemetry, settings, session.clock)
            pilot = Pilot(
                session.inputs,
                explorer,
                Pace(session.clock, settings.control.period_s),
                vehicle,
                (Recording(recorder, explorer.navigator), MapFeed(mapper), announcements),
            )
            broke_off: Exception | None = None
            try:
                why: str = (await self._in_the_air(vehicle, pilot, mapper, announcements)).value
            except Exception as error:  # noqa: BLE001 - it is raised again, when nothing is lost any more
                # The vehicle holds or lands by now; what was flown for must not be lost with the flight.
                broke_off, why = error, f"broke off: {error}"
                recorder.event(ENDED, why, logging.ERROR)
            files, problem = await self._save(mapper)
            summary = self._summary(why, results, mapper, recorder) | {"map_problem": problem}
        text = json.dumps(summary, indent=2) + "\n"
        (folder / "summary.json").write_text(text, encoding="utf-8")
        self._say(f"{why}: {len(files)} map files and the recording are in {folder}")
        if broke_off is not None:
            raise broke_off
        return summary

    def _mapper(self, folder: Path) -> MapWorker:
        settings = self._settings
        return MapWorker(
            settings.mapping,
            settings.sensors.camera.model(),
            settings.control,
            folder,
            half_slab_m=settings.half_slab_m,
            max_slope=settings.sensors.scan.max_ground_slope,
            clock=self._session.clock,
        )

    async def _save(self, mapper: MapWorker) -> tuple[list[Path], str | None]:
        """The files of the map, or why there are none: a full disk must not end what comes after a flight."""
        self._say("writing the map")
        try:
            return await mapper.save(), None
        except MapError as error:
            self._say(f"the map was not written: {error}")
            return [], str(error)

    async def _wait_for_start(self, announcements: Announcements, results: list[CheckResult]) -> list[CheckResult]:
        """Wait for the order. What was checked long before it is checked again."""
        start, clock = self._settings.mission.start, self._session.clock
        if start == "now":
            return results
        checked_s = clock.now_s()
        announcements.phase("waiting for the start")
        self._say("ready: press Enter to take off" if start == "key" else "ready: waiting for MAV_CMD_MISSION_START")
        self._orders.ready = True
        with self._orders.enter_key() if start == "key" else nullcontext():
            await self._orders.start.wait()
        if clock.now_s() - checked_s > CHECKS_HOLD_S:
            self._say("checking again")
            results = await passed(self._session, self._options, self._announcer, self._say)
            announcements.checks(results)
        return results

    async def _in_the_air(
        self, vehicle: Vehicle, pilot: Pilot, mapper: MapWorker, announcements: Announcements
    ) -> Ending:
        """Take off, explore, end. Leaving the vehicle's context leaves it holding or landing, whatever happened."""
        settings = self._settings
        self._orders.in_the_air = True
        async with background(pilot.run()), vehicle:
            announcements.phase("taking off")
            await self._unless_stopped(vehicle.take_off(settings.control.height_m, pilot.measured_height_m))
            await self._unless_stopped(vehicle.engage())
            began_s = self._session.clock.now_s()
            pilot.fresh_s = began_s
            pilot.exploring = True
            announcements.phase("exploring")
            why = await self._until_the_end(vehicle, pilot, mapper, began_s)
            pilot.exploring = False
            self._explored_s = (began_s, self._session.clock.now_s())
            announcements.ended(why, vehicle.foreign_mode or "")
            if why not in (Ending.PILOT, Ending.DISARMED):
                await (vehicle.land() if settings.mission.end_action == "land" else vehicle.hold())
        return why

    async def _unless_stopped(self, manoeuvre: Coroutine[Any, Any, None]) -> None:
        """Run a manoeuvre; a person's stop breaks it off."""
        task = asyncio.ensure_future(manoeuvre)
        stop = asyncio.ensure_future(self._orders.stop.wait())
        try:
            await asyncio.wait((task, stop), return_when=asyncio.FIRST_COMPLETED)
            if not task.done():
                raise InterruptedFlightError("stopped during the take-off; the vehicle holds or lands")
            task.result()
        finally:
            task.cancel()
            stop.cancel()

    async def _until_the_end(self, vehicle: Vehicle, pilot: Pilot, mapper: MapWorker, began_s: float) -> Ending:
        session = self._session
        battery_s: float | None = None
        while True:
            now_s = session.clock.now_s()
            state = session.telemetry.state(now_s)
            if state.battery_percent is not None:
                battery_s = now_s
            standing = Standing(
                vehicle=state,
                pilot_took_over=vehicle.pilot_took_over,
                stop_asked=self._orders.stop.is_set(),
                complete=mapper.status.complete,
                flown_s=now_s - began_s,
                blind_s=now_s - pilot.fresh_s,
                map_silent_s=mapper.status.age_s,
                battery_silent_s=0.0 if battery_s is None else now_s - battery_s,
            )
            why = ending(standing, self._settings.mission)
            if why is not None:
                return why
            await asyncio.sleep(LOOK_PERIOD_S)

    def _summary(self, why: str, results: list[CheckResult], mapper: MapWorker, recorder: Recorder) -> dict[str, Any]:
        session, status = self._session, mapper.status
        explored_s = self._explored_s or (0.0, 0.0)
        return {
            "preset": self._options.preset,
            "seed": self._seed,
            "autopilot": session.link.kind.value,
            "ended_because": why,
            "as_it_should": why in [ending.value for ending in Ending if ending.as_it_should],
            "interrupted": self._orders.interrupted,
            "explored_s": round(explored_s[1] - explored_s[0], 1),
            "completeness_estimate": status.completeness,
            "recording": recorder.problem or "whole",
            "recording_ticks_dropped": recorder.ticks_dropped,
            "recording_frames_dropped": recorder.frames_dropped,
            "map_frames": status.frames,
            "map_frames_dropped": status.dropped,
            "map_frames_refused": status.refused,
            "map_restarts": status.restarts,
            "unpaired_frames": session.inputs.unpaired,
            "clock_residual_s": session.telemetry.clock_residual_s,
            "skipped_checks": [result.name for result in results if result.skipped],
            "versions": _versions(),
        }


def _new_folder(parent: Path) -> Path:
    folder = parent / f"{datetime.now(UTC):%Y%m%d-%H%M%S}"
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"record.folder = {parent}: {error.strerror}; give a folder that you may write") from None
    return folder


def _versions() -> dict[str, str]:
    return {name: version(name) for name in ("mine-companion", "mavsdk", "numpy", "numba")}
