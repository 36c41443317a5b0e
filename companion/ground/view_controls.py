"""What the operator wants to see. All who have the page open see the same, each from a place of their own."""

from __future__ import annotations

import math
from collections.abc import Callable

import viser

from companion.model import FloatArray
from companion.viewer.drawing import Style
from companion.viewer.page import OBLIQUE, STEEP, view_of
from companion.viewer.tiles import Shown
from companion.viewer.voxels import State

_EMPTY_M = -1.0, 5.0
"""Where the slider goes from and to before there is a map."""

_STEP_M = 0.1

_LEGEND = (
    '<div class="gp gp-legend"><i style="background:#f0148c"></i>the point it flies to now'
    '<i style="background:#ff3c3c"></i>left to explore<br>'
    "Dark is low, bright is high. Everybody who has this page open sees the same.</div>"
)

Box = tuple[FloatArray, FloatArray]
"""Two (3,) corners, lowest and highest, in m."""


class ViewControls:
    """The controls of the view.

    Args:
        server: viser's.
        whole: a box around everything.
        chosen: a box around the chosen vehicle; None where it is not known where that is.
    """

    def __init__(self, server: viser.ViserServer, whole: Callable[[], Box], chosen: Callable[[], Box | None]) -> None:
        self._server = server
        self._vehicles: dict[str, viser.GuiCheckboxHandle] = {}
        gui = server.gui
        gui.add_html('<div class="gp-commands"></div>')
        self._eye("Whole map", whole, OBLIQUE)
        self._eye("From above", whole, STEEP)
        self._eye("At vehicle", chosen, OBLIQUE)
        gui.add_html('<div class="gp-done"></div>')
        self._roof = gui.add_checkbox("roof", initial_value=False, hint="Show what hides the ground from above")
        self._cut = gui.add_multi_slider(
            "slice, z (m)",
            min=_EMPTY_M[0],
            max=_EMPTY_M[1],
            step=_STEP_M,
            initial_value=_EMPTY_M,
            hint="Hide what is below the first and above the second",
        )
        self._free = gui.add_checkbox("free space", initial_value=False, hint="Show what was seen to be free")
        self._way = gui.add_checkbox("ways flown", initial_value=True)
        self._graph = gui.add_checkbox("navigation graph", initial_value=False)
        self._left = gui.add_checkbox(
            "left to explore", initial_value=True, hint="Places that were seen and not reached"
        )
        dark = gui.add_checkbox("dark", initial_value=False, hint="For eyes that are used to the dark")
        gui.add_html(_LEGEND)
        self._folder = gui.add_folder("vehicles", visible=False)

        @dark.on_update
        def _(_: object) -> None:
            gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=dark.value)

    def _eye(self, label: str, box: Callable[[], Box | None], towards: FloatArray) -> None:
        """A button that moves the eye of whoever presses it."""
        button = self._server.gui.add_button(label, color="gray")

        @button.on_click
        def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            around = box()
            if around is not None and event.client is not None:
                look(event.client, *around, towards)

    @property
    def way(self) -> bool:
        """Whether ways are shown."""
        return self._way.value

    @property
    def graph(self) -> bool:
        """Whether navigation graphs are shown."""
        return self._graph.value

    @property
    def left(self) -> bool:
        """Whether what is left to explore is shown."""
        return self._left.value

    def add_vehicle(self, name: str) -> None:
        """Let a vehicle be hidden."""
        with self._folder:
            self._vehicles[name] = self._server.gui.add_checkbox(name, initial_value=True)
        self._folder.visible = True

    def is_shown(self, name: str) -> bool:
        """Whether a vehicle is."""
        return self._vehicles[name].value

    def style(self, most_points: int) -> Style:
        """How maps are to be drawn."""
        low_m, high_m = self._cut.value
        states = {State.OCCUPIED, State.FREE} if self._free.value else {State.OCCUPIED}
        # An end of the slider that nobody has moved cuts off nothing.
        shown = Shown(
            self._roof.value,
            -math.inf if low_m <= self._cut.min else low_m,
            math.inf if high_m >= self._cut.max else high_m,
        )
        return Style(shown, frozenset(states), most_points=most_points)

    def bound(self, low_m: float, high_m: float) -> None:
        """Let the slider go as far as the maps do; an end that cut off nothing goes along."""
        if low_m > high_m or (low_m, high_m) == (self._cut.min, self._cut.max):
            return
        was_low, was_high = self._cut.value
        kept = (
            low_m if was_low <= self._cut.min else max(was_low, low_m),
            high_m if was_high >= self._cut.max else min(was_high, high_m),
        )
        self._cut.min, self._cut.max = low_m, high_m
        self._cut.value = kept  # type: ignore[misc] # viser's setter stands apart from its property


def look(client: viser.ClientHandle, low_m: FloatArray, high_m: FloatArray, towards: FloatArray) -> None:
    """Move the eye of one who has the page open so that a box is in sight."""
    camera = client.camera
    look_at, position = view_of(low_m, high_m, towards, camera.aspect)
    with client.atomic():
        # In this order: where it looks moves along with where it is.
        camera.position = position
        camera.look_at = look_at
