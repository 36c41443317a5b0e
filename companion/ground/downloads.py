"""The map as a file for whoever has the page open."""

from __future__ import annotations

import re
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import viser

from companion.errors import CompanionError
from companion.ground.station import VehicleView
from companion.mapping.files import FORMATS, write


class Downloads:
    """Buttons that make a file of the chosen vehicle's map.

    Args:
        server: viser's.
        chosen: the vehicle; None while there is none.
    """

    def __init__(self, server: viser.ViserServer, chosen: Callable[[], VehicleView | None]) -> None:
        self._chosen = chosen
        self._one_at_a_time = threading.Lock()
        gui = server.gui
        self._format = gui.add_dropdown("format", tuple(FORMATS), hint="What they hold is in docs/map.md")
        button = gui.add_button("Download its map", color="blue")
        self._says = gui.add_markdown("")
        button.on_click(self._pressed)

    def _pressed(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        vehicle = self._chosen()
        if vehicle is None or event.client is None:
            self._says.content = "No vehicle has been heard yet."
            return
        if not self._one_at_a_time.acquire(blocking=False):
            self._says.content = "One file is being made already."
            return
        try:
            self._says.content = f"Making the file of {_plain(vehicle.name)} …"
            name = f"{file_name(vehicle)}.{self._format.value}"
            content = map_file(vehicle, self._format.value)
            event.client.send_file_download(name, content, save_immediately=True)
            self._says.content = f"{name}: {len(content):,} bytes"
        except (CompanionError, OSError) as error:
            self._says.content = f"**Not made:** {error}"
        finally:
            self._one_at_a_time.release()


def map_file(vehicle: VehicleView, format_: str) -> bytes:
    """The ground's copy of a vehicle's map in one of `FORMATS`.

    Raises:
        CompanionError: the format cannot hold it.
        OSError: there is no room for it.
    """
    with tempfile.TemporaryDirectory(prefix="companion-ground-") as folder:
        path = Path(folder) / f"map.{format_}"
        write(vehicle.source(), path)
        return path.read_bytes()


def file_name(vehicle: VehicleView) -> str:
    """Of vehicle and flight, fit for every file system."""
    flight = "" if vehicle.telemetry is None else vehicle.telemetry.flight
    return re.sub(r"[^A-Za-z0-9._-]+", "-", "-".join(filter(None, (vehicle.name, flight)))).strip("-.") or "map"


def _plain(text: str) -> str:
    """Text without what Markdown would make of it."""
    return re.sub(r"([\\`*_{}\[\]()#+\-.!<>|])", r"\\\1", text)
