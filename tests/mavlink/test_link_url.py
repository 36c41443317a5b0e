"""What a URL of a MAVLink link says, and which are none."""

from __future__ import annotations

import pytest

from companion.mavlink.link_url import NetworkLink, SerialLink, parse_link


@pytest.mark.parametrize(
    ("url", "link"),
    [
        ("udpin://127.0.0.1:14540", NetworkLink("udpin", "127.0.0.1", 14540)),
        ("udpin://:1", NetworkLink("udpin", "", 1)),
        ("tcpout://autopilot.local:65535", NetworkLink("tcpout", "autopilot.local", 65535)),
        ("serial:///dev/ttyACM0:921600", SerialLink("/dev/ttyACM0", 921600)),
        ("serial:///dev/ttyACM0", SerialLink("/dev/ttyACM0", 57600)),
    ],
)
def test_links(url: str, link: NetworkLink | SerialLink) -> None:
    assert parse_link(url) == link


@pytest.mark.parametrize(
    "url",
    [
        "",
        "udpin",
        "http://127.0.0.1:80",
        "udpin://127.0.0.1",
        "udpin://127.0.0.1:0",
        "udpin://127.0.0.1:99999",
        "udpin://127.0.0.1:x",
        "udpin://127.0.0.1:٣",
        "udpin://[::1]:14540",
        "udpout://:14550",
        "tcpout://:1",
        "serial://",
        "serial:///dev/ttyACM0:fast",
        "serial:///dev/ttyACM0:9600\n",
    ],
)
def test_what_is_no_link_is_refused_in_words(url: str) -> None:
    with pytest.raises(ValueError, match="is no link: udpin://"):
        parse_link(url)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("udpin://127.0.0.1:1", "udpin://:1", True),
        ("udpin://:1", "tcpin://:1", False),
        ("udpout://a:1", "udpout://a:1", True),
        ("udpout://a:1", "udpout://b:1", False),
        ("serial:///dev/ttyUSB0:57600", "serial:///dev/ttyUSB0:115200", True),
    ],
)
def test_places(one: str, other: str, same: bool) -> None:
    assert (parse_link(one).place == parse_link(other).place) is same
