"""One thread that waits for messages, gives them to the gate, and does what it says.

When several things have come, the application's are first, then the autopilot's, and those of others.
From each a bounded number is taken before the next has its turn, so a flood from one delays nobody else by more than a
few ms, and the cycle comes every `CYCLE_S` whatever comes in.
"""

from __future__ import annotations

import functools
import math
import selectors
from collections.abc import Callable

from companion.gate.allowlist import SETPOINTS
from companion.gate.gate import Gate
from companion.gate.plan import CYCLE_S, Attached, Plan
from companion.gate.protocol import LINK, Notice
from companion.gate.runtime.framing import batches
from companion.gate.runtime.log import Log
from companion.gate.runtime.signals import Signals
from companion.gate.runtime.supervisor import Supervisor
from companion.gate.runtime.systemd import ServiceManager
from companion.gate.runtime.transports import Transport
from companion.mavlink.codec import MAVLINK_2, NAMES, Frame, decode
from companion.mavlink.ids import MavComponent
from companion.mavlink.signing import Signer

STALLED_S = 0.1
"""When nothing was done for longer than this, the gate itself was stopped: what waited meanwhile is as old as that."""
CATCH_UP = 64
"""Calls after which nothing can be left of what waited: more does not fit into the sockets."""

SHOWN = frozenset({"HEARTBEAT", "STATUSTEXT", "NAMED_VALUE_FLOAT", "COMMAND_ACK"})
"""What the application says to everybody: who is attached hears it too."""

_APPLICATION, _AUTOPILOT, _SIGNAL, _ATTACHED = range(4)

Serve = Callable[[float], None]


class Selector:
    """What is waited for, and who is called when something is there: the lowest rank first."""

    def __init__(self) -> None:
        self._selector = selectors.DefaultSelector()
        self._known: dict[int, int] = {}

    def follow(self, rank: int, fd: int | None, serve: Serve) -> None:
        """From now on the door of this rank is ``fd``, or none. A change has to be told before the number is reused."""
        before = self._known.get(rank)
        if before == fd:
            return
        if before is not None:
            self._selector.unregister(before)
            del self._known[rank]
        if fd is not None:
            self._selector.register(fd, selectors.EVENT_READ, (rank, serve))
            self._known[rank] = fd

    def wait(self, timeout_s: float) -> list[Serve]:
        """Whom to call, in order; empty when the time is over, which may be 1 ms late."""
        ready = self._selector.select(max(0.0, timeout_s))
        if len(ready) > 1:
            ready.sort(key=lambda found: found[0].data[0])
        return [found.data[1] for found, _ in ready]

    def close(self) -> None:
        """Wait for nothing more."""
        self._selector.close()


