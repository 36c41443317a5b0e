"""The settings of the link."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from companion.config.link import LinkSettings, is_loopback, is_name
from companion.config.settings import Settings


@pytest.mark.parametrize(
    ("endpoint", "loopback"),
    [
        ("tcp/127.0.0.1:7447", True),
        ("tcp/127.8.8.8:1", True),
        ("tcp/[::1]:7447", True),
        ("tcp/localhost:7447", True),
        ("tcp/0.0.0.0:7447", False),
        ("tcp/[::]:7447", False),
        ("tcp/10.0.0.1:7447", False),
        ("tcp/localhost.example.org:7447", False),
    ],
)
def test_what_others_can_reach_needs_certificates(endpoint: str, loopback: bool) -> None:
    """Protects from a vehicle that anybody in the network may command."""
    assert is_loopback(endpoint) is loopback
    if loopback:
        LinkSettings(listen=(endpoint,))
    else:
        with pytest.raises(ValidationError, match="could command the vehicle"):
            LinkSettings(listen=(endpoint,))
        with pytest.raises(ValidationError, match="could command the vehicle"):
            LinkSettings(connect=(endpoint,), certificates="somewhere")


@pytest.mark.parametrize(
    "wrong",
    [
        {"listen": ["tls/0.0.0.0:7447"]},
        {"listen": ["tcp/127.0.0.1"]},
        {"listen": ["tcp/127.0.0.1:0"]},
        {"listen": ["tcp/127.0.0.1:70000"]},
        {"listen": ["udp/127.0.0.1:7447"]},
        {"listen": ["serial//dev/ttyUSB0"]},
        {"connect": ["tcp/127.0.0.1:7447#iface=eth0"]},
        {"name": "../../etc"},
        {"name": ""},
        {"name": "a b"},
        {"enabled": True, "listen": []},
    ],
)
def test_what_cannot_work_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        LinkSettings.model_validate(wrong)


def test_tls_with_certificates_may_be_reached_from_everywhere() -> None:
    LinkSettings(enabled=True, listen=("tls/0.0.0.0:7447", "quic/[::]:7448"), certificates="/etc/companion/link")


def test_a_link_that_is_not_there_cannot_be_lost() -> None:
    with pytest.raises(ValidationError, match="there is no link that could be lost"):
        Settings.model_validate({"mission": {"link_lost": "home"}})
    Settings.model_validate({"mission": {"link_lost": "home"}, "link": {"enabled": True}})


@pytest.mark.parametrize("text", ["a", "Drone-1", "x_9", "9"])
def test_names_are_parts_of_topics_and_folders(text: str) -> None:
    assert is_name(text)
    for wrong in (f"{text}/", f"*{text}", f".{text}", f"-{text}", f"{text} ", f"{text}\n", text + 32 * "x", "ä"):
        assert not is_name(wrong), wrong
