"""What is cut away from the maps, for all who have the page open, and from where each of them looks.

A cut makes other tiles, which are sent: one for each visitor would be the map once more for each.
"""

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

_FOR_ALL = '<div class="gp gp-legend">These three are the same for everybody who has this page open.</div>'

Box = tuple[FloatArray, FloatArray]
"""Two (3,) corners, lowest and highest, in m."""


class ViewControls:
    """The controls of the view that all share.

    Args:
        server: viser's.
        whole: a box around everything.
        chosen: a box around the vehicle that a visitor has chosen; None where it is not known where that is.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        whole: Callable[[], Box],
        chosen: Callable[[viser.ClientHandle], Box | None],
    ) -> None:
        self._server = server
        gui = server.gui
        gui.add_html('<div class="gp-commands"></div>')
        self._eye("Whole map", lambda _: whole(), OBLIQUE)
        self._eye("From above", lambda _: whole(), STEEP)
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
        gui.add_html(_FOR_ALL)

    def _eye(self, label: str, box: Callable[[viser.ClientHandle], Box | None], towards: FloatArray) -> None:
        """A button that moves the eye of whoever presses it."""
        button = self._server.gui.add_button(label, color="gray")

        @button.on_click
        def _(event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
            if event.client is None:
                return
            around = box(event.client)
            if around is not None:
                look(event.client, *around, towards)

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
