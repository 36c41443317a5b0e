"""A map in the browser, served by viser: points for voxels, a cut by height, free space, the way flown.

Everything that the page needs comes from this machine, so that it works underground.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import viser

from companion.model import FloatArray
from companion.viewer.drawing import HeightRange, MapDrawing, Rgb, Style
from companion.viewer.graphs import GraphLines
from companion.viewer.serving import serving
from companion.viewer.tiles import Shown
from companion.viewer.voxels import PackedVoxels, State

WAY_COLOURS: tuple[Rgb, ...] = (213, 94, 0), (0, 114, 178), (0, 158, 115), (204, 121, 167), (86, 180, 233)
"""By vehicle."""

OBLIQUE: FloatArray = np.array([0.0, -0.6, 0.8])
STEEP: FloatArray = np.array([0.0, -0.001, 1.0])
"""Where the eye is: above the south, and straight above."""

FOV_RAD = 0.9
"""From the lower edge of the picture to the upper."""

_NARROW = 1.1
"""Width over height of the part of a tablet that the controls leave; what is wider has room to spare."""

_ROOM = 1.04


@dataclass
class Page:
    """A page that is being served.

    Attributes:
        server: viser's.
        drawing: the map on it.
        note: what the user should know of what is shown; empty when all is.
        graph: lines of navigation graphs by what they are.
    """

    server: viser.ViserServer
    drawing: MapDrawing
    note: str = ""
    graph: dict[str, viser.LineSegmentsHandle] = field(default_factory=dict)

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self.server.get_port())

    def wait(self) -> None:
        """Serve until Ctrl-C."""
        threading.Event().wait()


@contextmanager
def serve(
    voxels: PackedVoxels,
    title: str,
    ways: dict[str, FloatArray],
    host: str,
    port: int,
    most_points: int,
    lines: Sequence[GraphLines] = (),
) -> Iterator[Page]:
    """Serve a map while the block runs. It begins with the roof taken off.

    Args:
        voxels: the map.
        title: stands over the controls.
        ways: by name, (n, 3) positions in m.
        host: address to listen at.
        port: port there.
        most_points: occupied voxels are shown coarser when there are more; so are the others.
        lines: navigation graphs.

    Raises:
        InputError: nothing can listen there.
    """
    with serving(title, host, port) as server:
        heights = HeightRange()
        page = Page(server, MapDrawing(server, "/map", voxels.voxel_m, heights))
        page.drawing.put(voxels)
        low_m, high_m = (corner.astype(np.float64) * voxels.voxel_m for corner in voxels.bounds())
        # The colours are those of the heights that there are: this map does not grow.
        heights.low_m, heights.high_m = float(low_m[2]) + voxels.voxel_m / 2.0, float(high_m[2]) - voxels.voxel_m / 2.0
        page.drawing.restyle(Style(most_points=most_points))
        page.drawing.draw()
        page.note = _note(voxels, page.drawing)
        aim(server, low_m, high_m)
        for number, (name, way_m) in enumerate(ways.items()):
            draw_way(server, f"/way/{name}", way_m, WAY_COLOURS[number % len(WAY_COLOURS)])
        page.graph = draw_graph(server, "/graph", lines)
        _control(page, voxels, title, list(ways), most_points, (float(low_m[2]), float(high_m[2])))
        yield page


def draw_way(server: viser.ViserServer, name: str, way_m: FloatArray, colour: Rgb) -> None:
    """Draw (n, 3) positions as a line, in place of what was there."""
    if len(way_m) > 1:
        lines = np.stack([way_m[:-1], way_m[1:]], axis=1).astype(np.float32)
        server.scene.add_line_segments(name, lines, colour, thickness=3.0, thickness_units="screen")


def draw_graph(
    server: viser.ViserServer, root: str, lines: Sequence[GraphLines]
) -> dict[str, viser.LineSegmentsHandle]:
    """Draw a navigation graph; by what they are, its lines."""
    return {
        drawn.label: server.scene.add_line_segments(
            f"{root}/{drawn.label}",
            drawn.segments_m.astype(np.float32),
            rgb(drawn.colour),
            thickness=4.0,
            thickness_units="screen",
        )
        for drawn in lines
    }


def rgb(colour: str) -> Rgb:
    """Of ``#rrggbb``."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def aim(server: viser.ViserServer, low_m: FloatArray, high_m: FloatArray) -> None:
    """Let everyone who opens the page begin above the south of a box, with all of it in sight; two (3,) corners."""
    camera = server.initial_camera
    camera.fov = FOV_RAD
    camera.look_at, camera.position = view_of(low_m, high_m, OBLIQUE, _NARROW)
    camera.far = max(1000.0, 10.0 * float(np.linalg.norm(high_m - low_m)))


