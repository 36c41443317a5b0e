"""The link over MAVSDK: who is at its other end, what comes and goes, what is asked, and what is left of it."""

from __future__ import annotations

import asyncio
import math
import random
import re
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import pytest

from companion.autopilot import px4_events
from companion.autopilot.commands import LAST_WORD_S
from companion.autopilot.discovery import Neighbours
from companion.autopilot.inbox import PENDING, Inbox
from companion.autopilot.interface import LinkError, Message
from companion.config.autopilot import AutopilotSettings
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd, MavState
from sitl.launch.processes import free_udp_ports
from tests.autopilot.loopback import ARM, FLOAT, INT32, LAND, Responder, link_on, linked
from tests.shared.beside import until


def threads() -> int:
    return len(list(Path("/proc/self/task").iterdir()))


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
async def test_it_finds_out_which_autopilot_it_is(firmware: str) -> None:
    """Protects the choice between the two mode tables."""
    async with linked(firmware) as (link, _):
        assert link.kind is AutopilotKind(firmware)
        assert link.system_id == 1


@pytest.mark.parametrize(
    ("firmware", "system_id", "said"),
    [
        (None, 1, "nothing at all was heard"),
        ("px4", 9, "only autopilots of other systems: 9. Set autopilot.system_id"),
        ("none", 255, "no autopilot .system/component 255/1"),
    ],
)
async def test_when_our_autopilot_is_not_there_the_error_says_what_was(
    firmware: str | None, system_id: int, said: str
) -> None:
    """Protects the person with a wrong cable, a wrong id or a wrong port."""
    (port,) = free_udp_ports(1)
    before = threads()
    somebody = nullcontext() if firmware is None else Responder(port, firmware, system_id)
    with somebody, pytest.raises(LinkError, match=said) as caught:
        async with link_on(port, timeout_s=0.8):
            pytest.fail("connected to nobody")
    assert str(port) in str(caught.value)
    await until(lambda: threads() <= before, "every thread has ended", 1.0)


@pytest.mark.parametrize(
    ("device", "said"),
    [
        ("/dev/ttyGONE9", "there is no /dev/ttyGONE9"),
        ("/dev/null", "nothing at all was heard on /dev/null.*57600 baud"),
    ],
)
def test_a_serial_port_is_named_where_nothing_came(device: str, said: str) -> None:
    """Protects the person with a cable: what concerns a network would mislead."""
    assert re.search(said, Neighbours(AutopilotSettings(url=f"serial://{device}")).instead_of_ours())


async def test_leaving_ends_every_thread_and_nothing_works_afterwards() -> None:
    """Protects the next flight of the same process, and its end."""
    before = threads()
    async with linked() as (link, _):
        link.watch("ATTITUDE")
        assert threads() > before + 2
        asking = asyncio.create_task(link.get_param("NOT_THERE"))
        await asyncio.sleep(0.1)
        asking.cancel()
    with pytest.raises(LinkError, match="closed"):
        link.send("HEARTBEAT", {})
    with pytest.raises(LinkError, match="closed"):
        link.watch("SYS_STATUS")
    with pytest.raises(LinkError, match="closed"):
        await link.get_param("COUNT")
    # A thread that has been joined stays in the kernel's list for a moment.
    await until(lambda: threads() <= before, "every thread has ended", 1.0)


# --- messages ---------------------------------------------------------------------------------------------------------


async def test_of_several_vehicles_on_one_port_only_ours_is_heard() -> None:
    """Protects against flying by the attitude of another vehicle, or of another component of ours."""
    (port,) = free_udp_ports(1)
    with Responder(port, "px4"), Responder(port, "none", 7, 50), Responder(port, "ardupilot", 7) as ours:
        ours.yaw_rad = 2.0
        async with link_on(port, system_id=7) as link:
            assert link.kind is AutopilotKind.ARDUPILOT
            stream = link.watch("ATTITUDE")
            senders: set[tuple[int, int]] = set()
            taken: set[int] = set()
            link.events("ATTITUDE", lambda message: senders.add((message.system_id, message.component_id)), anyone=True)
            link.events("ATTITUDE", lambda message: taken.add(message.system_id))
            await until(lambda: senders == {(1, 1), (7, 1), (7, 50)} and stream.count > 20)
            assert taken == {7}
            assert stream.newest is not None
            assert stream.newest.fields["yaw"] == pytest.approx(2.0)


async def test_numbers_that_are_none_survive_in_both_directions() -> None:
    """Protects NaN, which MAVLink uses for "not set": as zero it would be a latitude and a heading."""
    async with linked() as (link, autopilot):
        stream = link.watch("ATTITUDE")
        await until(lambda: stream.newest is not None)
        assert stream.newest is not None
        assert math.isnan(stream.newest.fields["pitch"])
        assert stream.newest.fields["roll"] == pytest.approx(0.1)
        assert await link.command(LAND, 1.0, math.nan) == 0
        (command,) = [message for message in autopilot.named("COMMAND_LONG") if message.command == LAND]
        assert command.param1 == 1.0
        assert math.isnan(command.param2)
        assert command.param3 == 0.0


