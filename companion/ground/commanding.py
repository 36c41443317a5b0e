"""The buttons: what an operator asks of vehicles, what is asked back first, and what became of it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

import viser

from companion.ground.access import Access
from companion.ground.cards import answers_card
from companion.ground.concerns import ENDED, LOST_S, WAITING
from companion.ground.station import VehicleView
from companion.link.words import Answer, Command
from companion.viewer.drawing import Rgb

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
_ASKED_BACK = {
    Command.START: "It takes off and explores. Is everybody away from it?",
    Command.LAND: "It lands where it is now, and does not come back.",
}
"""Before these a second press is needed: the one moves what stood, the other cannot be undone."""

_NOT_YOUR_CHOICE = (
    "The buttons are for this vehicle now, and you have not chosen it: another visitor has, or nobody. "
    "Is it the one that you mean?"
)

_BLUE: Rgb = (25, 113, 194)
_COLOURS: dict[Command, Rgb] = {Command.START: (47, 158, 68), Command.STOP: (201, 42, 42), Command.LAND: (217, 72, 15)}

_CLEAR_OF_GROUND = "taking off", "exploring", "homing", "leaving"


class Commanding:
    """Sends commands and says what became of them.

    Args:
        server: viser's.
        access: who may.
        vehicles: all that are known.
        chosen: the one that the buttons are for; None while there is none.
        now_s: monotonic time.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        access: Access,
        vehicles: Callable[[], Sequence[VehicleView]],
        chosen: Callable[[], VehicleView | None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._server = server
        self._access = access
        self._vehicles = vehicles
        self._chosen = chosen
        self._now_s = now_s
        self._lock = threading.Lock()
        self._lines: deque[list[str]] = deque(maxlen=KEPT)
        self._buttons: dict[Command, viser.GuiButtonHandle] = {}
        self._meant: dict[int, str] = {}

    def mean(self, client_id: int, name: str) -> None:
        """This visitor has chosen that vehicle: what is pressed there from now on is for it, and for no other."""
        with self._lock:
            self._meant[client_id] = name

    def forget(self, client: viser.ClientHandle) -> None:
        """It has closed the page."""
        with self._lock:
            self._meant.pop(client.client_id, None)

    def add_stop(self) -> None:
        """Put STOP on the page: for every vehicle, from everybody who has the page open, and at once."""
        self._server.gui.add_html('<div class="gp-stop"></div>')
        self._stop = self._server.gui.add_button("STOP", color="red", hint="Every vehicle brakes and holds, now")

        @self._stop.on_click
        def _(_: object) -> None:
            vehicles = self._vehicles()
            if not vehicles:
                self._say("no", "STOP: no vehicle has been heard yet, so none was asked")
            for vehicle in vehicles:
                self.send(vehicle, Command.STOP)

    def add_buttons(self) -> None:
        """Put the buttons for the chosen vehicle, and what became of the last commands, on the page."""
        gui = self._server.gui
        self._answers = gui.add_html("")
        gui.add_html('<div class="gp-commands"></div>')
        for command, label in LABELS.items():
            button = self._buttons[command] = gui.add_button(label, color=_COLOURS.get(command, _BLUE))
            button.on_click(self._pressed(command))

    def refresh(self) -> None:
        """Bring the page up to date: what can be asked for now, and what became of what was."""
        vehicle = self._chosen()
        possible = set() if vehicle is None else offered(vehicle)
        for command, button in self._buttons.items():
            if button.disabled == (command in possible):
                button.disabled = command not in possible
        several = len(self._vehicles()) > 1
        if self._buttons[Command.STOP].visible != several:
            self._buttons[Command.STOP].visible = several
        label = "STOP ALL" if several else "STOP"
        if self._stop.label != label:
            self._stop.label = label
        with self._lock:
            content = answers_card([(kind, text) for kind, text in reversed(self._lines)])
        if self._answers.content != content:
            self._answers.content = content

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

    def _pressed(self, command: Command) -> Callable[[viser.GuiEvent[viser.GuiButtonHandle]], None]:
        def pressed(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            vehicle = self._chosen()
            if vehicle is None or event.client is None:
                return
            vehicles, meant = self._vehicles(), self._meant.get(event.client.client_id)
            # All visitors see the same vehicle: another one may have changed it just before this press.
            is_meant = len(vehicles) == 1 or meant == vehicle.name
            if command is Command.STOP:
                for one in vehicles:
                    if one.name in (vehicle.name, meant):
                        self.send(one, command)
            elif not self._access.has(event.client):
                self._access.ask_for_code(event.client)
            elif command in _ASKED_BACK or not is_meant:
                self._ask_back(event.client, vehicle, command, is_meant=is_meant)
            else:
                self.send(vehicle, command)

        return pressed

    def _ask_back(self, client: viser.ClientHandle, vehicle: VehicleView, command: Command, *, is_meant: bool) -> None:
        modal = client.gui.add_modal(f"{LABELS[command]}: {vehicle.name}?")
        with modal:
            if not is_meant:
                client.gui.add_markdown(_NOT_YOUR_CHOICE)
            if command in _ASKED_BACK:
                client.gui.add_markdown(_ASKED_BACK[command])
            yes = client.gui.add_button(f"{LABELS[command]} {vehicle.name}", color="orange")
            no = client.gui.add_button("Not now", color="gray")

        @yes.on_click
        def _(_: object) -> None:
            modal.close()
            self.mean(client.client_id, vehicle.name)
            self.send(vehicle, command)

        @no.on_click
        def _(_: object) -> None:
            modal.close()

    def _say(self, kind: str, text: str) -> list[str]:
        line = [kind, text]
        with self._lock:
            self._lines.append(line)
        return line

    def _change(self, line: list[str], kind: str, text: str) -> None:
        with self._lock:
            line[:] = kind, text


def offered(vehicle: VehicleView) -> set[Command]:
    """What makes sense to ask a vehicle now; where it is not known how it is, everything. STOP is always."""
    telemetry = vehicle.telemetry
    if telemetry is None or vehicle.age_s > LOST_S:
        return set(Command)
    found = {Command.STOP}
    if telemetry.phase == WAITING:
        found.add(Command.START)
    if telemetry.phase in _CLEAR_OF_GROUND:
        found |= {Command.LAND, Command.CONTINUE if telemetry.paused else Command.PAUSE}
        if telemetry.phase != "homing":
            found.add(Command.HOME)
    if telemetry.phase == ENDED:
        found.discard(Command.START)
    return found
