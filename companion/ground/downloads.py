"""The map as a file for whoever has the page open."""

from __future__ import annotations

import re
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import viser

from companion.errors import CompanionError
from companion.ground.station import VehicleView
from companion.ground.whole_map import whole_map
from companion.mapping.files import FORMATS, write
from companion.mapping.voxels.piece import MapSource


class Downloads:
    """Buttons of one visitor that make a file of the chosen vehicle's map, or one of all maps.

    Args:
        client: the visitor, as viser knows him.
        is_here: whether he still has the page open: he may leave while a file is made.
        vehicles: all that are known.
        chosen: the vehicle that he has chosen; None while there is none.
        one_at_a_time: held while a file is made, for whomever: each takes the memory of a whole map.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        is_here: Callable[[], bool],
        vehicles: Callable[[], Sequence[VehicleView]],
        chosen: Callable[[], VehicleView | None],
        one_at_a_time: threading.Lock,
    ) -> None:
        self._client = client
        self._is_here = is_here
        self._vehicles = vehicles
        self._chosen = chosen
        self._one_at_a_time = one_at_a_time
        gui = client.gui
        self._format = gui.add_dropdown("format", tuple(FORMATS), hint="What they hold is in docs/map.md")
        gui.add_button("Download its map", color="blue").on_click(self._of_chosen)
        self._of_all = gui.add_button(
            "Download one map of all",
            color="blue",
            visible=False,
            hint="The maps of all vehicles in the frame that they share, added up",
        )
        self._says = gui.add_markdown("")
        self._of_all.on_click(self._of_everybody)

    def offer_all(self, is_offered: bool) -> None:
        """Show the button for one map of all, or not."""
        self._of_all.visible = is_offered

    def _of_chosen(self, _: object) -> None:
        vehicle = self._chosen()
        if vehicle is None:
            self._say("Choose a vehicle first." if self._vehicles() else "No vehicle has been heard yet.")
            return
        self._send(file_name(vehicle), lambda format_, _: map_file(vehicle, format_))

    def _of_everybody(self, _: object) -> None:
        self._send("all", lambda format_, notes: whole_file_of(self._vehicles(), format_, notes.append))

    def _send(self, name: str, made: Callable[[str, list[str]], bytes]) -> None:
        if not self._one_at_a_time.acquire(blocking=False):
            self._say("One file is being made already.")
            return
        try:
            format_ = str(self._format.value)
            file, notes = f"{name}.{format_}", list[str]()
            self._say(f"Making {_plain(file)} …")
            content = made(format_, notes)
            if self._is_here():
                self._client.send_file_download(file, content, save_immediately=True)
            without = f"; not in it: {_plain('; '.join(notes))}" if notes else ""
            self._say(f"{_plain(file)}: {len(content):,} bytes{without}")
        except (CompanionError, OSError) as error:
            self._say(f"**Not made:** {_plain(str(error))}")
        finally:
            self._one_at_a_time.release()

    def _say(self, text: str) -> None:
        if self._is_here():
            self._says.content = text


def map_file(vehicle: VehicleView, format_: str) -> bytes:
    """The ground's copy of a vehicle's map in one of `FORMATS`.

    Raises:
        CompanionError: there is none yet, or the format cannot hold it.
        OSError: there is no room for it.
    """
    return _file_of(vehicle.source(), format_)


def whole_file_of(vehicles: Sequence[VehicleView], format_: str, leaves_out: Callable[[str], None]) -> bytes:
    """The ground's copies of all maps as one, in the frame that the vehicles share.

    Args:
        vehicles: whose maps.
        format_: one of `FORMATS`.
        leaves_out: is told of each vehicle that is not in it, and why.

    Raises:
        CompanionError: they cannot be put together, or the format cannot hold them.
        OSError: there is no room for it.
    """
    with whole_map(vehicles, leaves_out) as source:
        return _file_of(source, format_)


def file_name(vehicle: VehicleView) -> str:
    """Of vehicle and flight, fit for every file system."""
    flight = "" if vehicle.telemetry is None else vehicle.telemetry.flight
    return re.sub(r"[^A-Za-z0-9._-]+", "-", "-".join(filter(None, (vehicle.name, flight)))).strip("-.") or "map"


def _file_of(source: MapSource, format_: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="companion-ground-") as folder:
        path = Path(folder) / f"map.{format_}"
        write(source, path)
        return path.read_bytes()


def _plain(text: str) -> str:
    """Text without what Markdown would make of it."""
    return re.sub(r"([\\`*_{}\[\]()#+\-.!<>|])", r"\\\1", text)
