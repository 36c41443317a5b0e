"""A map in the browser, served by viser: points for voxels, a cut by height, free space, the way flown.

Everything that the page needs comes from this machine, so that it works underground. What is cut by height is sent once
in layers, which are then shown and hidden.
"""

from __future__ import annotations

import io
import math
import socket
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, field

import numpy as np
import viser
from numpy.typing import NDArray

from companion.errors import InputError
from companion.mapping.files.clouds import viridis
from companion.model import FloatArray
from companion.viewer.graphs import GraphLines
from companion.viewer.voxels import PackedVoxels, State

MOST_LAYERS = 48
_COARSEST = 4
_STATE_COLOURS = {State.OCCUPIED: (60, 66, 72), State.FREE: (110, 170, 214), State.UNDECIDED: (230, 159, 0)}
_WAY_COLOURS = (213, 94, 0), (0, 114, 178), (0, 158, 115), (204, 121, 167)
_FREE_SIZE = 0.3
"""Free voxels are drawn this much smaller than they are, or one would see nothing but the nearest."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """The voxels of one state, as coarse as is needed for there not to be too many.

    Attributes:
        points_m: (n, 3) float32 centres of cubes.
        edge_m: their edge.
    """

    points_m: NDArray[np.float32]
    edge_m: float


def cloud(voxels: PackedVoxels, state: State, most_points: int) -> Cloud:
    """The finest cubes of 1, 2, 4, 8 or 16 voxels of which there are at most ``most_points``.

    When even the coarsest are too many, every so many of them is left out.
    """
    for level in range(_COARSEST + 1):
        edge_m = voxels.voxel_m * 2**level
        parts, count = [np.zeros((0, 3), np.int32)], 0
        for numbers in voxels.numbers(state, level):
            parts.append(numbers)
            count += len(numbers)
            if count > most_points and level < _COARSEST:
                break
        else:
            break
    every = math.ceil(count / most_points) or 1
    return Cloud(((np.concatenate(parts)[::every] + 0.5) * edge_m).astype(np.float32), edge_m)


class _Server(viser.ViserServer):
    """A server that never makes a map public: viser's own would open a tunnel at any visitor's request."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002 - viser's signature
        """No address."""
        return None


@dataclass
class _Layer:
    """The points between two heights."""

    state: State
    low_m: float
    high_m: float
    handle: viser.PointCloudHandle
    by_height: NDArray[np.uint8]


@dataclass
class Page:
    """A page that is being served.

    Attributes:
        server: viser's.
        note: what the user should know of what is shown; empty when all is.
    """

    server: viser.ViserServer
    note: str
    layers: list[_Layer] = field(default_factory=list)
    graph: dict[str, viser.LineSegmentsHandle] = field(default_factory=dict)
    """Lines of navigation graphs by what they are."""

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
    """Serve a map while the block runs.

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
    _refuse_taken(host, port)
    clouds = {state: cloud(voxels, state, most_points) for state in State}
    # Viser prints a banner and a farewell of its own, whatever its settings.
    with redirect_stdout(io.StringIO()):
        server = _Server(host=host, port=port, label=title, verbose=False)
    try:
        page = Page(server, _note(voxels, clouds))
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.scene.set_up_direction("+z")
        _draw(page, clouds, ways)
        _draw_graphs(page, lines)
        _control(page, voxels, title, list(ways))
        yield page
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def _refuse_taken(host: str, port: int) -> None:
    """Viser would quietly take the next port that is free, and the user would look at another map."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        raise InputError(
            f"cannot listen at {host} port {port}: {error.strerror}; give another --port or --host"
        ) from None


def _note(voxels: PackedVoxels, clouds: dict[State, Cloud]) -> str:
    coarse = [
        f"{state.name.lower()} in cubes of {shown.edge_m:g} m"
        for state, shown in clouds.items()
        if shown.edge_m > voxels.voxel_m * 1.5
    ]
    return f"too many voxels to show each: {', '.join(coarse)}" if coarse else ""


