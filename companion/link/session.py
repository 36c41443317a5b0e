"""A Zenoh session, peer to peer, as vehicles and ground open it."""

from __future__ import annotations

import json
from collections.abc import Sequence

import zenoh

from companion.errors import CompanionError

SEND_BUFFER_BYTES = 65_536
"""Of the system, for each connection: what waits there can be overtaken by nothing, not even the answer to a stop."""

MOST_MESSAGE_BYTES = 4_000_000
"""Larger ones are not taken from anybody."""

LEASE_MS = 6_000
"""A connection on which nothing came for this long is made anew."""


class LinkError(CompanionError):
    """The link cannot be opened."""


def open_session(listen: Sequence[str], connect: Sequence[str]) -> zenoh.Session:
    """Open a session. Whoever is to be connected to is tried again for ever.

    Args:
        listen: endpoints that are waited at.
        connect: endpoints of others.

    Raises:
        LinkError: an endpoint cannot be listened at.
    """
    config = zenoh.Config()
    for key, value in _settings(listen, connect).items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise LinkError(
            f"the link cannot listen at {', '.join(listen)}: {str(error).splitlines()[0]}; is another program there, "
            "or another vehicle of this computer? give another port"
        ) from None


def close_session(session: zenoh.Session) -> None:
    """Close it: a session that is only forgotten keeps its process from ending."""
    session.close()  # type: ignore[no-untyped-call]


def _settings(listen: Sequence[str], connect: Sequence[str]) -> dict[str, object]:
    return {
        "mode": "peer",
        "listen/endpoints": list(listen),
        "listen/exit_on_failure": True,
        "connect/endpoints": list(connect),
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 500, "period_max_ms": 4_000, "period_increase_factor": 2},
        # Nobody is found by shouting: who is spoken to stands in the settings.
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/rx/max_message_size": MOST_MESSAGE_BYTES,
        "transport/link/tcp/so_sndbuf": SEND_BUFFER_BYTES,
        "transport/link/tls/so_sndbuf": SEND_BUFFER_BYTES,
    }
