"""What one visitor wants to see of what is drawn for all."""

from __future__ import annotations

from collections.abc import Mapping

import viser

from companion.ground.shown_vehicle import PARTS, ShownVehicle
from companion.ground.sketch import GRAPHS, LEFT, WAYS

_LEGEND = (
    '<div class="gp gp-legend"><i style="background:#f0148c"></i>the point it flies to now'
    '<i style="background:#ff3c3c"></i>left to explore<br>Dark is low, bright is high.</div>'
)


class OwnView:
    """Boxes of one visitor that show and hide, for him alone, what all have in their browsers.

    A node of the scene is hidden from him by an empty one of his own in its place, and shown again by taking that away:
    nothing of what is drawn is sent once more.

    Args:
        client: the visitor, as viser knows him.
    """

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._in_place_of: dict[str, viser.FrameHandle] = {}
        self._vehicles: dict[str, viser.GuiCheckboxHandle] = {}
        gui = client.gui
        self._ways = gui.add_checkbox("ways flown", initial_value=True)
        self._graphs = gui.add_checkbox("navigation graph", initial_value=False)
        self._left = gui.add_checkbox(
            "left to explore", initial_value=True, hint="Places that were seen and not reached"
        )
        dark = gui.add_checkbox("dark", initial_value=False, hint="For eyes that are used to the dark")
        gui.add_html(_LEGEND)
        self._folder = gui.add_folder("vehicles", visible=False)

        @dark.on_update
        async def _(_: object) -> None:
            gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark.value)

    def hides(self, name: str) -> bool:
        """Whether a vehicle is hidden from him."""
        box = self._vehicles.get(name)
        return box is not None and not box.value

    def refresh(self, shown: Mapping[str, ShownVehicle]) -> None:
        """Do what the boxes say; vehicles by their names."""
        for name in shown:
            if name not in self._vehicles:
                with self._folder:
                    self._vehicles[name] = self._client.gui.add_checkbox(name, initial_value=True)
                self._folder.visible = True
        wanted = {
            f"{vehicle.root}/{part}": visible
            for name, vehicle in shown.items()
            for part, visible in self._otherwise(name).items()
        }
        for node in self._in_place_of.keys() - wanted.keys():
            self._in_place_of.pop(node).remove()
        for node in wanted.keys() - self._in_place_of.keys():
            self._in_place_of[node] = self._client.scene.add_frame(node, show_axes=False, visible=wanted[node])

    def _otherwise(self, name: str) -> dict[str, bool]:
        """By part of a vehicle, whether he sees it, where that is not as it is for all."""
        if self.hides(name):
            return dict.fromkeys(PARTS, False)
        parts = {WAYS: False} if not self._ways.value else {}
        if not self._left.value:
            parts[LEFT] = False
        if self._graphs.value:
            parts[GRAPHS] = True
        return parts
