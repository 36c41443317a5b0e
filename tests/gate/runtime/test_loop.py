"""Turn after turn: what waited is old, a flood delays nothing, links and the service manager are looked after."""

from __future__ import annotations

import contextlib
import functools
import os
import socket
import time
from dataclasses import replace
from typing import Any

import pytest

from companion.gate.gate import Verdict
from companion.gate.runtime import main as process
from companion.gate.runtime.child import MOST_PACKETS
from companion.gate.runtime.loop import STALLED_S, Loop
from companion.gate.runtime.transports import open_transport
from companion.gate.runtime.udp import RIVAL_SILENT_S
from companion.mavlink.codec import Frame, Framer
from companion.mavlink.signing import Signer
from tests.gate.built import command, frame, setpoint
from tests.gate.runtime.rig import ATTITUDE, HEARTBEAT, HOST, bound, received, rigged


def test_setpoints_that_waited_while_the_gate_was_stopped_are_not_sent() -> None:
    """They are from another time; what is no setpoint waits for no answer in time."""
    with rigged() as rig:
        rig.up()
        sent = frame("PARAM_REQUEST_LIST", target_system=1, target_component=1)
        rig.do(f"say('{setpoint().raw.hex()}');say('{sent.raw.hex()}');gate.send(b'done')")
        # The child has sent, and the gate has not looked.
        deadline_s = time.monotonic() + 20.0
        assert rig.supervisor.child is not None
        waiting = socket.socket(fileno=os.dup(rig.supervisor.child._socket.fileno()))
        with waiting:
            while time.monotonic() < deadline_s:
                with contextlib.suppress(BlockingIOError):
                    waiting.recv(1, socket.MSG_PEEK)
                    time.sleep(0.1)
                    break
        rig.offset_s += 2.0 * STALLED_S
        assert rig.down_until(lambda found: found.message_id in (84, 21)) == sent
        assert rig.loop.stale == 1
        assert "the gate stood still for 0." in rig.words(), "who reads the log after a crash must know"
        rig.do(f"say('{setpoint().raw.hex()}')")
        rig.down_until(lambda found: found.message_id == 84)


def test_what_the_autopilot_said_while_the_gate_was_stopped_is_old() -> None:
    """Protects against taking a queue for the present: it tells who has the vehicle, and not that the link lives."""
    with rigged() as rig:
        rig.up()
        before_s = rig.gate._vehicle.heard_s
        rig.say(HEARTBEAT)
        rig.say(ATTITUDE)
        time.sleep(0.05)
        rig.offset_s += 2.0
        rig.loop.turn()
        assert rig.gate._vehicle.heard_s < before_s + 1.0
        rig.say(ATTITUDE)
        rig.turn_until(lambda: rig.gate._vehicle.heard_s > before_s + 1.9)


def test_a_flood_of_the_application_does_not_delay_the_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    """However much waits, only so much of it is taken between two looks at what else is to be done."""
    with rigged() as rig:
        rig.up()
        rig.do(f"r=bytes.fromhex('{setpoint().raw.hex()}')\nwhile True: gate.send(r)")
        taken, most, cycles = 0, 0, 0
        real_spoke, real_cycle = rig.gate.on_application_message, rig.gate.cycle

        def spoke(found: Frame, now_s: float) -> Verdict:
            nonlocal taken
            taken += 1
            return real_spoke(found, now_s)

        def cycle(now_s: float) -> list[bytes]:
            nonlocal cycles
            cycles += 1
            return real_cycle(now_s)

        monkeypatch.setattr(rig.gate, "on_application_message", spoke)
        monkeypatch.setattr(rig.gate, "cycle", cycle)
        give_up_s = time.monotonic() + 20.0
        while rig.gate.counts["application: flood"] == 0:
            assert time.monotonic() < give_up_s
            taken = 0
            due = rig.now_s() > rig.loop._due_s
            cycles = 0
            rig.loop.turn()
            most = max(most, taken)
            # Whatever came in, a cycle that was due is done in the same turn.
            assert cycles == 1 or not due
        assert 0 < most <= MOST_PACKETS


def test_the_application_hears_what_is_wrong_with_the_link() -> None:
    """Protects a check that has to refuse: what only the gate sees is told to who decides; and that it is over."""
    with rigged() as rig, bound() as rival:
        rig.up()
        for said in (b"link: two senders", b"link: "):
            rig.do("words = b''\nwhile b'link: ' not in words: words = gate.recv(4096)\nsay(words[:23].hex())")
            if said == b"link: ":
                rig.offset_s += RIVAL_SILENT_S + 1.0
            else:
                rival.sendto(HEARTBEAT.raw, (HOST, rig.port))
            rig.turn_until(functools.partial(_last_ends_with, rig.beats, said))


