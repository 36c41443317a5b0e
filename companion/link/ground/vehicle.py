"""A vehicle as the ground knows it over the link: a `VehicleView`."""

from __future__ import annotations

import logging
import math
import secrets
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import zenoh

from companion.clock import MonotonicClock
from companion.errors import CompanionError
from companion.link.drawing import Drawing, read_drawing
from companion.link.ground.asking import Asker
from companion.link.ground.signing import Signer
from companion.link.ground.sync import MapSync, is_map_name
from companion.link.map_wire import Ask, Told, asked, read_answer
from companion.link.wire import Order, Report, WireError, command_topic, decoded, encoded, map_topic
from companion.link.words import Answer, Command, Place, Telemetry
from companion.mapping.voxels.piece import MapSnapshot, MapSource
from companion.model import FloatArray
from companion.viewer.graphs import GraphLines, graph_lines

POLL_PERIOD_S = 0.5
"""The map is asked for news this often when nothing is missing."""

EXTRAS_PERIOD_S = 2.0
"""Way, graph and frontiers are asked for this often at most."""

DRAWING_SHARE = 0.1
"""Of the time: a large graph on a thin link must leave the map its turn."""

REST_S = 0.3
FIRST_TIMEOUT_S, LEAST_TIMEOUT_S, MOST_TIMEOUT_S = 3.0, 0.5, 20.0

ATTEMPT_S = 0.5
"""Without an answer a command is sent again after this long, "again" in it."""

GIVE_UP_S = 5.0

MOST_UNDER_WAY = 16

DOUBT_S = 15.0
"""So long it is told that something was refused."""

_BYTES_PER_PLACE = 12

_log = logging.getLogger(__name__)


