"""Who may speak to the server of a page: the page itself, and no other that is open in the same browser."""

from __future__ import annotations

import http.client
import logging
import socket
from collections.abc import Iterator

import pytest

from sitl.launch.processes import free_tcp_port

pytest.importorskip("viser", reason="pip install mine-companion[ground]")

import viser
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from companion.viewer.same_origin import SameOrigin, only_same_origin
from companion.viewer.serving import serving


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    """Of a page that is served as `companion ground` and `companion map view` serve theirs."""
    with serving("A page", "127.0.0.1", free_tcp_port()) as server:
        yield server.get_port()


def first_bytes(port: int, origin: str | None, host: str = "127.0.0.1") -> bytes | str:
    """What a WebSocket of a page from ``origin`` gets to hear."""
    with (
        socket.create_connection(("127.0.0.1", port)) as line,
        connect(
            f"ws://{host}:{port}",
            sock=line,
            origin=None if origin is None else Origin(origin),
            subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
            compression=None,
            max_size=None,
        ) as page,
    ):
        return page.recv(timeout=10.0)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_the_page_itself_is_heard(port: int, host: str) -> None:
    """Protects the page: whoever opened it at an address of this computer gets what is on it."""
    assert len(first_bytes(port, f"http://{host}:{port}", host)) > 16


@pytest.mark.parametrize(
    "origin",
    [
        "http://mines.example",
        "http://mines.example:{port}",
        "http://localhost:{port}",
        "http://127.0.0.1",
        "http://127.0.0.1:1",
        "http://127.0.0.1:{port}.mines.example",
        "file://",
        "null",
        None,
    ],
)
def test_another_page_is_refused(port: int, origin: str | None) -> None:
    """Protects the vehicle from web pages that the operator has open beside: none of them can press a button here."""
    with pytest.raises(InvalidStatus) as refused:
        first_bytes(port, None if origin is None else origin.format(port=port))
    assert refused.value.response.status_code == 403
    assert b"may not speak to this one" in (refused.value.response.body or b"")


def test_a_name_that_only_points_here_is_refused(port: int) -> None:
    """Protects from DNS rebinding: a stranger's name for this computer makes host and origin equal."""
    with pytest.raises(InvalidStatus) as refused:
        first_bytes(port, f"http://mines.example:{port}", "mines.example")
    assert refused.value.response.status_code == 403
    assert b"give the name as --host" in (refused.value.response.body or b"")


def asked(port: int, host: str) -> http.client.HTTPResponse:
    line = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
    try:
        line.request("GET", "/", headers={"Host": host})
        answer = line.getresponse()
        answer.read()
        return answer
    finally:
        line.close()


def test_no_other_page_shows_this_one_in_a_frame(port: int) -> None:
    """Protects from a page that lays this one, invisible, over what people click."""
    answer = asked(port, f"127.0.0.1:{port}")
    assert answer.status == 200
    assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
    assert answer.headers["X-Frame-Options"] == "DENY"
    assert asked(port, "mines.example").status == 403


@pytest.mark.parametrize(
    ("host", "is_here"),
    [
        ("10.0.0.5:8080", True),
        ("[::1]:8080", True),
        ("LOCALHOST:8080", True),
        ("ground.mine:8080", True),
        (f"{socket.gethostname()}:8080", True),
        ("ground.mine.example:8080", False),
        ("10.0.0.5.mines.example", False),
        ("[::1", False),
        ("", False),
    ],
)
def test_names_of_this_computer(host: str, is_here: bool) -> None:
    """Protects the tablet that opens the page by address or name, and refuses every other name."""
    check = SameOrigin("ground.mine")
    assert (check.why_not(Headers({"Host": host})) == "") is is_here


def test_refusals_do_not_fill_the_log(caplog: pytest.LogCaptureFixture) -> None:
    """Protects the disk from a page that tries for ever: the first is said, all are counted."""
    check = SameOrigin("127.0.0.1")
    with caplog.at_level(logging.WARNING):
        guarded = check.before(lambda _, __: None)
        for _ in range(3):
            request = type("Asked", (), {"headers": Headers({"Host": "mines.example"})})()
            assert guarded(None, request) is not None  # type: ignore[arg-type]
    assert check.refused == 3
    assert len(caplog.records) == 1


def test_a_server_that_would_not_check_does_not_run() -> None:
    """Protects from a newer viser that starts its server in another way, and would hear everybody."""
    before = websockets.asyncio.server.serve
    with pytest.raises(RuntimeError, match="no stranger would be refused"), only_same_origin("127.0.0.1"):
        pass
    assert websockets.asyncio.server.serve is before
