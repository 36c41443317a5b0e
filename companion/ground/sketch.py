"""What is drawn of a vehicle beside its map: where it is, its way, its target, its graph and what it has left."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import viser

from companion.ground.station import VehicleView
from companion.link.words import Place
from companion.model import FloatArray
from companion.viewer.drawing import Rgb
from companion.viewer.graphs import GraphLines
from companion.viewer.page import draw_graph, draw_way

_BLOCK = 256
"""Positions of the way that are one node: only the last of them is sent again when the vehicle has flown on."""

_SIZE_M = 0.8
_ARROW_M = np.array(
    [[1.6, 0, 0], [-0.9, 1.0, 0], [-0.5, 0, 0.25], [-0.9, -1.0, 0], [-0.5, 0, -0.25]], np.float32
) * np.float32(_SIZE_M)
_FACES = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 1], [0, 3, 4], [1, 4, 2], [2, 4, 3]], np.uint32)
AT, WAYS, GRAPHS, LEFT, TARGET = "at", "ways", "graphs", "left", "target"
"""Names of the nodes of its parts: one who looks may want to see some of them and not others."""

_FRONTIER: Rgb = (255, 60, 60)
_TARGET: Rgb = (240, 20, 140)


class Sketch:
    """One vehicle in the scene.

    Args:
        server: viser's.
        root: name of the node that it hangs on.
        name: of the vehicle.
        colour: of it and of its way.
    """

    def __init__(self, server: viser.ViserServer, root: str, name: str, colour: Rgb) -> None:
        self._server = server
        self._root = root
        self._colour = colour
        scene = server.scene
        self._at = scene.add_frame(f"{root}/{AT}", show_axes=False, visible=False)
        self.body = scene.add_mesh_simple(f"{root}/{AT}/body", _ARROW_M, _FACES, color=colour, side="double")
        scene.add_label(
            f"{root}/{AT}/name", name, position=(0.0, 0.0, 0.9), anchor="bottom-center", font_screen_scale=1.1
        )
        scene.add_frame(f"{root}/{WAYS}", show_axes=False)
        scene.add_frame(f"{root}/{GRAPHS}", show_axes=False, visible=False)
        scene.add_frame(f"{root}/{LEFT}", show_axes=False)
        self._positions = 0
        self._aim: tuple[Place, Place] | None = None
        self._graph: tuple[tuple[str, int], ...] = ()
        self._frontiers: tuple[Place, ...] = ()

    def look(self, vehicle: VehicleView) -> None:
        """Draw what has changed."""
        self._move(vehicle)
        self._draw_way(vehicle.way_m())
        self._draw_graph(vehicle.graph())
        self._draw_frontiers(tuple(vehicle.frontiers_m()))

    def _move(self, vehicle: VehicleView) -> None:
        told = vehicle.telemetry
        if told is None or told.x_m is None or told.y_m is None or told.z_m is None:
            self._at.visible = False
            return
        at_m = told.x_m, told.y_m, told.z_m
        half_rad = (told.yaw_rad or 0.0) / 2.0
        self._at.position = at_m
        self._at.wxyz = math.cos(half_rad), 0.0, 0.0, math.sin(half_rad)
        self._at.visible = True
        self._draw_aim(None if told.target_m is None else (at_m, told.target_m))

    def _draw_aim(self, aim: tuple[Place, Place] | None) -> None:
        """Draw a line from where it is to the point that it flies to."""
        if aim == self._aim:
            return
        self._aim = aim
        name = f"{self._root}/{TARGET}"
        if aim is None:
            self._server.scene.remove_by_name(name)
            return
        self._server.scene.add_line_segments(
            name, np.array([aim], np.float32), _TARGET, thickness=2.0, thickness_units="screen"
        )
        self._server.scene.add_icosphere(f"{name}/end", 0.22, color=_TARGET, position=aim[1])

    def _draw_way(self, way_m: FloatArray) -> None:
        if len(way_m) < self._positions:
            for block in range(self._positions // _BLOCK + 1):
                self._server.scene.remove_by_name(f"{self._root}/{WAYS}/{block}")
            self._positions = 0
        if len(way_m) == self._positions:
            return
        for block in range(max(self._positions - 1, 0) // _BLOCK, (len(way_m) - 1) // _BLOCK + 1):
            # A block begins where the one before it ends.
            part_m = way_m[max(block * _BLOCK - 1, 0) : (block + 1) * _BLOCK]
            draw_way(self._server, f"{self._root}/{WAYS}/{block}", part_m, self._colour)
        self._positions = len(way_m)

    def _draw_graph(self, graph: Sequence[GraphLines]) -> None:
        known = tuple((lines.label, len(lines.segments_m)) for lines in graph)
        if known == self._graph:
            return
        for label in {label for label, _ in self._graph} - {label for label, _ in known}:
            self._server.scene.remove_by_name(f"{self._root}/{GRAPHS}/{label}")
        draw_graph(self._server, f"{self._root}/{GRAPHS}", graph)
        self._graph = known

    def _draw_frontiers(self, places: tuple[Place, ...]) -> None:
        if places == self._frontiers:
            return
        if places:
            self._server.scene.add_point_cloud(
                f"{self._root}/{LEFT}/places",
                np.array(places, np.float32),
                _FRONTIER,
                point_size=0.5,
                point_shape="diamond",
                precision="float32",
            )
        else:
            self._server.scene.remove_by_name(f"{self._root}/{LEFT}/places")
        self._frontiers = places
