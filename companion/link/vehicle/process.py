"""The process of the link: tells the ground how the flight stands, answers about the map, and takes commands.

It carries what vehicles tell each other, too.

Three threads: this one speaks with the application; Zenoh's own hand over what comes, and a command goes on to the
application from there at once, before everything else; one answers about the map, as fast as the limit of bandwidth
lets it.
"""

from __future__ import annotations

import logging
import math
import os
import secrets
import select
import socket
import threading
import zlib
from collections import deque
from pathlib import Path
from queue import Empty, Full, Queue

import numpy as np
import zenoh

from companion.clock import MonotonicClock
from companion.config.link import LinkSettings
from companion.errors import CompanionError
from companion.gate.runtime.processes import end_with_parent
from companion.link.answering import sealed_answer
from companion.link.certificates import vehicle_certificates
from companion.link.envelope import Quote, is_session
from companion.link.map_wire import answer, read_ask
from companion.link.sealing import Seal
from companion.link.session import LinkError, close_session, open_session
from companion.link.vehicle.bandwidth import Bandwidth
from companion.link.vehicle.fleet_guard import FleetGuard
from companion.link.vehicle.fleet_post import FleetPost
from companion.link.vehicle.guard import CommandGuard, by_certificate, by_its_word
from companion.link.vehicle.listeners import Listeners
from companion.link.vehicle.map_teller import MapTeller
from companion.link.vehicle.pipe import Kind, receive, send
from companion.link.vehicle.revocation import Revocation
from companion.link.wire import (
    Order,
    RefusedError,
    Report,
    command_topic,
    decoded,
    encoded,
    map_topic,
    telemetry_topic,
)
from companion.link.words import Answer, Telemetry
from companion.mapping.process.supervisor import ignore_the_terminal

LINK_NICENESS = 5
"""The link yields to the control tick, and the map to the link: a stop comes through it."""

LOOK_PERIOD_S = 0.1
BEAT_PERIOD_S = 0.5
FOLLOW_PERIOD_S = 0.4

MOST_WAITING = 32
"""Questions about the map that wait; of more than these the newest get no answer, and are asked again."""

MOST_PENDING = 16
"""Orders that the application has not answered yet."""

ANSWER_TIMEOUT_S = 2.0

MOST_REFUSED, REFUSED_PERIOD_S = 30, 60.0
"""Refusals that are logged in this time."""

MOST_QUOTED = 16
"""Of those at the ground, in each telemetry."""

TELEMETRY_SHARE = 0.25
"""Of the bandwidth; it comes less often where more would be needed."""

ANSWER_S = 0.3
"""An answer about the map takes no more than this of the bandwidth: telemetry has to wait for its end."""

WAY_STEP_M = 0.2
MOST_WAY = 50_000

_log = logging.getLogger(__name__)


def serve(end: socket.socket, settings: LinkSettings, journal: Path, number: int | None) -> None:
    """Be the link until the application ends it, or is gone."""
    ignore_the_terminal()
    end_with_parent(None)
    os.nice(LINK_NICENESS)
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    try:
        process = LinkProcess(end, settings, journal, number)
    except CompanionError as error:
        send(end, Kind.TROUBLE, str(error).encode())
        end.close()
        return
    try:
        process.run()
    except LinkError as error:
        send(end, Kind.TROUBLE, str(error).encode())
    finally:
        process.close()