class Loop:
    """Carries messages between the application, the autopilot, whoever is attached, and the gate.

    Args:
        plan: everything it is told.
        gate: decides.
        supervisor: of the application, which was started.
        autopilot: the link to it.
        signer: signs what goes there; None: nobody does.
        attached: who else, and their links.
        signals: what people ask for.
        notifier: the service manager.
        log: for people.
        clock: time in s, CLOCK_MONOTONIC.

    Attributes:
        unsigned: messages that could not be signed, and so were not sent.
        stale: setpoints that had waited while the gate was stopped, and so were not sent.
    """

    def __init__(
        self,
        plan: Plan,
        gate: Gate,
        supervisor: Supervisor,
        autopilot: Transport,
        signer: Signer | None,
        attached: list[tuple[Attached, Transport]],
        signals: Signals,
        notifier: ServiceManager,
        log: Log,
        clock: Callable[[], float],
    ) -> None:
        self.unsigned = self.stale = 0
        self._plan = plan
        self._gate = gate
        self._supervisor = supervisor
        self._autopilot = autopilot
        self._signer = signer
        self._attached = attached
        self._signals = signals
        self._notifier = notifier
        self._log = log
        self._clock = clock
        self._selector = Selector()
        self._selector.follow(_SIGNAL, signals.wake.fileno(), self._on_signal)
        # A wire's rank, and who is called when something is there.
        self._transports = [(_AUTOPILOT, autopilot, self._from_autopilot)] + [
            (_ATTACHED + number, transport, functools.partial(self._from_attached, number))
            for number, (_, transport) in enumerate(attached)
        ]
        self._problems = [""] * len(self._transports)
        self._is_ready = False
        self._told_stage: str | None = None
        self._heard_s = -math.inf
        self._turned_s = self._due_s = clock()

    def run(self) -> int:
        """Until the application has ended, and nothing of it flies any more; gives the exit code."""
        while self._supervisor.exit_code is None:
            self.turn()
        return self._supervisor.exit_code

    def turn(self) -> None:
        """Wait for the next message or cycle, and do what is to be done."""
        callers = self._selector.wait(self._due_s - self._clock())
        now_s = self._clock()
        if now_s > self._turned_s + STALLED_S:
            self._log.say(f"the gate stood still for {now_s - self._turned_s:.2f} s")
            self._catch_up(self._turned_s)
        self._turned_s = now_s
        for serve in callers:
            serve(now_s)
        now_s = self._clock()
        if now_s >= self._due_s:
            self._due_s = max(self._due_s + CYCLE_S, now_s)
            self._cycle(now_s)

    def _catch_up(self, before_s: float) -> None:
        """Take what has waited while the gate was stopped as what it is: nobody knows how old, so as old as can be.

        A pilot's takeover in it counts; that the autopilot lives, or where the vehicle is, it does not tell.
        """
        for _ in range(CATCH_UP):
            self._from_autopilot(before_s)
            for frame in self._supervisor.receive(self._clock()):
                if NAMES.get(frame.message_id) in SETPOINTS:
                    self.stale += 1
                else:
                    self._pass_down(frame, before_s)

    def close(self) -> None:
        """Say what was counted and what is wrong with the link, and wait for nothing more."""
        self._selector.close()
        counts = {**self._gate.counts, "not signed": self.unsigned, "setpoint too old": self.stale}
        for url, transport in [
            (self._plan.autopilot_url, self._autopilot),
            *((a.url, transport) for a, transport in self._attached),
        ]:
            counts |= {
                f"{url}: not sent": transport.unsent,
                f"{url}: of strangers": transport.strangers,
                f"{url}: no message": transport.reader.bad,
                f"{url}: refused": transport.reader.refused,
            }
        self._log.say("; ".join(f"{what}: {number}" for what, number in counts.items() if number) or "nothing refused")
        if self._autopilot.problem:
            # The last word: who was not connected seeks the cause in the last line.
            self._log.say(f"{self._plan.autopilot_url}: {self._autopilot.problem}")

    def _from_application(self, now_s: float) -> None:
        for frame in self._supervisor.receive(now_s):
            self._pass_down(frame, now_s)
        self._follow_child()
        for raw in self._gate.drain_upward():
            self._up(raw)

    def _up(self, raw: bytes) -> None:
        """To the application."""
        if self._supervisor.child is not None:
            self._supervisor.child.send(raw)

    def _pass_down(self, frame: Frame, now_s: float) -> None:
        verdict = self._gate.on_application_message(frame, now_s)
        if verdict.raw is not None:
            self._down(verdict.raw)
        if NAMES.get(frame.message_id) in SHOWN and frame.component_id == MavComponent.ONBOARD_COMPUTER:
            for _, transport in self._attached:
                transport.send(frame.raw)

    def _from_autopilot(self, now_s: float) -> None:
        frames = self._autopilot.receive(now_s)
        self._follow(self._transports[0])
        if not frames:
            return
        self._heard_s = now_s
        spoke = self._gate.on_autopilot_message
        for frame in frames:
            spoke(frame, now_s)
        for batch in batches(frames):
            self._up(batch)
            for _, transport in self._attached:
                transport.send(batch)

    def _from_attached(self, number: int, now_s: float) -> None:
        attached, transport = self._attached[number]
        frames = transport.receive(now_s)
        self._follow(self._transports[1 + number])
        for frame in frames:
            if self._gate.on_attached_message(frame, attached.may, now_s):
                self._down(frame.raw)
            if attached.may == "command" and _concerns_application(frame):
                self._up(frame.raw)

    def _on_signal(self, now_s: float) -> None:
        self._signals.drain()
        self._supervisor.on_child_signal(now_s)
        self._follow_child()
        # A death is answered at once, not at the next cycle.
        self._due_s = now_s

    def _cycle(self, now_s: float) -> None:
        for number, entry in enumerate(self._transports):
            entry[1].tick(now_s)
            self._follow(entry)
            if entry[1].problem != self._problems[number]:
                self._tell_problem(number, entry[1])
        for raw in self._gate.cycle(now_s):
            self._down(raw)
            for _, transport in self._attached:
                transport.send(raw)
        for notice in self._gate.drain_notices(now_s):
            if notice.text:
                self._log.say(notice.text)
            if self._supervisor.child is not None:
                self._supervisor.child.notify(notice)
        for asked in self._signals.requests():
            self._notifier.stopping()
            self._supervisor.request_end(asked)
        self._supervisor.cycle(now_s, now_s - self._heard_s)
        self._follow_child()
        self._tell_service()
        self._notifier.cycle(now_s)

    def _down(self, raw: bytes) -> None:
        """To the autopilot."""
        if self._signer is not None:
            if raw[0] != MAVLINK_2:
                self.unsigned += 1
                return
            raw = self._signer.sign(raw)
        self._autopilot.send(raw)

    def _follow(self, entry: tuple[int, Transport, Serve]) -> None:
        rank, transport, serve = entry
        self._selector.follow(rank, transport.fileno(), serve)

    def _follow_child(self) -> None:
        child = self._supervisor.child
        self._selector.follow(_APPLICATION, None if child is None else child.fileno(), self._from_application)

    def _tell_problem(self, number: int, transport: Transport) -> None:
        self._problems[number] = transport.problem
        url = self._plan.autopilot_url if number == 0 else self._attached[number - 1][0].url
        self._log.say(f"{url}: {transport.problem or 'open'}")
        if number == 0 and self._supervisor.child is not None:
            self._supervisor.child.notify(Notice(self._gate.stage, None, f"{LINK} {transport.problem}"))

    def _tell_service(self) -> None:
        if not self._is_ready and self._autopilot.fileno() is not None:
            self._is_ready = True
            self._notifier.ready()
        stage = self._gate.stage.name.lower()
        if stage != self._told_stage:
            self._told_stage = stage
            self._notifier.status(stage)


def _concerns_application(frame: Frame) -> bool:
    """Whether a message is for the application, or for everybody; never when that cannot be told."""
    fields = decode(frame)
    return fields is not None and fields.get("target_component", 0) in (0, MavComponent.ONBOARD_COMPUTER)
