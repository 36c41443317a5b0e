"""Drivers found by name, and what every driver must keep to."""

from __future__ import annotations

import asyncio
import contextlib
from importlib.metadata import EntryPoint, EntryPoints

import pytest

from companion.autopilot.interface import Link
from companion.config.sensors import TcpAddress, UnixAddress, parse_address
from companion.config.settings import Settings
from companion.errors import InputError
from companion.sensors.drivers import driver
from companion.sensors.drivers.driver import DriverContext, SensorDriver, load_drivers
from companion.sensors.sink import SensorSink
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock

ENTRIES = (
    EntryPoint("stream", "companion.sensors.drivers.stream:create", driver.GROUP),
    EntryPoint("mavlink", "companion.sensors.drivers.mavlink:create", driver.GROUP),
    EntryPoint("broken", "companion.sensors.drivers.no_such_module:create", driver.GROUP),
    EntryPoint("empty", "companion.sensors.drivers.stream:no_such_name", driver.GROUP),
    EntryPoint("double", "companion.sensors.drivers.stream:create", driver.GROUP),
    EntryPoint("double", "companion.sensors.drivers.mavlink:create", driver.GROUP),
)


@pytest.fixture(autouse=True)
def _offered(monkeypatch: pytest.MonkeyPatch) -> None:
    def offered(group: str) -> EntryPoints:
        assert group == "companion.sensors"
        return EntryPoints(ENTRIES)

    monkeypatch.setattr(driver, "entry_points", offered)


def context(link: Link | None = None) -> DriverContext:
    return DriverContext(HandClock(100.0), link)


def named(*names: str) -> Settings:
    return Settings.model_validate({"sensors": {"drivers": names}})


@pytest.mark.parametrize("name", ["stream", "mavlink"])
async def test_every_driver_stops_when_it_is_cancelled(name: str) -> None:
    """The contract: found by its name, runs until cancelled, is gone then, and can be run again."""
    (loaded,) = load_drivers(named(name), context(FakeLink(HandClock(100.0))))
    assert isinstance(loaded, SensorDriver)
    assert loaded.name == name
    for _ in range(2):
        task = asyncio.create_task(loaded.run(SensorSink(HandClock(100.0))))
        await asyncio.sleep(0.05)
        assert not task.done(), "a device that is not there is waited for"
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            async with asyncio.timeout(2.0):
                await task
        assert task.cancelled()


def test_drivers_come_in_the_order_of_the_settings() -> None:
    """Several at once: depth from a process, ranges from the autopilot."""
    loaded = load_drivers(named("mavlink", "stream"), context(FakeLink(HandClock(100.0))))
    assert [found.name for found in loaded] == ["mavlink", "stream"]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("lidar",), "no sensor driver 'lidar'. Known: broken, double, empty, mavlink, stream"),
        (("stream", "stream"), "names stream twice"),
        (("double",), "offered more than once"),
        (("broken",), r"broken \(.*\) cannot be loaded"),
        (("empty",), r"empty \(.*\) cannot be loaded"),
        (("mavlink",), "mavlink needs the link to an autopilot"),
    ],
)
def test_a_driver_that_cannot_be_had_is_explained(names: tuple[str, ...], said: str) -> None:
    """The person who mistyped a name reads the names that there are."""
    with pytest.raises(InputError, match=said):
        load_drivers(named(*names), context())


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("tcp://127.0.0.1:14600", TcpAddress("127.0.0.1", 14600)),
        ("tcp://[::1]:14600", TcpAddress("::1", 14600)),
        ("tcp://camera.local:1/", TcpAddress("camera.local", 1)),
    ],
)
def test_tcp_addresses(url: str, address: TcpAddress) -> None:
    """Names and numbers of both families."""
    assert parse_address(url) == address


def test_unix_addresses() -> None:
    """An absolute path after two slashes."""
    address = parse_address("unix:///run/sensors")
    assert isinstance(address, UnixAddress)
    assert str(address.path) == "/run/sensors"


@pytest.mark.parametrize(
    "url",
    [
        "",
        "127.0.0.1:14600",
        "tcp://127.0.0.1",
        "tcp://:14600",
        "tcp://h:99999",
        "tcp://h:x",
        "tcp://h:1/path",
        "tcp://h:1?x=1",
        "tcp://me@h:1",
        "tcp://[::1:5",
        "udp://h:1",
        "unix://",
        "unix://relative/path",
        "unix:///" + "x" * 107,
    ],
)
def test_wrong_addresses_are_refused(url: str) -> None:
    """A setting that can never work ends the command at once."""
    with pytest.raises(InputError):
        parse_address(url)
