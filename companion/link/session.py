"""A Zenoh session, peer to peer, as vehicles and ground open it."""

from __future__ import annotations

import json
from collections.abc import Sequence

import zenoh

from companion.errors import CompanionError
from companion.link.certificates import AUTHORITY_CERTIFICATE, OWN_CERTIFICATE, OWN_KEY, Certificates, common_name

SEND_BUFFER_BYTES = 65_536
"""Of the system, for each connection: what waits there can be overtaken by nothing, not even the answer to a stop."""

MOST_MESSAGE_BYTES = 4_000_000
"""Larger ones are not taken from anybody."""

LEASE_MS = 6_000
"""A connection on which nothing came for this long is made anew."""


class LinkError(CompanionError):
    """The link cannot be opened."""


def open_session(
    listen: Sequence[str], connect: Sequence[str], certificates: Certificates | None = None
) -> zenoh.Session:
    """Open a session. Whoever is to be connected to is tried again for ever.

    Args:
        listen: endpoints that are waited at.
        connect: endpoints of others.
        certificates: with which both sides of tls/ and quic/ prove who they are; who is revoked is spoken to by nobody.

    Raises:
        LinkError: an endpoint cannot be listened at.
    """
    config = zenoh.Config()
    settings = _settings(listen, connect)
    if certificates is not None:
        settings |= _proven(certificates)
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise LinkError(
            f"the link cannot listen at {', '.join(listen)}: {str(error).splitlines()[0]}; is another program there, "
            "or another vehicle of this computer? give another port"
        ) from None


def _proven(certificates: Certificates) -> dict[str, object]:
    folder = certificates.folder.absolute()
    authority, own, key = (str(folder / name) for name in (AUTHORITY_CERTIFICATE, OWN_CERTIFICATE, OWN_KEY))
    revoked = certificates.revoked()
    names = [common_name(name, serial) for serial, name in revoked.items()]
    everything = ["put", "delete", "declare_subscriber", "query", "reply", "declare_queryable"]
    denied = {
        "access_control/enabled": True,
        "access_control/default_permission": "allow",
        "access_control/rules": [
            {
                "id": "nothing",
                "messages": everything,
                "flows": ["ingress", "egress"],
                "permission": "deny",
                "key_exprs": ["**"],
            }
        ],
        "access_control/subjects": [{"id": "revoked", "cert_common_names": names}],
        "access_control/policies": [{"rules": ["nothing"], "subjects": ["revoked"]}],
    }
    return {
        "transport/link/tls/root_ca_certificate": authority,
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/listen_certificate": own,
        "transport/link/tls/listen_private_key": key,
        "transport/link/tls/connect_certificate": own,
        "transport/link/tls/connect_private_key": key,
        # The authority signs for this fleet alone; addresses of radios change, names do not stand in them.
        "transport/link/tls/verify_name_on_connect": False,
        **(denied if names else {}),
    }


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
