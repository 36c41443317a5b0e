"""The operator's page: the map as it grows, the vehicles in it, how they are, and what they are asked.

One thread draws, a turn after another; what is pressed is done at once by the thread that hears of it. What is large is
the server's, and sent once; what depends on the chosen vehicle is each visitor's own.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from companion.ground.access import Access
from companion.ground.cards import STYLE
from companion.ground.commanding import Commanding
from companion.ground.shown_vehicle import ShownVehicle
from companion.ground.station import Station, VehicleView
from companion.ground.view_controls import Box, ViewControls, look
from companion.ground.visitor import TABS_ORDER, Tabs, Visitor
from companion.model import FloatArray
from companion.viewer.drawing import FINEST, HeightRange, levels_of
from companion.viewer.page import OBLIQUE, WAY_COLOURS, aim
from companion.viewer.serving import serving
from companion.viewer.voxels import State

PERIOD_S = 0.2
"""Time between two looks at the vehicles."""

MAP_PERIOD_S = 1.0
"""Time between two looks at what their maps have that the page has not."""

_DRAWING_S = 0.1
"""Of a turn, so much may go into drawing: a map that is behind must not keep the figures from being live."""

_PANEL_PX = 350

_SETTLING_S = 0.7
"""The panel takes its place after the first picture, and the picture has less room from then on."""

_START_M: Box = (np.array([-15.0, -15.0, 0.0]), np.array([15.0, 15.0, 3.0]))
_NEAR_M = np.array([8.0, 8.0, 2.0])
"""What is seen of the surroundings of a vehicle."""

_log = logging.getLogger(__name__)


class GroundPage:
    """The page while it is served.

    Args:
        server: viser's.
        station: the vehicles.
        access: who may command.
        most_points: cubes become coarser where there are more, in all maps together.
        now_s: monotonic time.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        station: Station,
        access: Access,
        most_points: int,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.server = server
        self._station = station
        self._access = access
        self._most_points = most_points
        self._now_s = now_s
        self._heights = HeightRange()
        self._levels = FINEST
        self._shown: dict[str, ShownVehicle] = {}
        self._visitors: dict[int, Visitor] = {}
        self._aimed_at_m: Box | None = None
        self._next_map_s = -math.inf
        self._turns = 0
        self._drawing = threading.Lock()
        self._one_file_at_a_time = threading.Lock()
        self.commanding = Commanding(server, station.vehicles)
        self._tabs = self._lay_out()
        server.on_client_connect(self._welcome)
        server.on_client_disconnect(self._take_leave)

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self.server.get_port())

    @property
    def points(self) -> int:
        """How many points are drawn."""
        return sum(shown.drawing.points for shown in self._shown.values() if shown.drawing is not None)

    @property
    def waiting(self) -> int:
        """Tiles that are not on the page as they should be yet."""
        return sum(shown.drawing.waiting for shown in self._shown.values() if shown.drawing is not None)

    @property
    def cubes_m(self) -> float:
        """Edge of the cubes that stand for occupied voxels; 0 while there are none."""
        drawings = (shown.drawing for shown in self._shown.values())
        return max((drawing.edge_m(State.OCCUPIED) for drawing in drawings if drawing is not None), default=0.0)

    @property
    def memory_bytes(self) -> int:
        """What the voxels of all maps take."""
        drawings = (shown.drawing for shown in self._shown.values())
        return sum(drawing.map.memory_bytes for drawing in drawings if drawing is not None)

    @property
    def visitors(self) -> Sequence[Visitor]:
        """Those who have the page open."""
        return list(self._visitors.values())

    def run(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Keep the page up to date until ``stop`` or Ctrl-C."""
        while not stop():
            began_s = time.monotonic()
            self.turn()
            time.sleep(max(PERIOD_S - (time.monotonic() - began_s), 0.01))

    def turn(self) -> None:
        """One look at everything."""
        vehicles = list(self._station.vehicles())
        self._meet(vehicles)
        self.commanding.refresh()
        self._tell_visitors(vehicles)
        with self._drawing:
            for vehicle in vehicles:
                self._shown[vehicle.name].lie(vehicle.telemetry)
                self._shown[vehicle.name].sketch.look(vehicle)
            if self._now_s() >= self._next_map_s:
                self._next_map_s = self._now_s() + MAP_PERIOD_S
                for vehicle in vehicles:
                    self._shown[vehicle.name].take_map(vehicle, self._heights)
                self._aim(*self._whole())
            self._draw_maps()
        self._turns += 1

    # Coroutines: viser's event loop welcomes visitors and takes leave of them one after another, so that nothing stays
    # behind of one who has gone while he was welcomed.

    async def _welcome(self, client: viser.ClientHandle) -> None:
        """Give one who has opened the page what is his."""

        def seen(origin_m: NDArray[np.float64], towards: NDArray[np.float64]) -> NDArray[np.float64] | None:
            return self._seen(visitor, origin_m, towards)

        visitor = Visitor(
            client, self._tabs, self._station, self._access, self.commanding, seen, self._one_file_at_a_time
        )
        visitor.settled_s = self._now_s() + _SETTLING_S
        self._visitors[client.client_id] = visitor

    async def _take_leave(self, client: viser.ClientHandle) -> None:
        visitor = self._visitors.pop(client.client_id, None)
        if visitor is not None:
            visitor.leave()
        self._access.forget(client)

    def _lay_out(self) -> Tabs:
        """Put on the page what all share."""
        gui = self.server.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_PANEL_PX)
        gui.add_html(f"<style>{STYLE}</style>")
        self.commanding.add_stop()
        tabs = gui.add_tab_group(order=TABS_ORDER)
        vehicle = tabs.add_tab("Vehicle", viser.Icon.DRONE)
        view = tabs.add_tab("View", viser.Icon.EYE)
        with view:
            self.view = ViewControls(self.server, self._whole, self._around_chosen)
        return Tabs(vehicle, view, tabs.add_tab("Map", viser.Icon.RULER_MEASURE))

    def _meet(self, vehicles: list[VehicleView]) -> None:
        """Take vehicles that are new onto the page."""
        new = [vehicle for vehicle in vehicles if vehicle.name not in self._shown]
        for vehicle in new:
            colour = WAY_COLOURS[len(self._shown) % len(WAY_COLOURS)]
            shown = self._shown[vehicle.name] = ShownVehicle(self.server, len(self._shown), vehicle.name, colour)
            shown.sketch.body.on_click(self._choosing(vehicle.name))

    def _choosing(
        self, name: str
    ) -> Callable[[viser.SceneNodePointerEvent[viser.MeshHandle]], Coroutine[Any, Any, None]]:
        async def choosing(event: viser.SceneNodePointerEvent[viser.MeshHandle]) -> None:
            visitor = self._visitors.get(event.client_id)
            if visitor is not None:
                visitor.choose(name)

        return choosing

    def _tell_visitors(self, vehicles: list[VehicleView]) -> None:
        # Once a second the list is another one, though nothing has changed: it knows by that that it is not old.
        tick = self._turns // round(1.0 / PERIOD_S)
        for visitor in self.visitors:
            try:
                visitor.refresh(vehicles, self._shown, tick)
                self._show_whole_map(visitor)
            except Exception:  # noqa: BLE001 - whatever it is, the others and the maps go on; his page says that it is old
                # Of one who has just gone viser takes nothing more, and says so.
                if visitor.client.client_id in self.server.get_clients():
                    _log.exception("the page of visitor %d was not brought up to date", visitor.client.client_id)

    def _show_whole_map(self, visitor: Visitor) -> None:
        """Let one who has come look at it, once."""
        if visitor.settled_s <= self._now_s():
            visitor.settled_s = math.inf
            look(visitor.client, *self._whole(), OBLIQUE)

    def _aim(self, low_m: FloatArray, high_m: FloatArray) -> None:
        """Let those who come begin with the whole map; those who are here are told of it only when it has grown."""
        if self._aimed_at_m is None or not np.array_equal(self._aimed_at_m, (low_m, high_m)):
            self._aimed_at_m = low_m, high_m
            aim(self.server, low_m, high_m)

    def _draw_maps(self) -> None:
        drawings = [shown.drawing for shown in self._shown.values() if shown.drawing is not None]
        self.view.bound(self._heights.low_m, self._heights.high_m)
        style = self.view.style(self._most_points)
        self._levels = levels_of([drawing.map for drawing in drawings], self._most_points, self._levels)
        end_s = time.perf_counter() + _DRAWING_S
        outgrown = False
        for drawing in drawings:
            drawing.restyle(style, self._levels)
            outgrown |= drawing.draw(max(end_s - time.perf_counter(), 0.0))
        if outgrown:
            for drawing in drawings:
                drawing.repaint()

    def _whole(self) -> Box:
        """Around all maps; around where a vehicle begins while there is none."""
        boxes = [box for shown in list(self._shown.values()) if (box := shown.bounds_m()) is not None]
        lows, highs = zip(*boxes, strict=True) if boxes else ((_START_M[0],), (_START_M[1],))
        return np.min(lows, axis=0), np.max(highs, axis=0)

    def _around_chosen(self, client: viser.ClientHandle) -> Box | None:
        visitor = self._visitors.get(client.client_id)
        vehicle = None if visitor is None else visitor.chosen()
        told = None if vehicle is None else vehicle.telemetry
        if vehicle is None or told is None or told.x_m is None or told.y_m is None or told.z_m is None:
            return None
        at_m = self._shown[vehicle.name].shared_m(told.x_m, told.y_m, told.z_m)
        return at_m - _NEAR_M, at_m + _NEAR_M

    def _seen(
        self, visitor: Visitor, origin_m: NDArray[np.float64], towards: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """What a visitor's click hits: of vehicles that he has not hidden, the nearest point of a map."""
        with self._drawing:
            found = [
                point
                for shown in self._shown.values()
                if not visitor.view.hides(shown.name) and (point := shown.seen_from(origin_m, towards)) is not None
            ]
        return min(found, key=lambda point: float(np.linalg.norm(point - origin_m)), default=None)


@contextmanager
def serve(
    station: Station, title: str, host: str, port: int, most_points: int, code: str | None = None
) -> Iterator[GroundPage]:
    """Serve the operator's page while the block runs; `GroundPage.run` keeps it up to date.

    Args:
        station: the vehicles.
        title: stands over the controls.
        host: address to listen at.
        port: port there.
        most_points: cubes become coarser where there are more.
        code: what has to be typed before commands are sent; None: nothing. STOP needs none.

    Raises:
        InputError: nothing can listen there.
    """
    with serving(title, host, port) as server:
        aim(server, *_START_M)
        yield GroundPage(server, station, Access(code), most_points)
