"""Wires the rooms together: the only place that knows them all."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from contextlib import AsyncExitStack, nullcontext
from dataclasses import asdict, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from companion.autopilot.handover import Handover
from companion.autopilot.status_reporter import StatusReporter
from companion.autopilot.vehicle import Vehicle
from companion.clock import MonotonicClock
from companion.config.settings import Settings
from companion.config.show import dump_yaml
from companion.control.left_out import LeftOut, in_words, merged, so_many, to_explore
from companion.errors import InputError
from companion.flight.airborne import Airborne
from companion.flight.coming_home import Homecoming
from companion.flight.company import in_company
from companion.flight.events import Event, EventEmitter, console, recording, status_text
from companion.flight.gate_client import GateClient
from companion.flight.gate_socket import GateSocket
from companion.flight.ground_link import GroundLink, linked
from companion.flight.mavlink_commands import MavlinkCommands, Refusals
from companion.flight.navigation_files import EarlierGround, Navigation
from companion.flight.operator_commands import InterruptedFlightError, OperatorCommands, UnfinishedError
from companion.flight.phase import PhaseEvent, PhaseMachine
from companion.flight.preflight import CheckResult
from companion.flight.preflight.ready import LOOK_PERIOD_S
from companion.flight.preflight.run import checked, passed
from companion.flight.reporting import TickReporter, map_feed
from companion.flight.request import FlightRequest
from companion.flight.session import Session, open_session
from companion.flight.situation import Situation
from companion.flight.switch_commands import SwitchCommands
from companion.flight.tasks import background, first_of
from companion.flight.termination import Termination
from companion.flight.warm_up import warm_up
from companion.gate.runtime.processes import end_with_parent
from companion.mapping.files.whole import whole_file
from companion.mapping.journal import JOURNAL_NAME
from companion.mapping.process.client import MapClient, check_folder
from companion.mapping.process.messages import MapError
from companion.model import Pose
from companion.pipeline import Explorer
from companion.recording import RECORDING_NAME, FlightInfo, Recorder
from companion.recording.folder import make_folder
from companion.safety_case.passages import passages

Show = Callable[[str], None]

CHECKS_HOLD_S = 30.0
"""A start that comes later than this finds the vehicle checked anew: a battery empties, a sensor falls silent."""


async def check(request: FlightRequest, gate: GateSocket, show: Show) -> list[CheckResult]:
    """Connect, listen for a moment and run the pre-flight checks. Nothing is armed."""
    events = EventEmitter(console(show))
    settings = request.settings
    _load(settings, events)
    clock, flight = MonotonicClock(), PhaseMachine()
    async with open_session(settings, clock, GateClient(gate, clock, events, flight), flight) as session:
        return await checked(session, request, events)


async def fly(request: FlightRequest, gate: GateSocket, show: Show) -> dict[str, Any]:
    """One flight: checks, start, take-off, exploring, and the end as configured.

    Whatever happens in it, the vehicle is left holding or landing, or in its pilot's hands.

    Args:
        request: the settings, and what the command line adds.
        gate: the safety gate, through which everything goes to the autopilot.
        show: prints a line for the operator.

    Returns:
        The summary, as it is written to ``summary.json`` in the flight's folder.

    Raises:
        FlightRefusedError: a check failed; nothing was armed.
        InterruptedFlightError: Ctrl-C before the vehicle was in control of itself.
        InputError: there is no map to resume.
        CompanionError: the flight could not begin, or broke off.
    """
    settings = request.settings
    check_folder(request.resume_map, resume=True)
    flight = PhaseMachine()
    operator = OperatorCommands(settings.mission.start == "command", flight)
    events = EventEmitter(console(show))
    _load(settings, events)
    with operator.signals():
        try:
            clock = MonotonicClock()
            async with open_session(settings, clock, GateClient(gate, clock, events, flight), flight) as session:
                refusals = Refusals(events, clock)
                MavlinkCommands(operator, session.link, refusals)
                if session.rc_switch is not None:
                    switch = SwitchCommands(settings.mission.rc_switch, operator, flight, refusals)
                    session.rc_switch.follow(switch.on_move)
                status_reporter = StatusReporter(session.link, session.clock)
                events.add(status_text(status_reporter))
                async with background(status_reporter.run()):
                    results = await passed(session, request, events)
                    return await _Flight(session, request, operator, status_reporter, events).run(results)
        except asyncio.CancelledError:
            if not operator.interrupted:
                raise
            raise InterruptedFlightError("stopped before the take-off; nothing was armed") from None


def _load(settings: Settings, events: EventEmitter) -> None:
    """Before anything listens: what is compiled while messages arrive makes all of them late."""
    events.emit(Event.LOADING)
    warm_up(settings)
    end_with_parent(None)
    events.emit(Event.CONNECTING, url=settings.autopilot.url)


class _Flight:
    """From the checks to the summary."""

    def __init__(
        self,
        session: Session,
        request: FlightRequest,
        operator: OperatorCommands,
        status_reporter: StatusReporter,
        events: EventEmitter,
    ) -> None:
        drawn = int(np.random.SeedSequence().generate_state(1)[0])
        self._session = session
        self._settings = session.settings
        self._request = request
        self._operator = operator
        self._status_reporter = status_reporter
        self._gate = session.gate
        self._seed = drawn if request.seed is None else request.seed
        self._events = events

    async def run(self, results: list[CheckResult]) -> dict[str, Any]:
        settings, session, events = self._settings, self._session, self._events
        folder = self._new_folder(Path(settings.record.folder))
        rng = np.random.default_rng(self._seed)
        info = FlightInfo.of(settings, rng)
        explorer = Explorer(settings, rng)
        earlier = EarlierGround.taken_up(explorer.navigator.known_ground, self._request.resume_map)
        info = replace(info, known_ground=earlier.content)
        async with AsyncExitStack() as stack:
            recorder = stack.enter_context(Recorder(folder / RECORDING_NAME, settings.record, info, session.clock))
            events.add(recording(recorder))
            events.emit(Event.MAP_STARTING)
            map_folder = self._request.resume_map or folder
            mapper = await stack.enter_async_context(self._mapper(map_folder))
            if self._request.resume_map is not None:
                events.emit(Event.MAP_RESUMED, folder=map_folder, chunks=mapper.status.resumed_chunks)
            earlier.tell(events)
            self._gate.has_map(lambda: mapper.status.age_s)
            situation = self._situation(folder.name, mapper, explorer)
            link = await self._link(stack, map_folder, situation, mapper, explorer)
            self._record(results)
            results = await self._wait_for_start(results)
            vehicle = Vehicle(session.link, session.telemetry, settings, session.clock)
            reporter = TickReporter(
                events, self._status_reporter, session.telemetry, mapper, session.flight, session.sink.warnings
            )
            watchers = (recorder.tick, map_feed(mapper), reporter, situation)
            company = await stack.enter_async_context(
                in_company(settings, explorer, session.clock, None if link is None else link.client)
            )
            situation.company = company
            control_loop = session.control_loop(explorer, vehicle.send, watchers, company)
            airborne = Airborne(session, self._operator, vehicle, control_loop, mapper, events)
            situation.prospect = lambda: airborne.prospect
            broke_off: Exception | None = None
            try:
                why: str = (await airborne.run()).value
            except Exception as error:  # noqa: BLE001 - it is raised again, when nothing is lost any more
                # The vehicle holds or lands by now; what was flown for must not be lost with the flight.
                broke_off, why = error, f"broke off: {error}"
                events.emit(Event.BROKE_OFF, why=why)
            situation.ended_because = why
            if company is not None and not session.telemetry.state(session.clock.now_s()).armed:
                company.landed()
            navigation = Navigation.of(explorer.navigator)
            files, problem = await self._save(mapper, navigation, map_folder, folder, earlier.window is not None)
            if link is not None:
                await link.finish()
            # Not in the loop: the gate goes on hearing of us.
            on_ground = await asyncio.to_thread(_left_out_on_ground, explorer, airborne.end)
            left_out = merged((*on_ground, *mapper.left_out))
            home = airborne.homecoming
            summary = self._summary(why, results, mapper, recorder) | {
                "as_it_should": _is_as_it_should(why, home),
                "end": None if home is None else home.as_json(),
                "explored_s": round(airborne.explored_s, 1),
                "done_at_s": airborne.done_at_s,
                "known_before_m2": earlier.free_m2,
                "left_out": [place.as_json() for place in left_out],
                "map_folder": str(map_folder),
                "graph": navigation.graph.counts()._asdict(),
                "map_problem": problem,
                "fleet": None if company is None else company.summary(),
            }
        try:
            with whole_file(folder / "summary.json") as file:
                file.write((json.dumps(summary, indent=2) + "\n").encode())
        except OSError as error:
            # The flight is over, and has ended as it has: a full disk makes no failure of it.
            events.emit(Event.SUMMARY_NOT_WRITTEN, error=error.strerror, summary=json.dumps(summary))
        events.emit(Event.LEFT_OUT, share=summary["estimated_completeness"], places=in_words(left_out))
        events.emit(Event.OVER, why=why, files=len(files), map_folder=map_folder, folder=folder)
        if (left := to_explore(left_out)) and why != Termination.COMPLETE:
            events.emit(Event.LEFT_TO_EXPLORE, places=so_many(left), map_folder=map_folder)
        if broke_off is not None:
            raise broke_off
        return summary

    def _new_folder(self, parent: Path) -> Path:
        wanted = parent / f"{datetime.now(UTC):%Y%m%d-%H%M%S}"
        try:
            folder = make_folder(wanted)
            (folder / "settings.yaml").write_text(dump_yaml(self._settings), encoding="utf-8")
        except OSError as error:
            raise InputError(f"record.folder = {parent}: {error.strerror}; give a folder that you may write") from None
        if folder != wanted:
            self._events.emit(Event.NAME_TAKEN, wanted=wanted, folder=folder)
        return folder

    def _mapper(self, folder: Path) -> MapClient:
        settings = self._settings
        return MapClient(
            settings.mapping,
            (settings.sensors.camera.model(),),
            settings.control,
            folder,
            resume=self._request.resume_map is not None,
            half_slab_m=settings.half_slab_m,
            max_slope=settings.sensors.scan.max_ground_slope,
            clock=self._session.clock,
        )

    def _situation(self, name: str, mapper: MapClient, explorer: Explorer) -> Situation:
        session, settings = self._session, self._settings
        return Situation(
            settings.link.name,
            name,
            settings.control.margin_m,
            settings.mission.reserve_percent,
            session.flight,
            session.telemetry,
            mapper,
            explorer,
            session.clock,
        )

    async def _link(
        self, stack: AsyncExitStack, map_folder: Path, situation: Situation, mapper: MapClient, explorer: Explorer
    ) -> GroundLink | None:
        """The link to the ground, where there is to be one; it ends with the stack."""
        session, settings = self._session, self._settings
        if not settings.link.enabled:
            return None
        self._events.add(situation.sink)
        journal, clock = map_folder / JOURNAL_NAME, session.clock
        link = GroundLink(
            settings, journal, situation, explorer, mapper, self._operator, session.flight, self._events, clock
        )
        return await stack.enter_async_context(linked(link))

    async def _save(
        self, mapper: MapClient, navigation: Navigation, map_folder: Path, folder: Path, goes_on: bool
    ) -> tuple[list[Path], str | None]:
        """The files of the map, or why there are none: a full disk must not end what comes after a flight."""
        events = self._events
        events.emit(Event.MAP_WRITING)

        async def write() -> list[Path]:
            try:
                await asyncio.to_thread(navigation.write, map_folder, folder, goes_on)
            except Exception as error:  # noqa: BLE001 - whatever it is, it must not cost the map
                events.emit(Event.GRAPH_NOT_WRITTEN, error=error)
            return await mapper.save()

        try:
            return await self._operator.finish(write(), lambda: events.emit(Event.MAP_STILL_WRITTEN)), None
        except (MapError, UnfinishedError) as error:
            events.emit(Event.MAP_NOT_WRITTEN, error=error)
            return [], str(error)

    async def _wait_for_start(self, results: list[CheckResult]) -> list[CheckResult]:
        """Wait for the order. What was checked long before it is checked again."""
        start, clock = self._settings.mission.start, self._session.clock
        if start == "now":
            return results
        checked_s = clock.now_s()
        self._session.flight.update(PhaseEvent.READY)
        self._events.emit(Event.WAITING)
        self._events.emit(Event.READY_FOR_KEY if start == "key" else Event.READY_FOR_COMMAND)
        with self._operator.enter_key() if start == "key" else nullcontext():
            while True:
                starts = (self._operator.start.wait(), *((self._handed_over(),) if start == "command" else ()))
                for started in await first_of(*starts):
                    started.result()  # what failed is no start
                if clock.now_s() - checked_s > CHECKS_HOLD_S:
                    self._events.emit(Event.CHECKING_AGAIN)
                    results = await passed(self._session, self._request, self._events, self._operator.in_air)
                    self._record(results)
                    checked_s = clock.now_s()
                if self._operator.start.is_set():
                    return results
                # A stop came while it was checked: it takes the start back.
                self._events.emit(Event.WAITING)

    async def _handed_over(self) -> None:
        """Until the autopilot's own mission hands over the vehicle in the air, which is a start."""
        session, handover = self._session, Handover(self._session.link)
        while not handover.is_ours(session.telemetry.state(session.clock.now_s()), session.clock.now_s()):
            await session.clock.sleep(LOOK_PERIOD_S)
        self._operator.in_air = True
        self._operator.start.set()

    def _record(self, results: list[CheckResult]) -> None:
        """Put every check on record, above all those that were skipped."""
        for result in results:
            event = Event.CHECK_SKIPPED if result.skipped else Event.CHECK_PASSED
            self._events.emit(event, name=result.name, found=result.found)

    def _summary(self, why: str, results: list[CheckResult], mapper: MapClient, recorder: Recorder) -> dict[str, Any]:
        session, status = self._session, mapper.status
        return {
            "preset": self._request.preset,
            "seed": self._seed,
            "autopilot": session.link.kind.value,
            "ended_because": why,
            "interrupted": self._operator.interrupted,
            "estimated_completeness": status.completeness,
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
            "passages": asdict(passages(self._settings)),
            "beats_unsent": self._gate.socket.unsent,
            "skipped_checks": [result.name for result in results if result.skipped],
            "versions": {name: version(name) for name in ("mine-companion", "mavsdk", "numpy", "numba")},
        }


def _is_as_it_should(why: str, home: Homecoming | None) -> bool:
    """Whether the mission did what it was sent for or asked for, and so did the way home where there was one."""
    explored = why in [termination.value for termination in Termination if termination.as_it_should]
    return explored and (home is None or home.as_it_should)


def _left_out_on_ground(explorer: Explorer, end: Pose | None) -> tuple[LeftOut, ...]:
    """What was seen of the ground and not looked into; nothing is known of it where no place is known."""
    return () if end is None else tuple(explorer.navigator.left_out(end))
