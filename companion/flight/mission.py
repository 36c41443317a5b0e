"""Wires the rooms together: the only place that knows them all."""

from __future__ import annotations

import asyncio
import json
import logging
from contextlib import AsyncExitStack, nullcontext
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from companion.autopilot.status_reporter import Announcer
from companion.autopilot.vehicle import Vehicle
from companion.clock import MonotonicClock
from companion.config.settings import Settings
from companion.config.show import dump_yaml
from companion.errors import InputError
from companion.flight.airborne import InTheAir
from companion.flight.control_loop import Pilot
from companion.flight.gate_client import GateTalk
from companion.flight.gate_socket import GateLink
from companion.flight.operator_commands import InterruptedFlightError, Orders
from companion.flight.phase import PhaseEvent, PhaseMachine
from companion.flight.preflight import CheckResult
from companion.flight.preflight.run import Options, checked, passed
from companion.flight.rate import Pace
from companion.flight.reporting import Announcements, MapFeed, Recording, Say
from companion.flight.session import Session, open_session
from companion.flight.tasks import background
from companion.flight.termination import Ending
from companion.flight.warm_up import warm_up
from companion.mapping.process.client import MapWorker, check_folder
from companion.mapping.process.status import MapError
from companion.pipeline import Explorer
from companion.recording import FlightInfo, Recorder
from companion.recording.content import ENDED

CHECKS_HOLD_S = 30.0
"""A start that comes later than this finds the vehicle checked anew: a battery empties, a sensor falls silent."""


async def check(settings: Settings, options: Options, gate: GateLink, say: Say) -> list[CheckResult]:
    """Connect, listen for a moment and run the pre-flight checks. Nothing is armed."""
    _load(settings, say)
    clock, flight = MonotonicClock(), PhaseMachine()
    async with open_session(settings, clock, GateTalk(gate, clock, say, flight), flight) as session:
        return await checked(session, options, say)


