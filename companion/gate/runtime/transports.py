"""Links by their URL: udpin, udpout, tcpin, tcpout and serial, as in the configuration."""

from __future__ import annotations

import socket
from typing import Protocol

from companion.errors import InputError
from companion.gate.runtime.framing import Accept, FrameReader
from companion.gate.runtime.serial_port import SerialPort
from companion.gate.runtime.streams import StreamTransport, TcpIn, TcpOut
from companion.gate.runtime.udp import UdpIn, UdpOut
from companion.mavlink.codec import Frame
from companion.mavlink.link_url import NetworkLink, SerialLink, parse_link

AUTOPILOT_WAITING_BYTES = 2048
"""May wait in a TCP connection to the autopilot: what a stopped connection keeps arrives too late."""
ATTACHED_WAITING_BYTES = 65536


class Transport(Protocol):
    """A link that carries MAVLink. No call waits, and none raises for what the other end does.

    Attributes:
        unsent: messages that could not be sent.
        strangers: datagrams of others.
        problem: why it is not open, or who else is there, in words; empty: all is well, or it still tries.
        reader: counts what came and was no message, or not welcome.
    """

    unsent: int
    strangers: int
    problem: str
    reader: FrameReader

    def fileno(self) -> int | None:
        """What to wait for; None: nothing. It changes in `receive` and `tick` only."""
        ...

    def receive(self, now_s: float) -> list[Frame]:
        """What came in; a bounded number of messages, so call again while there is more to read."""
        ...

    def send(self, raw: bytes) -> None:
        """Send whole messages at once, or not at all."""
        ...

    def tick(self, now_s: float) -> None:
        """Look after it; call it in every cycle. What is not open is opened anew once a second."""
        ...

    def close(self) -> None:
        """End it."""
        ...


def open_transport(url: str, system_id: int | None = None, accept: Accept | None = None) -> Transport:
    """The link that a URL names.

    Args:
        url: as `companion.mavlink.link_url` has it.
        system_id: of the vehicle, when this is the link to its autopilot; None: somebody attached.
        accept: gives each message as it is passed on, or None to refuse it; None: all are welcome.

    Raises:
        InputError: it is no such URL, the host is unknown, or the port cannot be listened on.
    """
    try:
        link = parse_link(url)
    except ValueError as error:
        raise InputError(str(error)) from None
    if isinstance(link, SerialLink):
        return StreamTransport(SerialPort(link.device, link.baud), accept)
    address = _address(url, link)
    waiting = ATTACHED_WAITING_BYTES if system_id is None else AUTOPILOT_WAITING_BYTES
    try:
        if link.scheme == "udpin":
            return UdpIn(address, system_id, accept)
        if link.scheme == "udpout":
            return UdpOut(address, accept)
        return StreamTransport((TcpIn if link.listens else TcpOut)(address, waiting), accept)
    except OSError as error:
        raise InputError(
            f"{url} cannot be listened on: {error.strerror}; end what uses it, or configure another"
        ) from error


def _address(url: str, link: NetworkLink) -> tuple[str, int]:
    try:
        found = socket.getaddrinfo(link.host or "0.0.0.0", link.port, socket.AF_INET)  # noqa: S104 - as the URL says
    except OSError as error:
        raise InputError(f"{url}: no such host ({error.strerror})") from error
    number: tuple[str, int] = found[0][4][:2]  # type: ignore[assignment]
    return number