async def test_what_is_sent_arrives_as_from_the_onboard_computer() -> None:
    """Protects our address, and the refusal of what cannot be put on the wire as asked."""
    async with linked() as (link, autopilot):
        link.send("NAMED_VALUE_FLOAT", {"time_boot_ms": 5, "name": "d", "value": 1.25})
        await until(lambda: bool(autopilot.named("NAMED_VALUE_FLOAT")))
        (message,) = autopilot.named("NAMED_VALUE_FLOAT")
        assert (message.get_srcSystem(), message.get_srcComponent()) == (1, 191)
        assert (message.name, message.value) == ("d", 1.25)
        for name, fields in (("NO_SUCH_MESSAGE", {}), ("ATTITUDE", {"yaw": math.inf}), ("ATTITUDE", {"yaw": object()})):
            with pytest.raises(LinkError, match=name):
                link.send(name, fields)


async def test_of_the_heartbeats_of_this_component_only_the_true_one_leaves() -> None:
    """Protects who reads the state of component 191: MAVSDK's own UNINIT beside ours flickered twice a second.

    MAVSDK sends it once a second as soon as it has seen the autopilot, which it has when the link is there.
    """
    async with linked() as (link, autopilot):
        begun_s = time.monotonic()
        while time.monotonic() - begun_s < 2.5:
            ours = {"type": 18, "autopilot": 8, "base_mode": 0, "custom_mode": 0, "system_status": MavState.STANDBY}
            link.send("HEARTBEAT", ours | {"mavlink_version": 3})
            await asyncio.sleep(0.25)
        heard = [(beat.get_srcComponent(), beat.system_status) for beat in autopilot.named("HEARTBEAT")]
        assert len(heard) > 5
        assert set(heard) == {(191, MavState.STANDBY)}


