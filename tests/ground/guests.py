"""Somebody who has the page open, without a browser: he gets what a browser gets, and presses what a person presses."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec.msgpack
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from tests.shared.beside import wait_until

_CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, -3.0, 4.0),
    "fov": 0.9,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 900,
    "image_width": 1090,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
"""Whoever has said where he looks from is there, for viser."""


class Guest:
    """A visitor of the page.

    Args:
        port: that the page is served at.
    """

    def __init__(self, port: int) -> None:
        here = f"127.0.0.1:{port}"
        self._connection = connect(
            f"ws://{here}/",
            origin=Origin(f"http://{here}"),
            subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
            proxy=None,
            compression=None,
            max_size=None,
        )
        self.messages: list[dict[str, Any]] = []
        """All that has come, the oldest first."""
        self.bytes = 0
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        self._send(_CAMERA)

    def _read(self) -> None:
        try:
            for window in self._connection:
                assert isinstance(window, bytes)
                self.bytes += len(window)
                size = int.from_bytes(window[8:16], "little")
                told = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(window[16 : 16 + size]))
                self.messages += told["messages"]
        except ConnectionClosed:
            pass

    def _send(self, message: dict[str, Any]) -> None:
        self._connection.send(msgspec.msgpack.encode(message))

    def leave(self) -> None:
        """Close the page."""
        self._connection.close()
        self._reader.join()

    @property
    def elements(self) -> dict[str, dict[str, Any]]:
        """Properties of what stands on his page, with its value and its type, by what viser calls it."""
        found: dict[str, dict[str, Any]] = {}
        for message in list(self.messages):
            if "props" in message and message["type"].startswith("Gui"):
                found[message["uuid"]] = {"value": message.get("value"), **message["props"], "type": message["type"]}
            elif message["type"] == "GuiModalMessage":
                found[message["uuid"]] = {"label": message["title"], "type": message["type"]}
            elif message["type"] == "GuiUpdateMessage":
                found[message["uuid"]] |= message["updates"]
            elif message["type"] in ("GuiRemoveMessage", "GuiCloseModalMessage"):
                found.pop(message["uuid"], None)
        return found

    @property
    def hidden(self) -> set[str]:
        """Nodes of the scene that are hidden from him by one of his own in their place."""
        found: dict[str, bool] = {}
        for message in list(self.messages):
            if not message.get("owner"):
                continue
            if message["type"] == "SetSceneNodeVisibilityMessage":
                found[message["name"]] = message["visible"]
            elif message["type"] == "RemoveSceneNodeMessage":
                found.pop(message["name"], None)
        return {name for name, visible in found.items() if not visible}

    @property
    def text(self) -> str:
        """What he reads."""
        shown = (str(one.get("content") or one.get("_markdown") or "") for one in self.elements.values())
        return " ".join(re.sub(r"<style>.*?</style>|<[^>]*>", " ", " ".join(shown), flags=re.DOTALL).split())

    def _of(self, label: str) -> list[tuple[str, dict[str, Any]]]:
        return [(uuid, one) for uuid, one in self.elements.items() if one.get("label") == label]

    def has(self, label: str) -> bool:
        """Whether there is such a button, box or question."""
        return bool(self._of(label))

    def can_press(self, label: str) -> bool:
        """Whether there is such a button that is to be seen and not grey."""
        return any(one["visible"] and not one["disabled"] for _, one in self._of(label))

    def set(self, label: str, value: object) -> None:
        """Press a button, tick a box, or choose one of several."""
        [(uuid, _)] = self._of(label)
        self._send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})

    def press(self, label: str) -> None:
        """Press a button."""
        self.set(label, True)

    def choose(self, name: str) -> None:
        """Choose a vehicle."""
        self.set("show", name)


@contextmanager
def guest(page: Any) -> Iterator[Guest]:
    """A visitor of a page while the block runs, once he has got all that is his."""
    others = set(page.visitors)
    visiting = Guest(page.port)
    try:
        wait_until(lambda: bool(set(page.visitors) - others))
        [his] = set(page.visitors) - others
        page.turn()
        # The list of vehicles is written last of what is his; STOP comes with what all share.
        wait_until(lambda: "data-tick" in str(visiting.elements) and "Every vehicle brakes" in str(visiting.elements))
        yield visiting
    finally:
        visiting.leave()
    wait_until(lambda: his not in page.visitors)
