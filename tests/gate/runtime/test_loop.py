"""Turn after turn: what waited is old, a flood delays nothing, and links and the service manager are looked after."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from dataclasses import replace

import pytest

from companion.gate.gate import Verdict
from companion.gate.runtime.child import MOST_PACKETS
from companion.gate.runtime.loop import STALLED_S, Loop
from companion.gate.runtime.transports import open_transport
from companion.mavlink.codec import Frame
from tests.gate.built import frame, setpoint
from tests.gate.runtime.rig import ATTITUDE, HEARTBEAT, HOST, rigged


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
