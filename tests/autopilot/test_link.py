"""Who is at the other end of the link over MAVSDK, how it opens, and what is left when it has closed."""

from __future__ import annotations

import asyncio
import time
from contextlib import nullcontext
from pathlib import Path

import pytest

from companion.autopilot.interface import LinkError
from companion.autopilot.link import MavsdkLink
from companion.mavlink.firmware import AutopilotKind
from tests.autopilot.linked import flown, link_on
from tests.autopilot.responder import Responder, free_port


def threads() -> int:
    return len(list(Path("/proc/self/task").iterdir()))


def ended_down_to(count: int) -> bool:
    """A thread that has been joined stays in the kernel's list for a moment."""
    deadline_s = time.monotonic() + 1.0
    while time.monotonic() < deadline_s and threads() > count:
        time.sleep(0.01)
    return threads() <= count


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_it_finds_out_which_autopilot_it_is(firmware: str) -> None:
    """Protects the choice between the two mode tables."""
    port = free_port()

    async def work(link: MavsdkLink) -> None:
        assert link.kind is AutopilotKind(firmware)
        assert link.system_id == 1

    with Responder(port, firmware):
        flown(port, work)


@pytest.mark.parametrize(
    ("firmware", "system_id", "said"),
    [
        (None, 1, "nothing at all was heard"),
        ("px4", 9, "only autopilots of other systems: 9. Set autopilot.system_id"),
        ("none", 255, "no autopilot .system/component 255/1"),
    ],
)
def test_when_our_autopilot_is_not_there_the_error_says_what_was(
    firmware: str | None, system_id: int, said: str
) -> None:
    """Protects the person with a wrong cable, a wrong id or a wrong port."""
    port = free_port()
    before = threads()

    async def connect() -> None:
        async with link_on(port, timeout_s=0.8):
            pytest.fail("connected to nobody")

    somebody = nullcontext() if firmware is None else Responder(port, firmware, system_id)
    with somebody, pytest.raises(LinkError, match=said) as caught:
        asyncio.run(connect())
    assert str(port) in str(caught.value)
    assert ended_down_to(before)


def test_leaving_ends_every_thread_and_nothing_works_afterwards() -> None:
    """Protects the next flight of the same process, and its end."""
    port = free_port()
    before = threads()

    async def fly() -> None:
        async with link_on(port) as link:
            link.watch("ATTITUDE")
            assert threads() > before + 1
            asking = asyncio.create_task(link.get_param("NOT_THERE"))
            await asyncio.sleep(0.1)
            asking.cancel()
        with pytest.raises(LinkError, match="closed"):
            link.send("HEARTBEAT", {})
        with pytest.raises(LinkError, match="closed"):
            link.watch("SYS_STATUS")
        with pytest.raises(LinkError, match="closed"):
            await link.get_param("COUNT")

    with Responder(port):
        asyncio.run(fly())
    assert ended_down_to(before)
