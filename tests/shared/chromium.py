"""A real browser without a screen: Chromium, driven through its DevTools protocol."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

EXECUTABLE = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

_PATIENCE_S = 60.0
_FIELD_OF = """((label) => {
    for (let around = label; around; around = around.parentElement) {
        const field = around.querySelector('input, textarea');
        if (field) return field;
    }
})"""
"""The field or box that a label stands beside."""


class Browser:
    """One page in Chromium.

    Args:
        connection: to its DevTools.
    """

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self._asked = 0
        self.requested: list[str] = []
        """Addresses that the page has asked for."""
        self.complaints: list[str] = []
        """Exceptions that no script has caught."""
        for domain in ("Page", "Runtime", "Network"):
            self.ask(f"{domain}.enable")

    def ask(self, method: str, **parameters: object) -> dict[str, Any]:
        """One command of the protocol, and its result."""
        self._asked += 1
        self._connection.send(json.dumps({"id": self._asked, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._connection.recv(timeout=_PATIENCE_S))
            if message.get("id") == self._asked:
                assert "error" not in message, message["error"]
                return dict(message["result"])
            if message.get("method") == "Network.requestWillBeSent":
                self.requested.append(message["params"]["request"]["url"])
            elif message.get("method") == "Runtime.exceptionThrown":
                self.complaints.append(str(message["params"]["exceptionDetails"]))

    def size(self, width: int, height: int, *, touch: bool = False) -> None:
        """The size of the window's inside, as a desktop's or as a tablet's that is touched."""
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self.ask("Emulation.setTouchEmulationEnabled", enabled=touch)

    def open(self, address: str) -> None:
        """Go to an address; its content may come later."""
        self.ask("Page.navigate", url=address)

    def value(self, expression: str) -> Any:
        """What JavaScript makes of an expression."""
        answer = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    @property
    def text(self) -> str:
        """All that can be read on the page."""
        return str(self.value("document.body?.innerText ?? ''"))

    def wait_for(self, expression: str, patience_s: float = _PATIENCE_S) -> None:
        """Wait until an expression is true."""
        end_s = time.monotonic() + patience_s
        while not self.value(expression):
            assert time.monotonic() < end_s, f"not within {patience_s:g} s: {expression}; the page says: {self.text}"
            time.sleep(0.05)

    def wait_for_text(self, text: str, patience_s: float = _PATIENCE_S) -> None:
        """Wait until something can be read."""
        self.wait_for(f"(document.body?.innerText ?? '').includes({json.dumps(text)})", patience_s)

    def click(self, label: str) -> None:
        """Click the middle of the button or of the box that has this label, where a person would see it."""
        find = f"""(() => {{
            const all = [...document.querySelectorAll('button, label, a, [role=tab]')];
            const found = all.find((one) => one.innerText.trim() === {json.dumps(label)} && one.offsetParent !== null);
            if (!found) return null;
            found.scrollIntoView({{block: 'nearest'}});
            const box = (found.tagName === 'LABEL' ? {_FIELD_OF}(found) : found).getBoundingClientRect();
            return [box.x + box.width / 2, box.y + box.height / 2];
        }})()"""
        self.wait_for(f"{find} !== null")
        before, place = None, self.value(find)
        while place != before:
            # What opens moves into its place.
            time.sleep(0.1)
            before, place = place, self.value(find)
        assert place is not None, f"{label!r} has gone"
        self.click_at(*place)

    def type_into(self, label: str, text: str) -> None:
        """Put text in place of what is in the field with this label."""
        find = f"""[...document.querySelectorAll('label')]
            .find((one) => one.innerText.trim() === {json.dumps(label)} && one.offsetParent !== null)"""
        self.wait_for(f"{find} !== undefined")
        field = f"{_FIELD_OF}({find})"
        self.value(f"{field}.focus(), {field}.select()")
        self.ask("Input.insertText", text=text)

    def click_at(self, x: float, y: float) -> None:
        """Press and let go the left button of the mouse there."""
        self.ask("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
        for kind in ("mousePressed", "mouseReleased"):
            self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    def screenshot(self, path: Path) -> None:
        """Write what is to be seen into a PNG."""
        path.write_bytes(base64.b64decode(self.ask("Page.captureScreenshot", format="png")["data"]))


@contextmanager
def browser(profile: Path) -> Iterator[Browser]:
    """A browser that has never been used, while the block runs.

    Args:
        profile: an empty folder for what it keeps.
    """
    assert EXECUTABLE is not None
    command = [
        EXECUTABLE, "--headless=new", "--remote-debugging-port=0", f"--user-data-dir={profile}", "--no-first-run",
        "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars", "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader", "about:blank",
    ]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            with connect(_page_of(profile, process), max_size=1 << 28, proxy=None) as connection:
                assert isinstance(connection, ClientConnection)
                yield Browser(connection)
        finally:
            process.terminate()


def _page_of(profile: Path, process: subprocess.Popen[bytes]) -> str:
    """The DevTools address of the first page."""
    told, end_s = profile / "DevToolsActivePort", time.monotonic() + _PATIENCE_S
    while not (told.exists() and told.read_text().strip()):
        assert process.poll() is None, "Chromium ended"
        assert time.monotonic() < end_s, "Chromium did not come up"
        time.sleep(0.05)
    port = int(told.read_text().split()[0])
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
        return str(next(page["webSocketDebuggerUrl"] for page in json.load(answer) if page["type"] == "page"))