async def fly(
    settings: Settings, options: Options, gate: GateLink, say: Say, resume_map: Path | None = None
) -> dict[str, Any]:
    """One flight: checks, start, take-off, exploring, and the end as configured.

    Whatever happens in it, the vehicle is left holding or landing, or in its pilot's hands.

    Args:
        settings: the whole configuration.
        options: what the command line adds.
        gate: the safety gate, through which everything goes to the autopilot.
        say: shows a line to the operator.
        resume_map: the folder of an earlier flight whose map goes on, from the same start of the autopilot; the map
            stays in that folder.

    Returns:
        The summary, as it is written to ``summary.json`` in the flight's folder.

    Raises:
        FlightRefusedError: a check failed; nothing was armed.
        InterruptedFlightError: Ctrl-C before the vehicle was in control of itself.
        InputError: there is no map to resume.
        CompanionError: the flight could not begin, or broke off.
    """
    check_folder(resume_map, resume=True)
    flight = PhaseMachine()
    orders = Orders(settings.mission.start == "command", flight)
    _load(settings, say)
    with orders.signals():
        try:
            clock = MonotonicClock()
            async with open_session(settings, clock, GateTalk(gate, clock, say, flight), flight) as session:
                orders.listen(session.link)
                announcer = Announcer(session.link, session.clock)
                async with background(announcer.run()):
                    results = await passed(session, options, announcer, say)
                    return await _Flight(session, options, orders, announcer, say, resume_map).run(results)
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

    def __init__(
        self,
        session: Session,
        options: Options,
        orders: Orders,
        announcer: Announcer,
        say: Say,
        resume_map: Path | None,
    ) -> None:
        drawn = int(np.random.SeedSequence().generate_state(1)[0])
        self._session = session
        self._settings = session.settings
        self._options = options
        self._orders = orders
        self._announcer = announcer
        self._gate = session.gate
        self._seed = drawn if options.seed is None else options.seed
        self._say = say
        self._resume_map = resume_map

    async def run(self, results: list[CheckResult]) -> dict[str, Any]:
        settings, session = self._settings, self._session
        folder = _new_folder(Path(settings.record.folder))
        (folder / "settings.yaml").write_text(dump_yaml(settings), encoding="utf-8")
        rng = np.random.default_rng(self._seed)
        info = FlightInfo.of(settings, rng)
        explorer = Explorer(settings, rng)
        async with AsyncExitStack() as stack:
            recorder = stack.enter_context(Recorder(folder / "flight.mcap", settings.record, info, session.clock))
            self._gate.recorder = recorder
            self._say("starting the map (the first start on a computer compiles it: a minute, on a small one several)")
            map_folder = self._resume_map or folder
            mapper = await stack.enter_async_context(self._mapper(map_folder))
            if self._resume_map is not None:
                self._say(f"the map of {map_folder} goes on: {mapper.status.resumed_chunks} chunks")
            self._gate.has_map(lambda: mapper.status.age_s)
            announcements = Announcements(
                self._announcer, session.telemetry, mapper, recorder, self._say, session.flight
            )
            announcements.checks(results)
            results = await self._wait_for_start(announcements, results)
            vehicle = Vehicle(session.link, session.telemetry, settings, session.clock)
            pilot = Pilot(
                session.inputs,
                explorer,
                Pace(session.clock, settings.control.period_s),
                session.flight,
                vehicle,
                (Recording(recorder, explorer.navigator), MapFeed(mapper), announcements),
                self._gate,
            )
            in_the_air = InTheAir(session, self._orders, vehicle, pilot, mapper, announcements)
            broke_off: Exception | None = None
            try:
                why: str = (await in_the_air.run()).value
            except Exception as error:  # noqa: BLE001 - it is raised again, when nothing is lost any more
                # The vehicle holds or lands by now; what was flown for must not be lost with the flight.
                broke_off, why = error, f"broke off: {error}"
                recorder.event(ENDED, why, logging.ERROR)
            files, problem = await self._save(mapper)
            explored = {
                "explored_s": round(in_the_air.explored_s, 1),
                "map_folder": str(map_folder),
                "map_problem": problem,
            }
            summary = self._summary(why, results, mapper, recorder) | explored
        text = json.dumps(summary, indent=2) + "\n"
        (folder / "summary.json").write_text(text, encoding="utf-8")
        self._say(f"{why}: {len(files)} map files are in {map_folder}, the recording in {folder}")
        if broke_off is not None:
            raise broke_off
        return summary

    def _mapper(self, folder: Path) -> MapWorker:
        settings = self._settings
        return MapWorker(
            settings.mapping,
            (settings.sensors.camera.model(),),
            settings.control,
            folder,
            resume=self._resume_map is not None,
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
        self._session.flight.update(PhaseEvent.READY)
        announcements.phase()
        self._say("ready: press Enter to take off" if start == "key" else "ready: waiting for MAV_CMD_MISSION_START")
        with self._orders.enter_key() if start == "key" else nullcontext():
            await self._orders.start.wait()
        if clock.now_s() - checked_s > CHECKS_HOLD_S:
            self._say("checking again")
            results = await passed(self._session, self._options, self._announcer, self._say)
            announcements.checks(results)
        return results

    def _summary(self, why: str, results: list[CheckResult], mapper: MapWorker, recorder: Recorder) -> dict[str, Any]:
        session, status = self._session, mapper.status
        return {
            "preset": self._options.preset,
            "seed": self._seed,
            "autopilot": session.link.kind.value,
            "ended_because": why,
            "as_it_should": why in [ending.value for ending in Ending if ending.as_it_should],
            "interrupted": self._orders.interrupted,
            "completeness_estimate": status.completeness,
            "recording": recorder.problem or "whole",
            "recording_ticks_dropped": recorder.ticks_dropped,
            "recording_frames_dropped": recorder.frames_dropped,
            "map_frames": status.frames,
            "map_frames_dropped": status.dropped,
            "map_frames_refused": status.refused,
            "map_restarts": status.restarts,
            "map_lost": status.lost,
            "map_scans": status.scans,
            "map_resumed_chunks": status.resumed_chunks,
            "map_memory_mb": round(status.memory_bytes / 1e6, 1),
            "map_journal_mb": round(status.journal_bytes / 1e6, 1),
            "unpaired_frames": session.inputs.unpaired,
            "clock_residual_s": session.telemetry.clock_residual_s,
            "gate_notices": dict(self._gate.counted),
            "beats_unsent": self._gate.beats_unsent,
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
