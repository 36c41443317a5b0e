"""Which messages reach whom: the autopilot, the application, and who is attached; and the signatures on their way."""

from __future__ import annotations

import os
import socket
import time
from typing import Any

from companion.gate.runtime import main as process
from companion.mavlink.codec import Framer
from companion.mavlink.signing import Signer
from tests.gate.built import command, frame
from tests.gate.runtime.rig import ATTITUDE, HEARTBEAT, HOST, received, rigged


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
