"""Distances between two points of the map that are clicked."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import viser
from numpy.typing import NDArray

_COLOUR = (255, 0, 200)
_ROOT = "/measured"

Seen = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64] | None]
"""The nearest point that is drawn along a ray, from its origin (3,) along a unit vector (3,)."""


class Measuring:
    """Two clicks of one visitor on the map and the line between them, which he alone sees.

    Args:
        client: the visitor, as viser knows him.
        seen: what a click hits.
    """

    def __init__(self, client: viser.ClientHandle, seen: Seen) -> None:
        self._scene = client.scene
        self._seen = seen
        self._points: list[NDArray[np.float64]] = []
        gui = client.gui
        self._box = gui.add_checkbox("measure", initial_value=False, hint="Click two points of the map")
        self._says = gui.add_markdown("")
        self._box.on_update(self._switched)

    def click(self, origin_m: NDArray[np.float64], towards: NDArray[np.float64]) -> None:
        """Take the point that a click hits. A third one begins anew."""
        point = self._seen(origin_m, towards)
        if point is None:
            self._says.content = "No map there: click on ground or wall."
            return
        if len(self._points) == 2:
            self._points = []
            self._scene.remove_by_name(_ROOT)
        self._points.append(point)
        self._scene.add_icosphere(f"{_ROOT}/{len(self._points)}", 0.15, color=_COLOUR, position=tuple(point))
        if len(self._points) == 1:
            self._says.content = f"From {_place(point)}: click the other point."
            return
        line = np.array([self._points], np.float32)
        self._scene.add_line_segments(f"{_ROOT}/line", line, _COLOUR, thickness=4.0, thickness_units="screen")
        apart = self._points[1] - self._points[0]
        text = f"{float(np.linalg.norm(apart)):.2f} m"
        self._scene.add_label(
            f"{_ROOT}/text", text, position=tuple(self._points[0] + apart / 2.0), anchor="bottom-center"
        )
        across_m = math.hypot(float(apart[0]), float(apart[1]))
        self._says.content = (
            f"**{text}**, {across_m:.2f} m across and {abs(float(apart[2])):.2f} m up or down, "
            f"from {_place(self._points[0])} to {_place(self._points[1])}."
        )

    def _switched(self, _: object) -> None:
        scene = self._scene
        scene.remove_click_callback()
        if self._box.value:
            self._says.content = "Click two points of the map."
            scene.on_click()(self._clicked)
        else:
            self._points = []
            self._says.content = ""
            scene.remove_by_name(_ROOT)

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        towards = np.array(event.ray_direction, np.float64)
        self.click(np.array(event.ray_origin, np.float64), towards / np.linalg.norm(towards))


def _place(point: NDArray[np.float64]) -> str:
    return f"({', '.join(f'{value:.1f}' for value in point)})"