def _last_ends_with(beats: list[bytes], said: bytes) -> bool:
    return beats[-1].endswith(said)


def test_a_problem_of_the_link_is_told_when_there_is_no_application() -> None:
    with rigged() as rig, bound() as rival:
        rig.up()
        rig.do("os.kill(os.getpid(), 9)")
        rig.has_died()
        rival.sendto(HEARTBEAT.raw, (HOST, rig.port))
        rig.turn_until(lambda: rig.transport.problem)
        rig.turn_for(0.05)
        assert "two senders" in rig.words()


def test_what_is_wrong_with_the_link_is_the_last_word() -> None:
    """Protects whoever reads the last line only: before, it said that nothing was refused."""
    with rigged() as rig:
        rig.transport.problem = "there is no /dev/ttyX"
        rig.loop.close()
        assert rig.words().splitlines()[-2].endswith(f"gate: {rig.plan.autopilot_url}: there is no /dev/ttyX")


def test_a_link_that_is_lost_and_found_is_told_and_followed() -> None:
    """Protects the flight from a link that opens late or breaks, and the service manager from a "ready" too early."""
    listener = socket.socket()
    listener.bind((HOST, 0))
    url = f"tcpout://{HOST}:{listener.getsockname()[1]}"
    with listener, rigged() as rig:
        rig.transport.close()
        rig.loop.close()
        transport = open_transport(url, 1)
        rig.loop = Loop(
            replace(rig.plan, autopilot_url=url),
            rig.gate,
            rig.supervisor,
            transport,
            None,
            [],
            rig.signals,
            rig.notifier,
            rig.log,
            rig.now_s,
        )
        assert b"READY=1" not in rig.service_heard()
        rig.turn_for(0.05)
        assert b"READY=1" not in rig.service_heard()
        listener.listen(1)
        rig.offset_s += 1.0
        rig.turn_until(lambda: b"READY=1" in rig.service_heard())
        server, _ = listener.accept()
        server.close()
        rig.turn_until(lambda: transport.fileno() is None)
        rig.turn_for(0.05)
        assert f"{url}: closed by the other end" in rig.words()
        transport.close()


def test_an_attached_link_that_does_not_open_is_told() -> None:
    """Protects the person who waits at a ground station that hears nothing."""
    with rigged(attached=("read",)) as rig:
        transport = rig.attached[0][1]
        rig.turn_until(lambda: transport.fileno())
        transport.problem = "Network is unreachable"
        rig.turn_for(0.05)
        assert f"{rig.plan.attached[0].url}: Network is unreachable" in rig.words()


def test_the_service_manager_hears_of_ready_stage_and_every_completed_cycle() -> None:
    """Protects the watchdog: it is fed by cycles that were completed, and "ready" is said once."""
    with rigged() as rig:
        heard: list[bytes] = []

        def fed() -> bool:
            heard.extend(rig.service_heard())
            return heard.count(b"WATCHDOG=1") >= 3

        rig.turn_until(fed)
        assert heard[:3] == [b"READY=1", b"STATUS=pass", b"WATCHDOG=1"]
        assert heard.count(b"READY=1") == 1


# Which messages reach whom: the autopilot, the application, and who is attached; and the signatures on their way.


def test_everything_goes_up_and_what_is_permitted_down() -> None:
    """Protects both ways through the gate: forced disarming stays here, and the request after it arrives."""
    with rigged() as rig:
        rig.up()
        rig.do("hear()")
        rig.say(ATTITUDE, HEARTBEAT)
        rig.turn_until(lambda: b"heard " + ATTITUDE.raw + HEARTBEAT.raw in rig.beats)
        # The heart of the gate itself beats too.
        rig.down_until(lambda found: (found.message_id, found.component_id) == (0, 192))
        sent = frame("PARAM_REQUEST_LIST", target_system=1, target_component=1)
        rig.do(f"say('{command(400, 1.0, 21196.0).raw.hex()}')")
        rig.do(f"say('{sent.raw.hex()}')")
        assert rig.down_until(lambda found: found.message_id in (76, 21)) == sent


def test_who_is_attached_hears_the_autopilot_the_application_and_the_gate() -> None:
    """Protects the view of the people on the ground, whatever they may do."""
    with rigged(attached=("read", "command")) as rig:
        rig.up()
        rig.say(ATTITUDE)
        wanted = {frame("HEARTBEAT").raw, ATTITUDE.raw, HEARTBEAT.raw}
        for ground in rig.grounds:
            heard: set[bytes] = set()

            def complete(ground: socket.socket = ground, heard: set[bytes] = heard) -> bool:
                heard.update(received(ground))
                from_the_gate = any(one.component_id == 192 for raw in heard for one in Framer().frames(raw))
                return wanted <= heard and from_the_gate

            rig.turn_until(complete)


