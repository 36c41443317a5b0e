"""A link over MAVSDK to a small autopilot on loopback, for as long as a test works with it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import pytest

from companion.autopilot.link import MavsdkLink
from companion.clock import MonotonicClock
from companion.config.autopilot import AutopilotSettings
from tests.autopilot.udp_transport import UdpTransport

ARM, LAND = 400, 21
"""Two commands: what they do plays no part here."""


def link_on(port: int, timeout_s: float = 10.0, system_id: int = 1) -> MavsdkLink:
    """A link that listens there, once its block is entered."""
    settings = AutopilotSettings(
        url=f"udpin://127.0.0.1:{port}", connect_timeout_s=timeout_s, system_id=system_id, command_timeout_s=2.0
    )
    return MavsdkLink(settings, MonotonicClock(), UdpTransport(port))


def flown(port: int, work: Callable[[MavsdkLink], Awaitable[None]], system_id: int = 1) -> None:
    """Do the work on a link that is connected."""

    async def connected() -> None:
        async with link_on(port, system_id=system_id) as link:
            await work(link)

    asyncio.run(connected())


async def until(ready: Callable[[], bool], timeout_s: float = 5.0) -> None:
    """Wait until it is so; the test fails when it does not come."""
    for _ in range(round(timeout_s / 0.01)):
        if ready():
            return
        await asyncio.sleep(0.01)
    pytest.fail("it did not come in time")
