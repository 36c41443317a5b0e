"""Where a sensor stream is offered: `tcp://host:port` or `unix:///path`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from companion.errors import InputError

LONGEST_UNIX_PATH_BYTES = 107
"""What Linux has room for in the address of a Unix socket."""


@dataclass(frozen=True, slots=True)
class TcpAddress:
    """A host's name or number and its port."""

    host: str
    port: int


@dataclass(frozen=True, slots=True)
class UnixAddress:
    """A socket in the file system."""

    path: Path


def parse_address(url: str) -> TcpAddress | UnixAddress:
    """The address that ``url`` names.

    Raises:
        InputError: it is none.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise InputError(f"{url!r} cannot be used as the address of a sensor stream: {error}") from error
    extra = parts.query or parts.fragment or parts.username is not None
    if parts.scheme == "tcp" and parts.hostname and port is not None and parts.path in ("", "/") and not extra:
        return TcpAddress(parts.hostname, port)
    if parts.scheme == "unix" and not parts.netloc and len(parts.path) > 1 and not extra:
        if len(parts.path.encode()) > LONGEST_UNIX_PATH_BYTES:
            raise InputError(f"{url!r}: the path of a Unix socket has at most {LONGEST_UNIX_PATH_BYTES} bytes")
        return UnixAddress(Path(parts.path))
    raise InputError(
        f"{url!r} is not the address of a sensor stream: use tcp://HOST:PORT (tcp://127.0.0.1:14600) or unix:///PATH"
    )