class LinkProcess:
    """Everything of the process.

    Args:
        end: of the socket pair, to the application.
        settings: of the link.
        journal: folder of the map's journal.
        number: of the vehicle in its fleet; None: it flies alone.

    Raises:
        LinkError: the session cannot be opened.
    """

    def __init__(self, end: socket.socket, settings: LinkSettings, journal: Path, number: int | None = None) -> None:
        self._end = end
        self._settings = settings
        self._clock = MonotonicClock()
        self._session_id = secrets.token_hex(8)
        self._teller = MapTeller(self._session_id, journal, self._clock)
        folder, name = settings.certificates, settings.name
        given = None if folder is None else vehicle_certificates(folder, name, number)
        self._given = given
        self._revocation = None if given is None else Revocation(given)
        self._seal = Seal(self._session_id, given)
        proof = by_its_word if given is None else by_certificate(given, settings.commanders)
        self._guard = CommandGuard(settings.name, self._session_id, settings.oldest_command_s, proof)
        self._bandwidth = Bandwidth(settings.limit_kbps, self._clock.now_s())
        self._listeners = Listeners()
        self._guarded = threading.Lock()
        """Over guard, pending orders, bandwidth and listeners."""
        self._pending: dict[str, tuple[zenoh.Query, float]] = {}
        self._refused_s: deque[float] = deque(maxlen=MOST_REFUSED)
        self._asked: Queue[zenoh.Query] = Queue(MOST_WAITING)
        self._closing = threading.Event()
        self._drawing = 0
        self._last_place: tuple[float, float, float] | None = None
        self._next_telemetry_s = self._next_beat_s = -math.inf
        self._end_s: float | None = None
        self._has_read_all = False
        """Whether the journal was read to its end after the flight."""
        self._fleet: FleetPost | None = None
        if number is not None:
            guard = FleetGuard(name, number, self._session_id, given)
            self._fleet = FleetPost(end, name, guard, self._take, self._bandwidth.bytes_per_s, self._clock)
        self._open()
        self._worker = threading.Thread(target=self._tell_map, name="map", daemon=True)
        self._worker.start()

    def _open(self) -> None:
        """Be heard, and hear.

        Raises:
            LinkError: the session cannot be opened.
        """
        settings, name = self._settings, self._settings.name
        self._zenoh = open_session(settings.listen, settings.connect, self._given)
        self._publisher = self._zenoh.declare_publisher(
            telemetry_topic(name),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )
        self._commands = self._zenoh.declare_queryable(command_topic(name), self._on_command)
        self._map = self._zenoh.declare_queryable(map_topic(name), self._on_ask)
        if self._fleet is not None:
            self._fleet.open(self._zenoh)

    def _cut_revoked(self) -> None:
        """Zenoh asks who may hear only when a session is opened; the others are back within a second or two."""
        if self._revocation is None or not self._revocation.has_changed():
            return
        _log.warning("the list of who is revoked has changed: every connection is made anew")
        with self._guarded:
            # They are asked again, and what has become of them meanwhile is known then.
            self._pending.clear()
        close_session(self._zenoh)
        self._open()

    def run(self) -> None:
        """Until the application is gone, or the flight is over and the ground has everything."""
        while True:
            select.select([self._end], [], [], LOOK_PERIOD_S)
            now_s = self._clock.now_s()
            try:
                while (packet := receive(self._end)) is not None:
                    self._on_packet(*packet)
            except EOFError:
                return
            if self._fleet is not None:
                self._fleet.step()
            self._give_up_late(now_s)
            if now_s >= self._next_beat_s:
                self._next_beat_s = now_s + BEAT_PERIOD_S
                with self._guarded:
                    silent_s = self._listeners.silent_s(now_s)
                send(self._end, Kind.BEAT, f"{silent_s:.2f}".encode())
                self._cut_revoked()
                if self._fleet is not None:
                    self._fleet.tell_refused()
            if self._end_s is not None and self._is_over(now_s):
                return

    def close(self) -> None:
        """End the threads and the session."""
        self._closing.set()
        self._worker.join(2.0)
        close_session(self._zenoh)
        self._teller.close()
        self._end.close()

    def _is_over(self, now_s: float) -> bool:
        with self._guarded:
            has_all = self._has_read_all and self._listeners.have_all(now_s)
            return has_all or now_s - (self._end_s or 0.0) > self._settings.finish_s

    def _on_packet(self, kind: Kind, data: bytes) -> None:
        match kind:
            case Kind.TELEMETRY:
                self._publish(data)
            case Kind.FLEET | Kind.FLEET_GROUND if self._fleet is not None:
                self._fleet.offer(data, with_ground=kind is Kind.FLEET_GROUND)
            case Kind.DRAWING:
                if (drawing := zlib.decompress(data)) != self._teller.drawing:
                    self._teller.drawing = drawing
                    self._drawing += 1
            case Kind.ANSWER:
                self._reply(data[:32].decode(), decoded(Answer, data[32:]))
            case Kind.END:
                self._end_s = self._clock.now_s()
            case _:
                _log.error("the application sent what only the link sends: %s", kind.name)

    def _publish(self, data: bytes) -> None:
        telemetry = decoded(Telemetry, data)
        self._follow_way(telemetry)
        now_s = self._clock.now_s()
        if now_s < self._next_telemetry_s:
            return
        report = Report(self._session_id, now_s, self._teller.map, self._drawing, telemetry)
        message = self._seal.sealed(encoded(report), self._heard(now_s), now_s)
        self._take(len(message))
        slowest_s = len(message) / (TELEMETRY_SHARE * self._bandwidth.bytes_per_s)
        # A little less than the period: what comes a moment early must not be left out.
        self._next_telemetry_s = now_s + max(0.9 / self._settings.telemetry_hz, slowest_s)
        self._publisher.put(message)

    def _heard(self, now_s: float) -> dict[str, Quote]:
        """Those at the ground, by what they call themselves when they ask."""
        with self._guarded:
            recent = self._listeners.recent(now_s)
        return {who: (who, 0) for who in filter(is_session, recent[:MOST_QUOTED])}

    def _take(self, size_bytes: int) -> None:
        with self._guarded:
            self._bandwidth.take(size_bytes, self._clock.now_s())

    def _follow_way(self, telemetry: Telemetry) -> None:
        if telemetry.x_m is None or telemetry.y_m is None or telemetry.z_m is None:
            return
        place, last = (telemetry.x_m, telemetry.y_m, telemetry.z_m), self._last_place
        if (last is None or math.dist(place, last) >= WAY_STEP_M) and len(self._teller.way) < MOST_WAY:
            self._last_place = place
            self._teller.way = np.concatenate([self._teller.way, np.array([place], np.float32)])

    # Commands.

    def _on_command(self, query: zenoh.Query) -> None:
        """In a thread of Zenoh's."""
        try:
            order, known, is_new = self._admitted(query)
        except RefusedError as refusal:
            self._refuse(query, str(refusal))
            return
        if known is not None:
            self._answer(query, known)
        elif is_new and not send(self._end, Kind.ORDER, encoded(order)):
            self._reply(order.id, Answer(accepted=False, reason="the application does not take commands now"))

    def _admitted(self, query: zenoh.Query) -> tuple[Order, Answer | None, bool]:
        """As `CommandGuard.check`; one without an answer waits for it from now on."""
        data, now_s = _payload(query), self._clock.now_s()
        with self._guarded:
            order, known, is_new = self._guard.check(data, now_s)
            if is_new and len(self._pending) >= MOST_PENDING:
                raise RefusedError("the application has not answered the commands before it")
            self._listeners.heard(order.by, now_s)
            if known is None:
                # One that comes again before it was answered is answered in the place of the first, and not later.
                _, give_up_s = self._pending.get(order.id, (query, now_s + ANSWER_TIMEOUT_S))
                self._pending[order.id] = (query, give_up_s)
            return order, known, is_new

    def _refuse(self, query: zenoh.Query, reason: str) -> None:
        now_s = self._clock.now_s()
        self._refused_s.append(now_s)
        # Each is answered; who sends thousands fills neither logs nor recording with them.
        if len(self._refused_s) < MOST_REFUSED or now_s - self._refused_s[0] > REFUSED_PERIOD_S:
            _log.warning("a command was refused: %s", reason)
            send(self._end, Kind.REFUSED, reason.encode())
        self._answer(query, Answer(accepted=False, reason=reason))

    def _reply(self, id_: str, reply: Answer) -> None:
        with self._guarded:
            self._guard.answered(id_, reply)
            query, _ = self._pending.pop(id_, (None, 0.0))
        if query is not None:
            self._answer(query, reply)

    def _answer(self, query: zenoh.Query, reply: Answer) -> None:
        message = sealed_answer(self._seal, _payload(query), encoded(reply))
        self._take(len(message))
        with query:
            query.reply(command_topic(self._settings.name), message, express=True)

    def _give_up_late(self, now_s: float) -> None:
        with self._guarded:
            late = [id_ for id_, (_, give_up_s) in self._pending.items() if now_s > give_up_s]
        for id_ in late:
            self._reply(id_, Answer(accepted=False, reason=f"the application did not answer in {ANSWER_TIMEOUT_S:g} s"))

    # The map.

    def _on_ask(self, query: zenoh.Query) -> None:
        """In a thread of Zenoh's."""
        try:
            self._asked.put_nowait(query)
        except Full:
            with query:
                _log.debug("a question about the map finds too many before it")

    def _tell_map(self) -> None:
        next_follow_s, problem = -math.inf, ""
        while not self._closing.is_set():
            try:
                if self._clock.now_s() >= next_follow_s:
                    next_follow_s = self._clock.now_s() + FOLLOW_PERIOD_S
                    is_over = self._end_s is not None
                    if self._teller.follow():
                        next_follow_s = -math.inf
                        with self._guarded:
                            self._listeners.there_is_more()
                    self._has_read_all = is_over and next_follow_s > 0.0
                with self._asked.get(timeout=LOOK_PERIOD_S if next_follow_s > 0.0 else 0.0) as query:
                    self._tell(query)
            except Empty:
                continue
            except (CompanionError, OSError, zenoh.ZError) as error:
                # Whatever it is, the ground asks again, and commands do not come through here.
                if str(error) != problem:
                    _log.warning("the ground's question about the map got no answer: %s", error)
                problem = str(error)
                next_follow_s = self._clock.now_s() + BEAT_PERIOD_S

    def _tell(self, query: zenoh.Query) -> None:
        question = _payload(query)
        ask = read_ask(question)
        most_bytes = min(ask.most_bytes, max(2_000, int(ANSWER_S * self._bandwidth.bytes_per_s)))
        told, body = self._teller.tell(ask.within(most_bytes))
        message = sealed_answer(self._seal, question, answer(told, body))
        with self._guarded:
            now_s = self._clock.now_s()
            is_all = None
            if ask.what == "chunks":
                is_all = told.epoch == ask.epoch and ask.after == told.head
            self._listeners.heard(ask.by, now_s, is_all)
            wait_s = self._bandwidth.take(len(message), now_s)
        if wait_s > 0.0:
            self._closing.wait(wait_s)
        query.reply(map_topic(self._settings.name), message)


def _payload(query: zenoh.Query) -> bytes:
    return b"" if query.payload is None else query.payload.to_bytes()
