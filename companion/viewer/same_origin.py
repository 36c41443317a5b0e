"""Nobody but the page itself speaks to its server: no other web page that is open in the same browser.

A browser lets any web page open a WebSocket to any address, this computer's own too, and says in `Origin` which page
asks; viser does not look at it. Nor does the address of a page say much by itself: a stranger's name can be made to
point at this computer (DNS rebinding), and then `Origin` and `Host` are equal. So `Host` has to be an address or a name
of this computer, `Origin` has to be the same, and no other page may show this one in a frame, to have it clicked.
"""

from __future__ import annotations

import http
import ipaddress
import logging
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

Answers = Callable[[ServerConnection, Request], Response | None]
"""What viser does with a request: a file of the page, or None, and the WebSocket is opened."""

_log = logging.getLogger(__name__)


class SameOrigin:
    """Looks at each request before viser does.

    Args:
        host: what is listened at, and so a name of this computer.
    """

    def __init__(self, host: str) -> None:
        self.refused = 0
        """Requests that were."""
        name = socket.gethostname().lower()
        # Not its name in the DNS: to ask for it takes many seconds where there is none, as underground.
        self._names = {"localhost", host.lower(), name, f"{name}.local"}

    def why_not(self, headers: Headers) -> str:
        """What is wrong with a request; empty when nothing is."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_here(hosts[0]):
            name = " ".join(hosts) or "no name"
            return f"{name} is no name of this computer: open its IP address, or give the name as --host"
        if "Upgrade" not in headers:
            return ""
        # Every browser says it. What is not one can do without a browser whatever it likes.
        if len(origins) != 1 or _authority(origins[0]) != hosts[0].lower():
            return f"a page of {' '.join(origins) or 'unknown origin'} may not speak to this one"
        return ""

    def before(self, answers: Answers) -> Answers:
        """The same answers, but for requests from elsewhere."""

        def guarded(connection: ServerConnection, request: Request) -> Response | None:
            if why := self.why_not(request.headers):
                self.refused += 1
                if self.refused == 1:
                    _log.warning("a request to the page was refused: %s; further ones are only counted", why)
                content = f"{why}\n".encode()
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", _plain_text(content), content)
            response = answers(connection, request)
            if response is not None:
                response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"
                response.headers["X-Frame-Options"] = "DENY"
            return response

        return guarded

    def _is_here(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        try:
            # Nobody can make a number point elsewhere.
            ipaddress.ip_address(name)
        except ValueError:
            return name in self._names
        return True


@contextmanager
def only_same_origin(host: str) -> Iterator[SameOrigin]:
    """While the block runs, a server that viser starts gets the check.

    Viser offers no place for it, but has its server made by websockets, which does.

    Raises:
        RuntimeError: no server was started, or in another way: it must not run without the check.
    """
    check = SameOrigin(host)
    made = websockets.asyncio.server.serve
    started = 0

    def serve(*args: Any, process_request: Answers, **options: Any) -> Any:
        nonlocal started
        started += 1
        return made(*args, process_request=check.before(process_request), **options)

    websockets.asyncio.server.serve = serve  # type: ignore[assignment,misc]
    try:
        yield check
    finally:
        websockets.asyncio.server.serve = made  # type: ignore[misc]
    if started == 0:
        raise RuntimeError("this version of viser starts its server in a way in which no stranger would be refused")


def _authority(origin: str) -> str:
    """Host and port of an origin; empty where it has none, as that of a file."""
    try:
        parts = urlsplit(origin)
    except ValueError:
        return ""
    return parts.netloc.lower() if parts.scheme in ("http", "https") else ""


def _plain_text(content: bytes) -> Headers:
    return Headers(
        {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(content)), "Connection": "close"}
    )
