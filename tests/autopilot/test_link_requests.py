"""Commands and parameters over the link: asked again, believed when they are confirmed, refused with the reason."""

from __future__ import annotations

import asyncio
import math
import time

import pytest

from companion.autopilot.interface import LinkError
from companion.autopilot.link import MavsdkLink
from tests.autopilot.linked import ARM, LAND, flown
from tests.autopilot.responder import FLOAT, INT32, Responder, free_port


def test_commands_give_the_last_result_and_are_sent_again_when_nobody_answers() -> None:
    """Protects take-off and mode changes on a link that loses packets."""
    port = free_port()

    async def work(link: MavsdkLink) -> None:
        assert await link.command(ARM, 1.0) == 4
        begun_s = time.monotonic()
        assert await link.command(LAND) == 0
        assert 0.9 < time.monotonic() - begun_s < 1.5, "asked at 0, 0.5 and 1 s, answered the third time"
        asked = [message.confirmation for message in autopilot.named("COMMAND_LONG") if message.command == LAND]
        assert asked == [0, 1, 2]
        with pytest.raises(LinkError, match=r"command 99 within 0\.7 s \(asked 2 times\)"):
            await link.command(99, timeout_s=0.7)
        with pytest.raises(LinkError, match="in progress"):
            await link.command(98, timeout_s=0.6)
        assert len([message for message in autopilot.named("COMMAND_LONG") if message.command == 98]) == 1

    with Responder(port) as autopilot:
        autopilot.answers = {ARM: [[5, 4]], LAND: [[], [], [0]], 99: [], 98: [[5]]}
        flown(port, work)


def test_a_slow_command_does_not_hold_up_another() -> None:
    """Protects "hold" while a take-off is still unanswered."""
    port = free_port()

    async def work(link: MavsdkLink) -> None:
        slow = asyncio.create_task(link.command(ARM, 1.0))
        await asyncio.sleep(0.05)
        assert await link.command(LAND, timeout_s=0.4) == 0
        assert not slow.done()
        with pytest.raises(LinkError):
            await slow

    with Responder(port) as autopilot:
        autopilot.answers = {ARM: []}
        flown(port, work)


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_parameters_in_both_encodings(firmware: str) -> None:
    """Protects the pre-flight check: the bytes of -1 are NaN as a float, and a wrong encoding sets nonsense."""
    port = free_port()

    async def work(link: MavsdkLink) -> None:
        assert await link.get_param("COM_OBL_RC_ACT") == -1
        assert await link.get_param("COM_OF_LOSS_T") == 1.0
        assert isinstance(await link.get_param("COM_OBL_RC_ACT"), int)
        await link.set_param("COM_OBL_RC_ACT", 5)
        await link.set_param("COM_OF_LOSS_T", 0.5)
        await link.set_param("COM_OF_LOSS_T", 1)
        await link.set_param("COM_OF_LOSS_T", 0.3)
        await link.set_param("COM_OBL_RC_ACT", -2)
        assert await link.get_param("COM_OBL_RC_ACT") == -2
        assert autopilot.value("COM_OBL_RC_ACT") == -2
        assert autopilot.value("COM_OF_LOSS_T") == pytest.approx(0.3)
        assert {message.param_type for message in autopilot.named("PARAM_SET")} == {FLOAT, INT32}

    with Responder(port, firmware) as autopilot:
        autopilot.params = {"COM_OBL_RC_ACT": (-1, INT32), "COM_OF_LOSS_T": (1.0, FLOAT)}
        flown(port, work)


def test_parameters_that_cannot_be_set_are_refused_with_the_reason() -> None:
    """Protects against believing that a failsafe was set when it was not."""
    port = free_port()

    async def work(link: MavsdkLink) -> None:
        assert await link.get_param("NOT_THERE") is None
        assert await link.get_param("A_NAME_THAT_IS_TOO_LONG") is None
        for name, value, reason in (
            ("NOT_THERE", 1, "has no parameter"),
            ("COUNT", 1.5, "integer"),
            ("COUNT", 2**40, "integer"),
            ("COUNT", math.nan, "finite"),
            ("STUBBORN", 2.0, "STUBBORN"),
        ):
            with pytest.raises(LinkError, match=reason):
                await link.set_param(name, value)
        assert autopilot.value("COUNT") == 3
        assert not [each for each in autopilot.named("PARAM_SET") if each.param_id == "COUNT"], "nothing wrong is sent"
        autopilot.heartbeats = False
        autopilot.params.clear()
        await asyncio.sleep(0.1)
        with pytest.raises(LinkError, match="did not answer"):
            await link.get_param("COUNT")

    with Responder(port) as autopilot:
        autopilot.params = {"COUNT": (3, INT32), "STUBBORN": (1.0, FLOAT)}
        autopilot.frozen = {"STUBBORN"}
        flown(port, work)
