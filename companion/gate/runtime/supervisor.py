"""Starts the application, watches it, and starts it again when it died and nothing flies any more."""

from __future__ import annotations

import os
import signal

from companion.gate.faults import Stage
from companion.gate.gate import Gate
from companion.gate.plan import Plan
from companion.gate.protocol import unpacked
from companion.gate.runtime.child import Child
from companion.gate.runtime.log import Log
from companion.gate.runtime.processes import children, deaths, exit_code_of, kill
from companion.mavlink.codec import Frame

REST_S = 3.0
"""From a death to the next start; what the dead one has started itself has this long to end in good order."""
LEAVE_S = 10.0
"""An application that has said goodbye has this long to end."""
LOOK_S = 1.0
EXIT_FAILED = 1
DRAINS = 16
"""Calls after which nothing can be left of the words of one who has ended: more do not fit into the socket."""
GONE_S = 10.0
"""An autopilot that was silent for this long is not waited for when the end was asked for."""
WAITED_S = 60.0
"""Nor one that was silent for this long in any case: a radio that comes back has come back by then."""
WRITES_S = 660.0
"""With an autopilot that is gone nothing flies by beats; the application has this long to write what it flew for."""


class Supervisor:
    """Keeps one application running.

    Args:
        plan: how it is started, and how often again.
        gate: is told of its life and death.
        log: for people.

    Attributes:
        child: None while there is none.
        exit_code: of the gate; None: it goes on.
    """

    def __init__(self, plan: Plan, gate: Gate, log: Log) -> None:
        self.child: Child | None = None
        self.exit_code: int | None = None
        self._plan = plan
        self._gate = gate
        self._log = log
        self._nice = os.getpriority(os.PRIO_PROCESS, 0)
        self._starts = 0
        self._heard = False
        self._asked = False
        self._killed = ""
        self._told = ""
        self._goodbye_s: float | None = None
        self._goodbye_code: int | None = None
        self._died_s = 0.0
        self._looked_s = 0.0

    def start(self) -> None:
        """Start it.

        Raises:
            OSError: it cannot be started.
        """
        self._starts += 1
        self._told = ""
        command = self._plan.command if self._starts == 1 else self._plan.restart_command
        self._killed = ""
        self._goodbye_s = None
        self.child = Child(command, self._plan.inherit, self._nice)
        self._gate.on_application_started()
        self._log.say(f"the application was started (process {self.child.pid})")

    def receive(self, now_s: float) -> list[Frame]:
        """Give the gate the words of the application that have come; gives the MAVLink that came with them.

        A beat always comes before the setpoint that rests on it, so the gate knows it by then.
        """
        frames: list[Frame] = []
        for said in [] if self.child is None else self.child.receive():
            if isinstance(said, bytes):
                self._heard = self._heard or unpacked(said) is not None
                self._gate.on_word(said, now_s)
            else:
                frames.append(said)
        return frames

    def request_end(self, number: signal.Signals | None) -> None:
        """Somebody asks for the end: pass the signal on; None: the application has it already."""
        self._asked = True
        if self.child is not None and number is not None:
            self.child.signal(number)
        elif self.child is None:
            self._told = ""

    def on_child_signal(self, now_s: float) -> None:
        """Hear of the end of the application, at once and whatever flies; leave is taken of it later."""
        if self.child is not None and (code := exit_code_of(self.child.pid)) is not None:
            self._ended(self.child, code, now_s)

    def cycle(self, now_s: float, autopilot_silent_s: float) -> None:
        """Whatever time brings: a hang, a last word, a restart."""
        if self.exit_code is not None:
            return
        if self.child is not None:
            self._look_after(self.child, now_s, autopilot_silent_s)
        else:
            self._after_death(now_s, autopilot_silent_s)

    def close(self) -> None:
        """Leave it: it sees the end of its socket, and ends."""
        if self.child is not None:
            self.child.close()

    def _look_after(self, child: Child, now_s: float, autopilot_silent_s: float) -> None:
        if self._gate.goodbye is not None and self._goodbye_s is None:
            self._goodbye_s = now_s
        if self._killed:
            return
        patience_s = WRITES_S if autopilot_silent_s > GONE_S else 0.0
        if self._gate.hangs(now_s - patience_s):
            self._killed = f"hung for {self._plan.thresholds.hang_s:g} s"
        elif self._goodbye_s is not None and now_s > self._goodbye_s + LEAVE_S:
            self._killed = f"did not end within {LEAVE_S:g} s of its last word"
        if self._killed:
            self._log.say(f"the application {self._killed}; it is killed")
            kill(child.pid)

    def _ended(self, child: Child, code: int, now_s: float) -> None:
        for _ in range(DRAINS):
            self.receive(now_s)
        child.close()
        self.child = None
        self._died_s = now_s
        how = (
            f"ended with exit code {code}" if code >= 0 else f"was ended by signal {-code} ({signal.strsignal(-code)})"
        )
        how = self._killed or how
        if self._gate.goodbye is not None:
            self._goodbye_code = self._gate.goodbye.exit_code
            self._leave()
        elif not self._heard:
            self._log.say(f"the application {how}, before its first word")
            # It is not installed as it should be, or was asked to end before it began: another start mends neither.
            self.exit_code = code if code > 0 else EXIT_FAILED
        else:
            self._gate.on_application_died(how)

    def _leave(self) -> None:
        """The application has ended in good order; so does the gate, unless the vehicle still needs it.

        It does while the gate stops it, and while it flies by odometry that passes through here, whoever has it.
        """
        stops = self._gate.airborne and self._gate.stage > Stage.PASS
        if not stops and not self._gate.carries_odometry:
            self.exit_code = self._goodbye_code
        elif stops:
            self._wait_for_the_vehicle()
        else:
            self._wait("the vehicle flies by odometry that passes through it: until that has landed")

    def _wait_for_the_vehicle(self) -> None:
        self._wait(f"it stops the vehicle ({self._gate.stage.name.lower()}): until that has landed, or a pilot has it")

    def _wait(self, why: str) -> None:
        if why != self._told:
            self._told = why
            self._log.say(
                f"the application has ended, and the gate stays, since {why}. An autopilot that is silent for "
                f"{WAITED_S:g} s, {GONE_S:g} s after Ctrl-C, is not waited for"
            )

    def _after_death(self, now_s: float, autopilot_silent_s: float) -> None:
        gone = autopilot_silent_s > (GONE_S if self._asked else WAITED_S)
        if self._goodbye_code is not None:
            self._leave()
            if gone and self.exit_code is None:
                self._log.say(f"the autopilot has been silent for {autopilot_silent_s:.0f} s: the gate ends")
                self.exit_code = self._goodbye_code
            return
        if now_s < max(self._died_s + REST_S, self._looked_s + LOOK_S):
            return
        self._looked_s = now_s
        if orphans := children():
            # Those that they leave behind are found the next time.
            self._log.say(f"what the application had started is killed: {orphans}")
            for pid in orphans:
                kill(pid)
        elif not self._asked and not self._gate.armed:
            self._start_again(now_s)
        elif gone:
            self._log.say(f"the autopilot has been silent for {autopilot_silent_s:.0f} s: the gate ends")
            self.exit_code = EXIT_FAILED
        elif self._gate.airborne:
            self._wait_for_the_vehicle()
        elif self._asked:
            self.exit_code = EXIT_FAILED
        else:
            self._wait("the vehicle is armed: until somebody disarms it")

    def _start_again(self, now_s: float) -> None:
        # Nothing flies now.
        deaths()
        if self._starts > self._plan.restarts:
            self._log.say(f"the application was started {self._starts} times; it is not started again")
            self.exit_code = EXIT_FAILED
            return
        try:
            self.start()
        except OSError as error:
            self._log.say(f"the application cannot be started: {error}")
            self._died_s = now_s
