"""Where a MAVLink partner is: the grammar of links, which the configuration checks and the gate opens."""

from __future__ import annotations

import re
from dataclasses import dataclass

LINK_FORMS = (
    "udpin://HOST:PORT (listen), udpout://HOST:PORT, tcpin://HOST:PORT, tcpout://HOST:PORT or serial:///dev/NAME:BAUD"
)
DEFAULT_BAUD = 57600

_NETWORK = re.compile(r"(udpin|udpout|tcpin|tcpout)://([^\s:/]*):([0-9]{1,5})")
_SERIAL = re.compile(r"serial://(/?[^\s:]+)(?::([0-9]{3,8}))?")


@dataclass(frozen=True, slots=True)
class NetworkLink:
    """A port that is listened on, of every address when the host is empty; or one that is gone to."""

    scheme: str
    host: str
    port: int

    @property
    def listens(self) -> bool:
        """Whether the partner comes here."""
        return self.scheme.endswith("in")

    @property
    def place(self) -> tuple[str, str]:
        """What two links may not share: a port that is listened on, whatever the address; or an address."""
        return self.scheme, f"{'' if self.listens else self.host}:{self.port}"


@dataclass(frozen=True, slots=True)
class SerialLink:
    """A serial port."""

    device: str
    baud: int

    @property
    def place(self) -> tuple[str, str]:
        """What two links may not share: the device, whatever its rate."""
        return "serial", "/" + self.device.lstrip("/")


def parse_link(url: str) -> NetworkLink | SerialLink:
    """The link that a URL names.

    Raises:
        ValueError: it names none; the message says which forms there are.
    """
    if match := _SERIAL.fullmatch(url):
        device, baud = match.groups()
        return SerialLink(device, int(baud or DEFAULT_BAUD))
    if match := _NETWORK.fullmatch(url):
        link = NetworkLink(match[1], match[2], int(match[3]))
        if 0 < link.port < 65536 and (link.host or link.listens):
            return link
    raise ValueError(f"{url} is no link: {LINK_FORMS}")