class LinkedVehicle:
    """One vehicle. A thread of its own asks for its map.

    Args:
        name: of the vehicle.
        folder: for its maps.
        asker: asks it.
        by: who asks, for the vehicle.
        signer: signs the commands.
    """

    def __init__(self, name: str, folder: Path, asker: Asker, by: str, signer: Signer) -> None:
        self._name = name
        self._asker = asker
        self._by = by
        self._signer = signer
        self._clock = MonotonicClock()
        self._sync = MapSync(folder, by, self._clock)
        self._report: Report | None = None
        self._heard_s = -math.inf
        self._doubt, self._doubted_s = "", -math.inf
        self._greets = False
        self._way_m = np.empty((0, 3), np.float32)
        self._way_after = 0
        self._drawing = Drawing()
        self._drawing_number = 0
        self._next_drawing_s = -math.inf
        self._under_way = threading.Semaphore(MOST_UNDER_WAY)
        self._news = threading.Event()
        self._closing = threading.Event()
        self._folder = folder
        self._thread = threading.Thread(target=self._run, name=f"map of {name}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, and keep the copy."""
        self._closing.set()
        self._news.set()
        self._thread.join(MOST_TIMEOUT_S)
        self._sync.close()

    @property
    def name(self) -> str:
        """Its name."""
        return self._name

    @property
    def telemetry(self) -> Telemetry | None:
        """The newest; None before the first."""
        return None if self._report is None else self._report.telemetry

    @property
    def age_s(self) -> float:
        """Since anything was heard of it; infinite before."""
        return self._clock.now_s() - self._heard_s

    @property
    def map_age_s(self) -> float:
        """How old what is missing of its map is; 0 when nothing is, infinite where nothing is known."""
        return self._sync.age_s

    @property
    def map_number(self) -> int:
        """Grows when another map is told of, or the copy begins anew: what was shown of it before is void."""
        return self._sync.number

    @property
    def map_sum(self) -> str:
        """The sum over its chunks, equal to the vehicle's where the maps are equal; empty without a map."""
        copy = self._sync.copy
        return "" if copy is None else copy.sum

    @property
    def has_whole_map(self) -> bool:
        """Whether the copy was, bit for bit, the vehicle's map by its last word."""
        return self._sync.has_all

    def changed(self, revision: int) -> MapSnapshot:
        """The states of the chunks that changed after a revision of the ground's copy; 0: of all."""
        copy = self._sync.copy
        if copy is None:
            return MapSnapshot(1.0, 0, np.empty((0, 3), np.int32), np.empty((0, 4096), np.uint8))
        return copy.changed(revision)

    def source(self) -> MapSource:
        """The ground's copy of its map.

        Raises:
            CompanionError: there is none yet.
        """
        copy = self._sync.copy
        if copy is None:
            raise CompanionError(f"nothing of the map of {self._name} has come yet: wait until it does")
        return copy

    def way_m(self) -> FloatArray:
        """(n, 3) the way flown, as far as it was heard of."""
        return self._way_m.astype(np.float64)

    def graph(self) -> Sequence[GraphLines]:
        """The navigation graph; empty while none has come."""
        return graph_lines([self._drawing.graph])

    def frontiers_m(self) -> Sequence[Place]:
        """What is left to explore."""
        return self._drawing.frontiers_m

    def ask(self, command: Command, on_answer: Callable[[Answer | None], None]) -> None:
        """Send a command, again until it is answered; ``on_answer`` is called once, from another thread."""
        report, heard_s = self._report, self._heard_s
        if report is None:
            on_answer(Answer(accepted=False, reason=f"{self._name} has not been heard: is it on, and in reach?"))
            return
        if not self._under_way.acquire(blocking=False):
            on_answer(Answer(accepted=False, reason=f"{MOST_UNDER_WAY} commands have no answer yet: wait a moment"))
            return
        # The vehicle's own clock, as it must stand now: the computers' clocks need not agree.
        clock_s = report.clock_s + self._clock.now_s() - heard_s
        order = Order(secrets.token_hex(16), 1, self._name, report.session, clock_s, command, self._signer.name)
        threading.Thread(target=self._send, args=(order, on_answer), name=command.value, daemon=True).start()

    @property
    def doubt(self) -> str:
        """Why something that claimed to be of it was refused in the last seconds; empty when nothing was."""
        return self._doubt if self._clock.now_s() - self._doubted_s <= DOUBT_S else ""

    def refused(self, why: str) -> None:
        """What came as its telemetry, or as its answer, is not."""
        self._doubt, self._doubted_s = why, self._clock.now_s()

    def greet(self) -> None:
        """It has not shown yet that it speaks now: once it has been asked something it quotes who asked."""
        self._greets = True
        self._news.set()

    def heard(self, report: Report) -> None:
        """Telemetry came."""
        before = self._report
        if before is not None and before.session == report.session and report.clock_s <= before.clock_s:
            return  # overtaken
        if before is None or before.session != report.session:
            self._way_after = self._drawing_number = 0
        if before is not None and before.telemetry.flight != report.telemetry.flight:
            self._way_m = np.empty((0, 3), np.float32)
        self._report, self._heard_s = report, self._clock.now_s()
        self._news.set()

    # Commands.

    def _send(self, order: Order, on_answer: Callable[[Answer | None], None]) -> None:
        answer: Answer | None = None
        try:
            answer = self._answer(order)
        except (CompanionError, zenoh.ZError) as error:
            answer = Answer(accepted=False, reason=str(error))
        finally:
            self._under_way.release()
            on_answer(answer)

    def _answer(self, order: Order) -> Answer | None:
        give_up_s = time.monotonic() + GIVE_UP_S
        for attempt in range(1, 2 + int(GIVE_UP_S / ATTEMPT_S)):
            next_s = time.monotonic() + ATTEMPT_S
            message = encoded(self._signer.signed(order, attempt))
            data = self._asker.ask(command_topic(self._name), message, ATTEMPT_S, zenoh.Priority.REAL_TIME)
            if data is not None:
                return decoded(Answer, data)
            # Without a connection there is no waiting in the call.
            self._closing.wait(max(0.0, min(next_s, give_up_s) - time.monotonic()))
            if time.monotonic() >= give_up_s or self._closing.is_set():
                break
        return None

    # The map.

    def _run(self) -> None:
        timeout_s = FIRST_TIMEOUT_S
        next_extras_s = -math.inf
        # Here, and not where telemetry comes: to open a large copy takes seconds.
        if (newest := _newest_map(self._folder)) is not None:
            self._sync.follow(newest)
        while not self._closing.is_set():
            rest_s = REST_S
            try:
                if self._greets:
                    self._greets = False
                    self._told(Ask("chunks", by=self._by), timeout_s)
                report = self._report
                if report is not None and is_map_name(report.map):
                    self._sync.follow(report.map)
                if self._sync.map and self.age_s < MOST_TIMEOUT_S:
                    took_s = self._ask_once(self._sync.next_ask(), timeout_s)
                    if took_s is None:
                        timeout_s = min(MOST_TIMEOUT_S, 2.0 * timeout_s)
                    else:
                        timeout_s = max(LEAST_TIMEOUT_S, 4.0 * took_s)
                        rest_s = POLL_PERIOD_S if self._sync.has_all else 0.0
                if report is not None and self._clock.now_s() >= next_extras_s:
                    next_extras_s = self._clock.now_s() + EXTRAS_PERIOD_S
                    self._ask_extras(report, timeout_s)
                self._sync.problem = ""
            except (CompanionError, OSError, zenoh.ZError) as error:
                problem = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
                if problem != self._sync.problem:
                    _log.error("the map of %s: %s", self._name, problem)
                self._sync.problem = problem
                rest_s = POLL_PERIOD_S
            self._closing.wait(rest_s)

    def _ask_once(self, ask: Ask, timeout_s: float) -> float | None:
        """Ask and take the answer; how long that took, None when none came."""
        began_s = self._clock.now_s()
        found = self._told(ask, timeout_s)
        took_s = self._clock.now_s() - began_s
        if found is None:
            if took_s >= 0.9 * timeout_s:
                self._sync.lost()
            return None
        told, body, size_bytes = found
        self._sync.take(ask, told, body, size_bytes, took_s)
        return took_s

    def _ask_extras(self, report: Report, timeout_s: float) -> None:
        """Way, graph and frontiers, as far as there is news."""
        found = self._told(Ask("way", after=self._way_after, by=self._by), timeout_s)
        if found is not None:
            told, body, _ = found
            if len(body) % _BYTES_PER_PLACE:
                raise WireError("no way came")
            places = np.frombuffer(body, np.float32).reshape(-1, 3)
            if len(places) and np.isfinite(places).all():
                self._way_m = np.concatenate([self._way_m, places])
            self._way_after = told.until
        began_s = self._clock.now_s()
        if report.drawing != self._drawing_number and began_s >= self._next_drawing_s:
            found = self._told(Ask("drawing", by=self._by), MOST_TIMEOUT_S)
            self._next_drawing_s = began_s + (self._clock.now_s() - began_s) / DRAWING_SHARE
            if found is not None:
                self._drawing = read_drawing(found[1])
                self._drawing_number = report.drawing

    def _told(self, ask: Ask, timeout_s: float) -> tuple[Told, bytes, int] | None:
        question = asked(replace(ask, nonce=secrets.token_hex(8)))
        data = self._asker.ask(map_topic(self._name), question, timeout_s, zenoh.Priority.DATA_LOW)
        return None if data is None else (*read_answer(data), len(data))


def _newest_map(folder: Path) -> str | None:
    """The name of the map in a vehicle's folder that changed last; None where there is none."""
    maps = [path for path in folder.iterdir() if is_map_name(path.name)] if folder.is_dir() else []
    return max(maps, key=lambda path: path.stat().st_mtime).name if maps else None