def _draw(page: Page, clouds: dict[State, Cloud], ways: dict[str, FloatArray]) -> None:
    scene = page.server.scene
    heights = np.concatenate([shown.points_m[:, 2] for shown in clouds.values()])
    if len(heights):
        low_m, high_m = float(heights.min()), float(heights.max())
        layer_m = max((high_m - low_m) / MOST_LAYERS, max(shown.edge_m for shown in clouds.values())) * (1 + 1e-6)
        for state, shown in clouds.items():
            layers = ((shown.points_m[:, 2] - low_m) / layer_m).astype(np.int32)
            for layer in np.unique(layers):
                points = shown.points_m[layers == layer]
                by_height = viridis((points[:, 2].astype(np.float64) - low_m) / max(high_m - low_m, layer_m))
                occupied = state is State.OCCUPIED
                handle = scene.add_point_cloud(
                    f"/map/{state.name.lower()}/{layer}",
                    points,
                    by_height if occupied else _STATE_COLOURS[state],
                    point_size=shown.edge_m * (1.0 if occupied else _FREE_SIZE),
                    point_shape="square",
                    point_shading="flat",
                    precision="float32",
                    visible=occupied,
                )
                bottom_m = low_m + int(layer) * layer_m
                page.layers.append(_Layer(state, bottom_m, bottom_m + layer_m, handle, by_height))
        middle = np.concatenate([shown.points_m for shown in clouds.values()])
        _aim(page.server, middle.min(axis=0), middle.max(axis=0))
    for number, (name, way) in enumerate(ways.items()):
        if len(way) > 1:
            lines = np.stack([way[:-1], way[1:]], axis=1).astype(np.float32)
            colour = _WAY_COLOURS[number % len(_WAY_COLOURS)]
            scene.add_line_segments(f"/way/{name}", lines, colour, thickness=3.0, thickness_units="screen")


def _draw_graphs(page: Page, lines: Sequence[GraphLines]) -> None:
    for drawn in lines:
        rgb = int(drawn.colour[1:3], 16), int(drawn.colour[3:5], 16), int(drawn.colour[5:7], 16)
        page.graph[drawn.label] = page.server.scene.add_line_segments(
            f"/graph/{drawn.label}",
            drawn.segments_m.astype(np.float32),
            rgb,
            thickness=4.0,
            thickness_units="screen",
        )


def _aim(server: viser.ViserServer, low_m: NDArray[np.float32], high_m: NDArray[np.float32]) -> None:
    """Let everyone who opens the page begin above the south of the map, looking at its middle."""
    middle = (low_m.astype(np.float64) + high_m) / 2.0
    reach = float(np.linalg.norm(high_m - low_m))
    server.initial_camera.look_at = tuple(middle)
    server.initial_camera.position = tuple(middle + reach * np.array([0.0, -0.4, 0.55]))
    server.initial_camera.far = max(1000.0, 10.0 * reach)


def _control(page: Page, voxels: PackedVoxels, title: str, ways: list[str]) -> None:
    gui = page.server.gui
    counts = ", ".join(f"{voxels.count(state):,} {state.name.lower()}" for state in State)
    gui.add_markdown(f"**{title}**\n\nvoxel {voxels.voxel_m:g} m: {counts}")
    if page.note:
        gui.add_markdown(f"*{page.note}*")
    colour = gui.add_dropdown(
        "colour", ("height", "state"), hint="Occupied voxels by their height, or all in one colour"
    )
    boxes = {state: gui.add_checkbox(state.name.lower(), state is State.OCCUPIED) for state in State}
    low_m = min((layer.low_m for layer in page.layers), default=0.0)
    high_m = max((layer.high_m for layer in page.layers), default=1.0)
    step_m = min((layer.high_m - layer.low_m for layer in page.layers), default=0.1)
    cut = gui.add_multi_slider(
        "z (m)",
        min=round(low_m, 3),
        max=round(high_m, 3),
        step=round(step_m, 3),
        initial_value=(round(low_m, 3), round(high_m, 3)),
        hint="Hide what is below the first and above the second: take the roof off",
    )

    def show(_: object) -> None:
        bottom_m, top_m = cut.value
        for layer in page.layers:
            middle_m = (layer.low_m + layer.high_m) / 2.0
            layer.handle.visible = boxes[layer.state].value and bottom_m <= middle_m <= top_m

    def paint(_: object) -> None:
        for layer in page.layers:
            if layer.state is State.OCCUPIED:
                by_state = np.array(_STATE_COLOURS[layer.state], np.uint8)
                layer.handle.colors = layer.by_height if colour.value == "height" else by_state

    cut.on_update(show)
    for box in boxes.values():
        box.on_update(show)
    colour.on_update(paint)
    if ways:
        gui.add_markdown(f"way flown: {', '.join(ways)}")
    if page.graph:
        graph = gui.add_checkbox("navigation graph", initial_value=True, hint=", ".join(page.graph))

        def show_graph(_: object) -> None:
            for lines in page.graph.values():
                lines.visible = graph.value

        graph.on_update(show_graph)
