"""A vehicle on the page: its map and what is drawn beside it."""

from __future__ import annotations

import viser

from companion.ground.sketch import Sketch
from companion.ground.station import VehicleView
from companion.ground.view_controls import ViewControls
from companion.viewer.drawing import HeightRange, MapDrawing, Rgb
from companion.viewer.tiles import packed_snapshot


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
        self._root = f"/vehicles/{number}"
        self._frame = server.scene.add_frame(self._root, show_axes=False)
        self._maps = server.scene.add_frame(f"{self._root}/map", show_axes=False)
        self.sketch = Sketch(server, self._root, name, colour)
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
            self.drawing = MapDrawing(self._server, f"{self._root}/map", snapshot.voxel_m, heights)
        self.drawing.put(packed_snapshot(snapshot))

    def show(self, view: ViewControls, visible: bool) -> None:
        """Show or hide it, and what of it is wanted."""
        if self._frame.visible != visible:
            self._frame.visible = visible
        self.sketch.show(way=view.way, graph=view.graph, left=view.left)