def view_of(
    low_m: FloatArray, high_m: FloatArray, towards: FloatArray, aspect: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Where to look, and from where, to have a box in sight and no more.

    Args:
        low_m: (3,) its lowest corner.
        high_m: (3,) its highest.
        towards: (3,) from its middle to the eye; any length.
        aspect: width of the picture over its height.
    """
    corners = np.stack(np.meshgrid(*zip(low_m, high_m, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
    middle = (low_m + high_m) / 2.0
    back = towards / np.linalg.norm(towards)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    half_high = math.tan(FOV_RAD / 2.0)
    beside = np.abs((corners - middle) @ right) / (half_high * aspect)
    over = np.abs((corners - middle) @ np.cross(back, right)) / half_high
    away_m = max(_ROOM * float((np.maximum(beside, over) + (corners - middle) @ back).max()), 1.0)
    x_m, y_m, z_m = (middle + away_m * back).tolist()
    at_x_m, at_y_m, at_z_m = middle.tolist()
    return (at_x_m, at_y_m, at_z_m), (x_m, y_m, z_m)


def _note(voxels: PackedVoxels, drawing: MapDrawing) -> str:
    coarse = [
        f"{state.name.lower()} in cubes of {drawing.edge_m(state):g} m"
        for state in State
        if drawing.edge_m(state) > voxels.voxel_m * 1.5
    ]
    return f"too many voxels to show each: {', '.join(coarse)}" if coarse else ""


def _control(
    page: Page,
    voxels: PackedVoxels,
    title: str,
    ways: list[str],
    most_points: int,
    heights_m: tuple[float, float],
) -> None:
    gui = page.server.gui
    counts = ", ".join(f"{voxels.count(state):,} {state.name.lower()}" for state in State)
    gui.add_markdown(f"**{title}**\n\nvoxel {voxels.voxel_m:g} m: {counts}")
    if page.note:
        gui.add_markdown(f"*{page.note}*")
    roof = gui.add_checkbox("roof", initial_value=False, hint="Show what hides the ground from above")
    low_m, high_m = (round(height_m, 3) for height_m in heights_m)
    cut = gui.add_multi_slider(
        "z (m)",
        min=low_m,
        max=high_m,
        step=round(voxels.voxel_m, 3),
        initial_value=(low_m, high_m),
        hint="Hide what is below the first and above the second",
    )
    colour = gui.add_dropdown(
        "colour", ("height", "state"), hint="Occupied voxels by their height, or all in one colour"
    )
    boxes = {state: gui.add_checkbox(state.name.lower(), state is State.OCCUPIED) for state in State}
    drawing_lock = threading.Lock()

    def show(_: object) -> None:
        with drawing_lock:
            bottom_m, top_m = cut.value
            # The ends of the slider are rounded, and must not cut off what is there.
            bottom_m, top_m = -math.inf if bottom_m <= low_m else bottom_m, math.inf if top_m >= high_m else top_m
            page.drawing.restyle(
                Style(
                    Shown(roof.value, bottom_m, top_m),
                    frozenset(state for state, box in boxes.items() if box.value),
                    colour.value == "height",
                    most_points,
                )
            )
            page.drawing.draw()

    roof.on_update(show)
    cut.on_update(show)
    colour.on_update(show)
    for box in boxes.values():
        box.on_update(show)
    if ways:
        gui.add_markdown(f"way flown: {', '.join(ways)}")
    if page.graph:
        graph = gui.add_checkbox("navigation graph", initial_value=True, hint=", ".join(page.graph))

        def show_graph(_: object) -> None:
            for lines in page.graph.values():
                lines.visible = graph.value

        graph.on_update(show_graph)
