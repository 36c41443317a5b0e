"""A vehicle on the page: its map and what is drawn beside it."""

from __future__ import annotations

import itertools
import math

import numpy as np
import viser
from numpy.typing import NDArray

from companion.control.sharing import Frame
from companion.ground.sketch import AT, GRAPHS, LEFT, TARGET, WAYS, Sketch
from companion.ground.station import VehicleView
from companion.ground.view_controls import Box
from companion.link.words import Telemetry
from companion.viewer.drawing import HeightRange, MapDrawing, Rgb
from companion.viewer.tiles import packed_snapshot

_MAP = "map"
PARTS = _MAP, AT, WAYS, GRAPHS, LEFT, TARGET
"""Names of the nodes of all that is drawn of a vehicle, below its own node; none of them is below another."""


class ShownVehicle:
    """One vehicle in the scene.

    Args:
        server: viser's.
        number: of the vehicle; its name may hold what names of nodes must not.
        name: of the vehicle.
        colour: of it and of its way.
    """

    def __init__(self, server: viser.ViserServer, number: int, name: str, colour: Rgb) -> None:
        self.name = name
        self.css_colour = f"rgb({colour[0]},{colour[1]},{colour[2]})"
        self.drawing: MapDrawing | None = None
        self._server = server
        self.root = f"/vehicles/{number}"
        self._frame = server.scene.add_frame(self.root, show_axes=False)
        server.scene.add_frame(f"{self.root}/{_MAP}", show_axes=False)
        self.sketch = Sketch(server, self.root, name, colour)
        self._lies = Frame()
        self._revision = 0
        self._map_number = -1

    def take_map(self, vehicle: VehicleView, heights: HeightRange) -> None:
        """Ask for what has changed in its map; another map takes the place of the one that was shown."""
        number = vehicle.map_number
        if number != self._map_number:
            self._map_number, self._revision = number, 0
            if self.drawing is not None:
                self.drawing.remove()
                self.drawing = None
        snapshot = vehicle.changed(self._revision)
        if vehicle.map_number != number:
            return  # it may be of either: asked again the next time
        self._revision = snapshot.revision
        if not len(snapshot.chunks):
            return
        if self.drawing is None:
            self.drawing = MapDrawing(self._server, f"{self.root}/{_MAP}", snapshot.voxel_m, heights)
        self.drawing.put(packed_snapshot(snapshot))

    def lie(self, told: Telemetry | None) -> None:
        """Draw everything of it where it lies in the frame that vehicles share, by the newest word."""
        frame = Frame() if told is None or told.frame is None else Frame(*told.frame)
        if frame != self._lies:
            self._lies = frame
            self._frame.position = np.array([frame.x_m, frame.y_m, frame.z_m])
            self._frame.wxyz = np.array([math.cos(frame.yaw_rad / 2.0), 0.0, 0.0, math.sin(frame.yaw_rad / 2.0)])

    def shared_m(self, x_m: float, y_m: float, z_m: float) -> NDArray[np.float64]:
        """A place of its map in the frame that vehicles share."""
        return np.array(self._lies.shared(x_m, y_m, z_m))

    def bounds_m(self) -> Box | None:
        """The box around its map in the frame that vehicles share; None where there is nothing."""
        box = None if self.drawing is None else self.drawing.map.bounds_m
        if box is None:
            return None
        corners = np.array([self.shared_m(*corner) for corner in itertools.product(*zip(*box, strict=True))])
        return corners.min(axis=0), corners.max(axis=0)

    def seen_from(self, origin_m: NDArray[np.float64], towards: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """The nearest point of its map along a ray, all in the frame that vehicles share."""
        if self.drawing is None:
            return None
        own_m = np.array(self._lies.own(*origin_m))
        along = np.array(self._lies.own(*(origin_m + towards))) - own_m
        point = self.drawing.seen_from(own_m, along)
        return None if point is None else self.shared_m(*point)