def test_a_ground_station_reaches_whom_it_may() -> None:
    """One that may only read orders nothing; an order to the application goes to it and not to the autopilot."""
    with rigged(attached=("read", "command")) as rig:
        rig.up()
        addresses = [transport.fileno() for _, transport in rig.attached]
        assert None not in addresses
        takes_off = command(22, component=190)
        pauses = command(193, component=190, target_component=191)
        everybody = frame("HEARTBEAT", component=190, system=255)
        for ground, (_, transport) in zip(rig.grounds, rig.attached, strict=True):
            with socket.socket(fileno=os.dup(transport.fileno() or -1)) as own:
                address = own.getsockname()
            for sent in (takes_off, pauses, everybody, frame("SYS_STATUS", component=190)):
                ground.sendto(sent.raw, address)
        rig.do("hear()")
        rig.do("hear()")
        rig.do("hear()")
        rig.turn_until(lambda: b"heard " + pauses.raw in rig.beats)
        rig.turn_until(lambda: b"heard " + everybody.raw in rig.beats)
        assert b"heard " + takes_off.raw not in rig.beats
        got = [one for raw in rig.down() for one in Framer().frames(raw)]
        assert got.count(takes_off) == 1
        assert pauses not in got


def test_of_a_message_that_is_not_known_nobody_can_say_for_whom_it_is() -> None:
    """Protects the application from what may be meant for the autopilot alone."""
    with rigged(attached=("command",)) as rig:
        rig.up()
        with socket.socket(fileno=os.dup(rig.attached[0][1].fileno() or -1)) as own:
            address = own.getsockname()
        unknown = b"\xfd\x01\x00\x00\x00\xff\xbe\xd2\x04\x00\x01\x00\x00"
        rig.grounds[0].sendto(unknown, address)
        rig.grounds[0].sendto(frame("HEARTBEAT", component=190, system=255).raw, address)
        rig.do("hear()")
        rig.turn_until(lambda: b"heard " + frame("HEARTBEAT", component=190, system=255).raw in rig.beats)


def test_a_refused_command_is_answered_to_the_application() -> None:
    """Protects the application's words when the gate does not let it arm."""
    with rigged() as rig:
        rig.up()
        rig.do(f"say('{command(400, 1.0, 21196.0).raw.hex()}');" + "[hear() for _ in range(3)]")
        rig.turn_until(lambda: any(b"heard " in beat and b"\x4d\x00\x00" in beat for beat in rig.beats))


def test_a_signed_link_hears_and_sends_nothing_unsigned() -> None:
    """Protects the autopilot's link from whoever has no key, and the key from the application."""
    key = bytes(range(32))
    theirs = Signer(key, 2, time.time)
    with rigged(signer=Signer(key, 1, time.time)) as rig:
        rig.turn_until(lambda: b"up" in rig.beats)
        rig.say(ATTITUDE)
        rig.turn_until(lambda: rig.transport.reader.refused == 1)
        rig.autopilot.sendto(theirs.sign(HEARTBEAT.raw), (HOST, rig.port))
        # What the application says before the autopilot is known goes nowhere, and it is read first.
        rig.turn_until(lambda: rig.loop._heard_s > 0.0)
        rig.do(f"say('{frame('HEARTBEAT').raw.hex()}')")
        first = rig.down_until(lambda found: found.component_id == 191)
        assert first.signed
        assert theirs.accepts(first.raw)
        assert theirs.unsigned(first.raw) == frame("HEARTBEAT").raw
        # Upwards it goes without the signature: the application has no key.
        rig.do("waiting.clear(); hear()")
        rig.autopilot.sendto(theirs.sign(ATTITUDE.raw), (HOST, rig.port))
        rig.turn_until(lambda: b"heard " + ATTITUDE.raw in rig.beats)
        # MAVLink 1 cannot be signed.
        rig.loop._down(b"\xfe" + bytes(7))
        assert rig.loop.unsigned == 1


def test_what_may_come_unsigned_is_passed_on_as_it_is() -> None:
    """Protects the few messages that a signed link takes without a signature from being cut."""

    class Lenient:
        def accepts(self, _raw: bytes) -> bool:
            return True

    signer: Any = Lenient()
    assert process._accepting(signer)(ATTITUDE) is ATTITUDE
