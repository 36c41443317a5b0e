"""One who has the page open, and what is his alone: the vehicle that he has chosen, and all that is for it."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import viser

from companion.ground.access import Access
from companion.ground.cards import CHOOSE, Row, fleet_card, vehicle_card
from companion.ground.command_buttons import CommandButtons
from companion.ground.commanding import Commanding
from companion.ground.downloads import Downloads
from companion.ground.measuring import Measuring, Seen
from companion.ground.own_view import OwnView
from companion.ground.shown_vehicle import ShownVehicle
from companion.ground.station import Station, VehicleView

FLEET_ORDER, TABS_ORDER = 1e6, 2e6
"""Of the list of vehicles and of the tabs below it. The list is each visitor's own, and so newer than the tabs: without
saying so it would stand under them."""


@dataclass(frozen=True, slots=True)
class Tabs:
    """Where a visitor's own things go, beside what all share."""

    vehicle: viser.GuiTabHandle
    view: viser.GuiTabHandle
    map: viser.GuiTabHandle


class Visitor:
    """A visitor while he is here.

    He is made, told of presses and taken leave of by viser's event loop alone, so that none of the three comes between
    another. What has changed he is told by the thread that draws.

    Where there is one vehicle, figures and buttons are for that. Where there are several they are for none until he has
    chosen, or had asked something of the one: who comes back after his network was away for a moment is a new visitor,
    and what he presses must not go to the first vehicle, or to the first that is heard, where he had chosen another.

    Args:
        client: him, as viser knows him.
        tabs: where his things go.
        station: the vehicles.
        access: who may command.
        commanding: sends what he asks.
        seen: what a click hits, of what he sees.
        one_at_a_time: held while a file is made, for whomever.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        tabs: Tabs,
        station: Station,
        access: Access,
        commanding: Commanding,
        seen: Seen,
        one_at_a_time: threading.Lock,
    ) -> None:
        self.client = client
        self.settled_s = math.inf
        """When his panel has taken its place, and he can be shown the whole map; infinite once he was."""
        self._station = station
        self._chosen = ""
        self._is_here = True
        gui = client.gui
        self._fleet = gui.add_html("", order=FLEET_ORDER)
        with tabs.vehicle:
            gui.add_html('<div class="gp-chooser"></div>')
            self._chooser = gui.add_button_group("show", ("",), visible=False)
            self._card = gui.add_html("")
            self._buttons = CommandButtons(client, access, commanding, self.chosen, self.choose)
        with tabs.view:
            self.view = OwnView(client)
        with tabs.map:
            self.measuring = Measuring(client, seen)
            self._downloads = Downloads(client, lambda: self._is_here, station.vehicles, self.chosen, one_at_a_time)

        @self._chooser.on_click
        async def _(event: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self.choose(str(event.target.value))

    def chosen(self) -> VehicleView | None:
        """The vehicle that his figures and buttons are for."""
        vehicles = self._station.vehicles()
        if not self._chosen and len(vehicles) == 1:
            return vehicles[0]
        return next((one for one in vehicles if one.name == self._chosen), None)

    def choose(self, name: str) -> None:
        """Make figures and buttons those of this vehicle."""
        self._chosen = name

    def leave(self) -> None:
        """Send him nothing more: he has closed the page, or is out of its reach."""
        self._is_here = False

    def refresh(self, vehicles: Sequence[VehicleView], shown: Mapping[str, ShownVehicle], tick: int) -> None:
        """Tell him what has changed; viser sends nothing that is as it was.

        Args:
            vehicles: all.
            shown: by name, how they are drawn.
            tick: another number each second: by that the list knows that it is not old.
        """
        chosen = self.chosen()
        several = len(vehicles) > 1
        names = tuple(vehicle.name for vehicle in vehicles)
        if names and self._chooser.options != names:
            self._chooser.options = names
        self._chooser.visible = several
        rows = [Row(vehicle, shown[vehicle.name].css_colour, vehicle is chosen) for vehicle in vehicles]
        self._fleet.content = fleet_card(rows, tick)
        self._card.content = vehicle_card(chosen) if chosen is not None else CHOOSE if several else ""
        self._buttons.refresh(several=several)
        self._downloads.offer_all(several)
        self.view.refresh(shown)
