"""The buttons of one visitor: what he asks of the vehicle that he has chosen, and what he is asked back first."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

import viser

from companion.ground.access import Access
from companion.ground.commanding import LABELS, Commanding
from companion.ground.concerns import ENDED, LOST_S, WAITING
from companion.ground.station import VehicleView
from companion.link.words import Command
from companion.viewer.drawing import Rgb

_ASKED_BACK = {
    Command.START: "It takes off and explores. Is everybody away from it?",
    Command.LAND: "It lands where it is now, and does not come back.",
}
"""Before these a second press is needed: the one moves what stood, the other cannot be undone."""

_BLUE: Rgb = (25, 113, 194)
_COLOURS: dict[Command, Rgb] = {Command.START: (47, 158, 68), Command.STOP: (201, 42, 42), Command.LAND: (217, 72, 15)}

_CLEAR_OF_GROUND = "taking off", "exploring", "homing", "leaving"

Pressed = Callable[[viser.GuiEvent[viser.GuiButtonHandle]], Coroutine[Any, Any, None]]


class CommandButtons:
    """Buttons that nobody else sees, and what became of the last commands of all.

    Args:
        client: the visitor, as viser knows him.
        access: who may command.
        commanding: sends what is pressed.
        chosen: the vehicle that they are for; None while there is none.
        choose: is told of each vehicle that something is asked of.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        access: Access,
        commanding: Commanding,
        chosen: Callable[[], VehicleView | None],
        choose: Callable[[str], None],
    ) -> None:
        self._client = client
        self._access = access
        self._commanding = commanding
        self._chosen = chosen
        self._choose = choose
        self._answers = client.gui.add_html(commanding.answers)
        client.gui.add_html('<div class="gp-commands"></div>')
        self._buttons = {
            command: client.gui.add_button(
                label,
                color=_COLOURS.get(command, _BLUE),
                disabled=True,
                # Of one vehicle it would be the same as STOP.
                visible=command is not Command.STOP,
            )
            for command, label in LABELS.items()
        }
        for command, button in self._buttons.items():
            button.on_click(self._pressed(command))

    def refresh(self, *, several: bool) -> None:
        """Bring them up to date: what can be asked for now, and what became of what was."""
        vehicle = self._chosen()
        possible = set() if vehicle is None else offered(vehicle)
        for command, button in self._buttons.items():
            button.disabled = command not in possible
        self._buttons[Command.STOP].visible = several
        self._answers.content = self._commanding.answers

    def _pressed(self, command: Command) -> Pressed:
        # A coroutine: of a choice and a press that come together, over a network that was away for a moment, the choice
        # is done first. In viser's threads the one could overtake the other, and the command would go elsewhere.
        async def pressed(_: object) -> None:
            vehicle = self._chosen()
            if vehicle is None:
                return
            self._choose(vehicle.name)
            if command is not Command.STOP and not self._access.has(self._client):
                self._access.ask_for_code(self._client)
            elif command in _ASKED_BACK:
                self._ask_back(vehicle, command)
            else:
                self._commanding.send(vehicle, command)

        return pressed

    def _ask_back(self, vehicle: VehicleView, command: Command) -> None:
        gui = self._client.gui
        modal = gui.add_modal(f"{LABELS[command]}: {vehicle.name}?")
        with modal:
            gui.add_markdown(_ASKED_BACK[command])
            yes = gui.add_button(f"{LABELS[command]} {vehicle.name}", color="orange")
            no = gui.add_button("Not now", color="gray")

        @yes.on_click
        def _(_: object) -> None:
            modal.close()
            self._commanding.send(vehicle, command)

        @no.on_click
        def _(_: object) -> None:
            modal.close()


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
