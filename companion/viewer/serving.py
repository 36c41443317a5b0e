"""Viser's server as every page here runs it: from this machine alone, at the port that was asked for, and private."""

from __future__ import annotations

import io
import socket
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout

import viser

from companion.errors import InputError
from companion.viewer.same_origin import only_same_origin


class _Server(viser.ViserServer):
    """A server that never makes a map public: viser's own would open a tunnel at any visitor's request."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002 - viser's signature
        """No address."""
        return None


@contextmanager
def serving(title: str, host: str, port: int) -> Iterator[viser.ViserServer]:
    """Serve an empty page while the block runs.

    Args:
        title: stands over the controls.
        host: address to listen at.
        port: port there.

    Raises:
        InputError: nothing can listen there.
    """
    _refuse_taken(host, port)
    # Viser prints a banner and a farewell of its own, whatever its settings.
    with redirect_stdout(io.StringIO()), only_same_origin(host):
        server = _Server(host=host, port=port, label=title, verbose=False)
    try:
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.scene.set_up_direction("+z")
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def reached_at(host: str) -> str:
    """What to type into a browser for the address that is listened at: 0.0.0.0 is no place to go to."""
    return {"127.0.0.1": "localhost", "0.0.0.0": socket.gethostname()}.get(host, host)  # noqa: S104 - the user asks


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