@pytest.mark.parametrize(("firmware", "told"), [("px4", True), ("ardupilot", False)])
async def test_what_px4_says_in_events_is_told_as_its_texts(
    firmware: str, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects "the autopilot said" on PX4; ArduPilot says everything in STATUSTEXTs and is not listened to so.

    This one has no metadata for MAVSDK, so the event comes by its number, the sooner for the test.
    """
    monkeypatch.setattr(px4_events, "METADATA_S", 0.0)
    async with linked(firmware) as (link, autopilot):
        texts: list[str] = []
        link.events("STATUSTEXT", lambda message: texts.append(message.fields["text"]))
        autopilot.event(0x01234ABC, log_levels=0x22)
        autopilot._out.statustext_send(3, b"the last word")
        await until(lambda: "the last word" in texts)
        assert texts == ["event 0x01234abc, whose text the autopilot does not tell"] * told + ["the last word"]
        assert link.arming_problems == ()


async def test_a_dead_link_shows_in_the_age_of_the_heartbeats_only() -> None:
    """Protects the tick: sending to nobody must neither raise nor block."""
    async with linked() as (link, autopilot):
        heartbeats = link.watch("HEARTBEAT")
        await until(lambda: heartbeats.count > 0)
        autopilot.__exit__(None, None, None)
        await asyncio.sleep(0.5)
        begun_s = time.monotonic()
        for _ in range(20):
            link.send("NAMED_VALUE_FLOAT", {"time_boot_ms": 5, "name": "d", "value": 1.25})
        assert time.monotonic() - begun_s < 0.5
        assert heartbeats.age_s(time.monotonic()) > 0.4


async def test_garbage_on_the_port_changes_nothing() -> None:
    """Protects the receiving thread from noise, truncated, corrupted and empty packets."""
    noise = random.Random(3)  # noqa: S311 - no secret
    async with linked() as (link, autopilot):
        stream = link.watch("ATTITUDE")
        texts: list[str] = []
        link.events("STATUSTEXT", lambda message: texts.append(message.fields["text"]))
        packed = autopilot._out.attitude_encode(99, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0).pack(autopilot._out)
        for _ in range(300):
            autopilot.raw(noise.randbytes(noise.choice([0, 1, 12, 280, 1400])))
            damaged = bytearray(packed)
            damaged[noise.randrange(6, len(packed))] ^= 1 << noise.randrange(8)
            autopilot.raw(bytes(damaged))
            autopilot.raw(packed[: noise.randrange(len(packed))])
        count = stream.count

        def again() -> bool:
            # What ends like the beginning of a message swallows the next: so more than one is sent.
            autopilot._out.statustext_send(3, b"\xff\xfe not text \x00\x01")
            return stream.count > count + 10 and bool(texts)

        await until(again)
        assert stream.newest is not None
        assert stream.newest.fields["roll"] == pytest.approx(0.1)
        assert "not text" in texts[0]


async def test_messages_keep_the_time_of_their_arrival_through_a_hang_of_the_loop() -> None:
    """Protects freshness: after a hang of our own loop, what came before it must look old."""
    async with linked() as (link, _):
        stream = link.watch("ATTITUDE")
        arrivals: list[float] = []
        link.events("ATTITUDE", lambda message: arrivals.append(message.received_s))
        await until(lambda: stream.count > 5)
        begun_s = time.monotonic()
        time.sleep(0.5)  # noqa: ASYNC251 - the hang
        assert stream.age_s(time.monotonic()) < 0.2, "the newest came in while the loop hung"
        await asyncio.sleep(0.05)
        during = [arrival_s for arrival_s in arrivals if begun_s + 0.05 < arrival_s < begun_s + 0.45]
        assert len(during) >= 5, "each was stamped when it came, not when the loop went on"


# --- commands and parameters ------------------------------------------------------------------------------------------


async def test_commands_give_the_last_result_and_are_sent_again_when_nobody_answers() -> None:
    """Protects take-off and mode changes on a link that loses packets."""
    async with linked() as (link, autopilot):
        autopilot.answers = {ARM: [[5, 4]], LAND: [[], [], [0]], 99: [], 98: [[5]]}
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


async def test_of_two_answers_to_a_change_of_mode_the_last_counts() -> None:
    """Protects from believing PX4's receiver: it accepts a mode at once, which its commander refuses 4 to 12 ms later.

    Nothing else is answered twice, and nothing else waits for a second word.
    """
    async with linked() as (link, autopilot):
        mode = MavCmd.DO_SET_MODE
        autopilot.answers = {mode: [[0, 4], [0, 0], [0], [4]], ARM: [[0, 4]]}
        assert await link.command(mode) == 4
        assert await link.command(mode) == 0
        begun_s = time.monotonic()
        assert await link.command(mode) == 0
        assert time.monotonic() - begun_s >= LAST_WORD_S
        assert await link.command(mode) == 4
        assert await link.command(ARM, 1.0) == 0


async def test_a_slow_command_does_not_hold_up_another() -> None:
    """Protects "hold" while a take-off is still unanswered."""
    async with linked() as (link, autopilot):
        autopilot.answers = {ARM: []}
        slow = asyncio.create_task(link.command(ARM, 1.0))
        await asyncio.sleep(0.05)
        assert await link.command(LAND, timeout_s=0.4) == 0
        assert not slow.done()
        with pytest.raises(LinkError):
            await slow


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
async def test_parameters_in_both_encodings(firmware: str) -> None:
    """Protects the pre-flight check: the bytes of -1 are NaN as a float, and a wrong encoding sets nonsense."""
    async with linked(firmware) as (link, autopilot):
        autopilot.params = {"COM_OBL_RC_ACT": (-1, INT32), "COM_OF_LOSS_T": (1.0, FLOAT)}
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


async def test_parameters_that_cannot_be_set_are_refused_with_the_reason() -> None:
    """Protects against believing that a failsafe was set when it was not."""
    async with linked() as (link, autopilot):
        autopilot.params = {"COUNT": (3, INT32), "STUBBORN": (1.0, FLOAT)}
        autopilot.frozen = {"STUBBORN"}
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


# The link's inbox by itself: whose messages it takes, how many it keeps, and who gets them.


def message(name: str = "STATUSTEXT", system_id: int = 1, component_id: int = 1) -> Message:
    return Message(name, {}, 5.0, system_id, component_id)


def test_a_loop_that_does_not_run_costs_old_messages_not_memory() -> None:
    """Protects the bound of the queue: what is dropped is counted, and the newest stay."""
    calls: list[Callable[[], None]] = []
    heard: list[Message] = []
    inbox = Inbox(1, calls.append)
    inbox.events("STATUSTEXT", heard.append)
    messages = [Message("STATUSTEXT", {"n": n}, float(n), 1, 1) for n in range(PENDING + 44)]
    for each in messages:
        inbox.put(each)
    assert len(calls) == 1, "one wake-up of the loop for all of them"
    assert inbox.dropped == 44
    calls.pop()()
    assert heard == messages[44:]


def test_a_handler_that_fails_does_not_deafen_the_others(caplog: pytest.LogCaptureFixture) -> None:
    """Protects the pilot's takeover from a malformed STATUSTEXT."""
    heard: list[Message] = []
    inbox = Inbox(1, lambda call: call())

    def broken(_: Message) -> None:
        raise KeyError("text")

    inbox.events("STATUSTEXT", broken)
    inbox.events("STATUSTEXT", heard.append)
    inbox.put(message())
    inbox.put(message())
    assert len(heard) == 2
    assert "STATUSTEXT" in caplog.text


def test_nobody_elses_messages_reach_a_stream() -> None:
    """Protects the state of our vehicle from a gimbal's heartbeat and another vehicle's."""
    inbox = Inbox(1, lambda call: call())
    stream = inbox.watch("HEARTBEAT")
    assert stream is inbox.watch("HEARTBEAT")
    for system_id, component_id in ((2, 1), (1, 154), (1, 191), (255, 190), (0, 0)):
        inbox.put(message("HEARTBEAT", system_id, component_id))
        assert not inbox.wants("HEARTBEAT", system_id, component_id)
    assert stream.count == 0
    assert stream.age_s(7.0) == math.inf
    inbox.put(message("HEARTBEAT"))
    assert (stream.count, stream.age_s(7.0)) == (1, 2.0)
    assert stream.rate_hz(6.0) == 0.5
    assert stream.rate_hz(7.5) == 0.0
