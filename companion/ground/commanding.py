"""What an operator asks of vehicles, what became of it, and STOP, which all who have the page open share."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

import viser

from companion.ground.cards import answers_card
from companion.ground.station import VehicleView
from companion.link.words import Answer, Command

KEPT = 5
"""The last so many commands stay to be read."""

LABELS = {
    Command.START: "Start",
    Command.PAUSE: "Pause",
    Command.CONTINUE: "Continue",
    Command.HOME: "Home",
    Command.LAND: "Land here",
    Command.STOP: "Stop this one",
}


class Commanding:
    """Sends commands and says what became of them, to everybody: who flies one vehicle sees what others are asked.

    Args:
        server: viser's.
        vehicles: all that are known.
        now_s: monotonic time.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        vehicles: Callable[[], Sequence[VehicleView]],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._server = server
        self._vehicles = vehicles
        self._now_s = now_s
        self._lock = threading.Lock()
        self._lines: deque[list[str]] = deque(maxlen=KEPT)

    @property
    def answers(self) -> str:
        """What became of the last commands, as HTML."""
        with self._lock:
            return answers_card([(kind, text) for kind, text in reversed(self._lines)])

    def add_stop(self) -> None:
        """Put STOP on the page: for every vehicle, from everybody who has the page open, and at once."""
        self._server.gui.add_html('<div class="gp-stop"></div>')
        self._stop = self._server.gui.add_button("STOP", color="red", hint="Every vehicle brakes and holds, now")

        # A coroutine: viser's threads may all be busy with what others have clicked, and it waits for none of them.
        @self._stop.on_click
        async def _(_: object) -> None:
            vehicles = self._vehicles()
            if not vehicles:
                self._say("no", "STOP: no vehicle has been heard yet, so none was asked")
            for vehicle in vehicles:
                self.send(vehicle, Command.STOP)

    def refresh(self) -> None:
        """Let STOP say for how many it is."""
        label = "STOP ALL" if len(self._vehicles()) > 1 else "STOP"
        if self._stop.label != label:
            self._stop.label = label

    def send(self, vehicle: VehicleView, command: Command) -> None:
        """Ask, and say what became of it."""
        asked_s = self._now_s()
        what = f"{'STOP' if command is Command.STOP else LABELS[command]}, {vehicle.name}"
        line = self._say("open", f"{what}: asked, no answer yet")

        def answered(answer: Answer | None) -> None:
            took_s = self._now_s() - asked_s
            if answer is None:
                lost = f"{what}: no answer. It may not have heard it: press again, and look at its link."
                self._change(line, "no", lost)
            elif answer.accepted:
                self._change(line, "yes", f"{what}: done, it says after {took_s:.2f} s")
            else:
                self._change(line, "no", f"{what}: refused: {answer.reason}")

        try:
            vehicle.ask(command, answered)
        except Exception as error:  # noqa: BLE001 - whatever it is, the operator must see that nothing was sent
            self._change(line, "no", f"{what}: could not be sent: {error}. Use the transmitter.")

    def _say(self, kind: str, text: str) -> list[str]:
        line = [kind, text]
        with self._lock:
            self._lines.append(line)
        return line

    def _change(self, line: list[str], kind: str, text: str) -> None:
        with self._lock:
            line[:] = kind, text
