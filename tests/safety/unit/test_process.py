"""The shell around the gate, with real sockets and processes, turned by hand."""

from __future__ import annotations

import contextlib
import gc
import os
import runpy
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from companion.errors import CompanionError, InputError
from companion.safety import __main__ as main_module
from companion.safety import family, keeper, precedence, process
from companion.safety.beat import Beat, Goodbye, Phase
from companion.safety.child import MOST_FRAMES
from companion.safety.gate import Gate
from companion.safety.keeper import GONE_S, LEAVE_S, LOOK_S, REST_S, Keeper
from companion.safety.log import Log
from companion.safety.loop import STALLED_S, Loop
from companion.safety.mavlink import Frame, Framer
from companion.safety.notify import Notifier
from companion.safety.plan import Attached, Plan, Signing
from companion.safety.signals import Signals
from companion.safety.signing import Signer
from companion.safety.wires import open_wire
from tests.safety.unit.built import PLAN, command, frame, setpoint

HOST = "127.0.0.1"
CHILD = """
import os, signal, socket, sys, time
beats = socket.socket(fileno=int(os.environ["COMPANION_GATE_FD"]))
host, port = os.environ["COMPANION_GATE_URL"].removeprefix("udpout://").split(":")
link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.connect((host, int(port)))
def say(words):
    link.send(bytes.fromhex(words))
def tell(words):
    beats.send(bytes.fromhex(words))
def hear():
    beats.send(b"heard " + link.recv(2000))
signal.signal(signal.SIGTERM, lambda *_: beats.send(b"SIGTERM"))
signal.signal(signal.SIGINT, lambda *_: beats.send(b"SIGINT"))
beats.send(b"up")
while words := beats.recv(4096).decode():
    if words.startswith("do "):
        exec(words[3:])
"""
"""Does what it is told, so that a test reads from one side."""

PROGRAM = (sys.executable, "-c", CHILD)
GROUND_BEAT = Beat(0.0, 0.0, 0.0, 0.0, 5.0, 0.0, Phase.GROUND)
HEARTBEAT = frame("HEARTBEAT", component=1, autopilot=12, base_mode=0)
ARMED = frame("HEARTBEAT", component=1, autopilot=12, base_mode=128)
ATTITUDE = frame("ATTITUDE", component=1, yaw=1.0)


@pytest.fixture(autouse=True)
def own_family(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The processes that other tests have started are not the gate's."""
    before = set(family.children())
    real_children = family.children

    def children() -> list[int]:
        return [pid for pid in real_children() if pid not in before]

    def deaths() -> list[tuple[int, int]]:
        found = []
        for pid in children():
            ended, status = os.waitpid(pid, os.WNOHANG)
            if ended:
                found.append((pid, os.waitstatus_to_exitcode(status)))
        return found

    monkeypatch.setattr(keeper, "children", children)
    monkeypatch.setattr(keeper, "deaths", deaths)
    monkeypatch.setattr(process, "adopt_orphans", lambda: None)
    yield
    gc.unfreeze()
    for pid in children():
        family.kill(pid)
        os.waitpid(pid, 0)


class Rig:
    """The gate between an autopilot that is a socket here, and a child that does what it is told.

    Args:
        plan: of the gate; addresses and commands are filled in.
        signer: of the link to the autopilot.
        attached: what each of them may.
    """

    def __init__(self, plan: Plan = PLAN, signer: Signer | None = None, attached: tuple[str, ...] = ()) -> None:
        self.offset_s = 0.0
        self.beats: list[bytes] = []
        self.autopilot = _bound()
        self.grounds = [_bound() for _ in attached]
        others = tuple(
            Attached(f"udpout://{HOST}:{ground.getsockname()[1]}", may)
            for ground, may in zip(self.grounds, attached, strict=True)
        )
        with _bound() as free:
            self.port: int = free.getsockname()[1]
        self.plan = replace(
            plan,
            autopilot_url=f"udpin://{HOST}:{self.port}",
            command=PROGRAM if plan.command == PLAN.command else plan.command,
            restart_command=PROGRAM if plan.restart_command == PLAN.restart_command else plan.restart_command,
            attached=others,
        )
        self.gate = Gate(self.plan, self.now_s())
        self.gate_beat = self.gate.beat
        self.gate.beat = self._beat  # type: ignore[method-assign]
        self.signals = Signals()
        self._said, words = os.pipe()
        self.log = Log(words)
        self.log_fd = words
        self.service = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.service.bind("")
        self.service.setblocking(False)
        name = self.service.getsockname().replace(b"\0", b"@").decode()
        self.notifier = Notifier({"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "400000"})
        accept = None if signer is None else process._accepting(signer)
        self.wire = open_wire(self.plan.autopilot_url, 1, accept)
        self.attached = [(one, open_wire(one.url)) for one in others]
        self.keeper = Keeper(self.plan, self.gate, self.log)
        self.keeper.start()
        self.loop = Loop(
            self.plan,
            self.gate,
            self.keeper,
            self.wire,
            signer,
            self.attached,
            self.signals,
            self.notifier,
            self.log,
            self.now_s,
        )

    def now_s(self) -> float:
        return time.monotonic() + self.offset_s

    def _beat(self, data: bytes, now_s: float) -> None:
        self.beats.append(data)
        self.gate_beat(data, now_s)

    def turn_until(self, true: Callable[[], object]) -> None:
        """Turn the loop until something has come about."""
        give_up_s = time.monotonic() + 20.0
        while not true():
            assert time.monotonic() < give_up_s, self.words()
            self.loop.turn()

    def turn_for(self, duration_s: float) -> None:
        until_s = time.monotonic() + duration_s
        self.turn_until(lambda: time.monotonic() > until_s)

    def up(self) -> None:
        """The child runs and is known, the autopilot has its address, and a first beat was heard."""
        self.turn_until(lambda: b"up" in self.beats)
        self.say(HEARTBEAT)
        self.turn_until(lambda: self.loop._heard_s > 0.0)
        self.do(f"tell('{GROUND_BEAT.packed().hex()}')")
        self.do(f"say('{frame('HEARTBEAT').raw.hex()}')")
        self.turn_until(lambda: frame("HEARTBEAT").raw in self.down())
        self.turn_until(lambda: GROUND_BEAT.packed() in self.beats)

    def do(self, script: str) -> None:
        """Have the child do something."""
        assert self.keeper.child is not None
        assert self.keeper.child._beats.send(f"do {script}".encode())

    def say(self, *frames: Frame) -> None:
        """The autopilot says something, in one datagram."""
        self.autopilot.sendto(b"".join(one.raw for one in frames), (HOST, self.port))

    def down(self) -> list[bytes]:
        """What the autopilot has got."""
        return _received(self.autopilot)

    def down_until(self, wanted: Callable[[Frame], bool]) -> Frame:
        """The first message to the autopilot that is like this."""
        found: list[Frame] = []

        def came() -> bool:
            for raw in self.down():
                found.extend(one for one in Framer().frames(raw) if wanted(one))
            return bool(found)

        self.turn_until(came)
        return found[0]

    def has_died(self) -> None:
        self.turn_until(lambda: self.keeper.child is None)

    def service_heard(self) -> list[bytes]:
        return _received(self.service)

    def words(self) -> str:
        """The log."""
        self.log.say("end")
        words = ""
        while not words.endswith("end\n"):
            words += os.read(self._said, 1 << 16).decode()
        return words

    def close(self) -> None:
        self.loop.close()
        self.wire.close()
        for _, wire in self.attached:
            wire.close()
        if self.keeper.child is not None:
            self.keeper.child.close()
        self.signals.close()
        self.notifier.close()
        self.log.close(5.0)
        os.close(self.log_fd)
        os.close(self._said)
        for one in (self.autopilot, self.service, *self.grounds):
            one.close()


def _bound() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((HOST, 0))
    made.setblocking(False)
    return made


def _received(there: socket.socket) -> list[bytes]:
    found = []
    with contextlib.suppress(BlockingIOError):
        while True:
            found.append(there.recv(2000))
    return found


@contextlib.contextmanager
def rigged(plan: Plan = PLAN, signer: Signer | None = None, attached: tuple[str, ...] = ()) -> Iterator[Rig]:
    rig = Rig(plan, signer, attached)
    try:
        yield rig
    finally:
        rig.close()


# --- messages ---------------------------------------------------------------------------------------------------------


def test_everything_goes_up_and_what_is_permitted_down() -> None:
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
    with rigged(attached=("read", "command")) as rig:
        rig.up()
        rig.say(ATTITUDE)
        wanted = {frame("HEARTBEAT").raw, ATTITUDE.raw, HEARTBEAT.raw}
        for ground in rig.grounds:
            heard: set[bytes] = set()

            def complete(ground: socket.socket = ground, heard: set[bytes] = heard) -> bool:
                heard.update(_received(ground))
                from_the_gate = any(one.component_id == 192 for raw in heard for one in Framer().frames(raw))
                return wanted <= heard and from_the_gate

            rig.turn_until(complete)


def test_a_ground_station_reaches_whom_it_may() -> None:
    """One that may only read orders nothing; an order to the application goes to it and not to the autopilot."""
    with rigged(attached=("read", "command")) as rig:
        rig.up()
        addresses = [wire.fileno() for _, wire in rig.attached]
        assert None not in addresses
        takes_off = command(22, component=190)
        pauses = command(193, component=190, target_component=191)
        everybody = frame("HEARTBEAT", component=190, system=255)
        for ground, (_, wire) in zip(rig.grounds, rig.attached, strict=True):
            with socket.socket(fileno=os.dup(wire.fileno() or -1)) as own:
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
    with rigged(attached=("command",)) as rig:
        rig.up()
        with socket.socket(fileno=os.dup(rig.attached[0][1].fileno() or -1)) as own:
            address = own.getsockname()
        unknown = b"\xfd\x01\x00\x00\x00\xff\xbe\xd2\x04\x00\x01\x00\x00"
        rig.grounds[0].sendto(unknown, address)
        rig.grounds[0].sendto(frame("HEARTBEAT", component=190, system=255).raw, address)
        rig.do("hear()")
        rig.turn_until(lambda: b"heard " + frame("HEARTBEAT", component=190, system=255).raw in rig.beats)


def test_setpoints_that_waited_while_the_gate_was_stopped_are_not_sent() -> None:
    """They are from another time; what is no setpoint waits for no answer in time."""
    with rigged() as rig:
        rig.up()
        sent = frame("PARAM_REQUEST_LIST", target_system=1, target_component=1)
        rig.do(f"say('{setpoint().raw.hex()}');say('{sent.raw.hex()}');beats.send(b'done')")
        # The child has sent, and the gate has not looked.
        deadline_s = time.monotonic() + 20.0
        assert rig.keeper.child is not None
        waiting = socket.socket(fileno=os.dup(rig.keeper.child._socket.fileno()))
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


def test_a_refused_command_is_answered_to_the_application() -> None:
    """Protects the application's words when the gate does not let it arm."""
    with rigged() as rig:
        rig.up()
        rig.do(f"say('{command(400, 1.0, 21196.0).raw.hex()}');" + "[hear() for _ in range(3)]")
        rig.turn_until(lambda: any(b"heard " in beat and b"\x4d\x00\x00" in beat for beat in rig.beats))


def test_the_gate_stays_while_it_stops_the_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects a landing that is due when the application has said its last word."""
    monkeypatch.setattr(Gate, "airborne", True)
    with rigged() as rig:
        rig.up()
        rig.turn_for(0.3)
        assert rig.gate.stage > 0, "no beats come"
        rig.do(f"tell('{Goodbye(1).packed().hex()}'); sys.exit(1)")
        rig.has_died()
        rig.offset_s += REST_S + LOOK_S
        rig.turn_for(0.05)
        assert rig.keeper.exit_code is None
        monkeypatch.setattr(Gate, "airborne", False)
        assert rig.loop.run() == 1


def test_a_flood_of_the_application_does_not_delay_the_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    """However much waits, only so much of it is taken between two looks at what else is to be done."""
    with rigged() as rig:
        rig.up()
        rig.do(f"r=bytes.fromhex('{setpoint().raw.hex()}')\nwhile True: link.send(r)")
        taken, most, cycles = 0, 0, 0
        real_spoke, real_cycle = rig.gate.application_spoke, rig.gate.cycle

        def spoke(found: Frame, now_s: float) -> bytes | None:
            nonlocal taken
            taken += 1
            return real_spoke(found, now_s)

        def cycle(now_s: float) -> list[bytes]:
            nonlocal cycles
            cycles += 1
            return real_cycle(now_s)

        monkeypatch.setattr(rig.gate, "application_spoke", spoke)
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
        assert 0 < most <= MOST_FRAMES


def test_a_link_that_is_lost_and_found_is_told_and_followed() -> None:
    listener = socket.socket()
    listener.bind((HOST, 0))
    url = f"tcpout://{HOST}:{listener.getsockname()[1]}"
    with listener, rigged() as rig:
        rig.wire.close()
        rig.loop.close()
        wire = open_wire(url, 1)
        rig.loop = Loop(
            replace(rig.plan, autopilot_url=url),
            rig.gate,
            rig.keeper,
            wire,
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
        rig.turn_until(lambda: wire.fileno() is None)
        rig.turn_for(0.05)
        assert f"{url}: closed by the other end" in rig.words()
        wire.close()


def test_an_attached_link_that_does_not_open_is_told() -> None:
    with rigged(attached=("read",)) as rig:
        wire = rig.attached[0][1]
        rig.turn_until(lambda: wire.fileno())
        wire.problem = "Network is unreachable"
        rig.turn_for(0.05)
        assert f"{rig.plan.attached[0].url}: Network is unreachable" in rig.words()


def test_the_service_manager_hears_of_ready_stage_and_every_completed_cycle() -> None:
    with rigged() as rig:
        heard: list[bytes] = []

        def fed() -> bool:
            heard.extend(rig.service_heard())
            return heard.count(b"WATCHDOG=1") >= 3

        rig.turn_until(fed)
        assert heard[:3] == [b"READY=1", b"STATUS=pass", b"WATCHDOG=1"]
        assert heard.count(b"READY=1") == 1


# --- signing ----------------------------------------------------------------------------------------------------------


def test_a_signed_link_hears_and_sends_nothing_unsigned() -> None:
    key = bytes(range(32))
    theirs = Signer(key, 2, time.time)
    with rigged(signer=Signer(key, 1, time.time)) as rig:
        rig.turn_until(lambda: b"up" in rig.beats)
        rig.say(ATTITUDE)
        rig.turn_until(lambda: rig.wire.inflow.refused == 1)
        rig.autopilot.sendto(theirs.sign(HEARTBEAT.raw), (HOST, rig.port))
        # What the application says before the autopilot is known goes nowhere, and it is read first.
        rig.turn_until(lambda: rig.loop._heard_s > 0.0)
        rig.do(f"say('{frame('HEARTBEAT').raw.hex()}')")
        first = rig.down_until(lambda found: found.component_id == 191)
        assert first.signed
        assert theirs.accepts(first.raw)
        assert theirs.unsigned(first.raw) == frame("HEARTBEAT").raw
        # Upwards it goes without the signature: the application has no key.
        rig.do("hear()")
        rig.autopilot.sendto(theirs.sign(ATTITUDE.raw), (HOST, rig.port))
        rig.turn_until(lambda: b"heard " + ATTITUDE.raw in rig.beats)
        # MAVLink 1 cannot be signed.
        rig.loop._down(b"\xfe" + bytes(7))
        assert rig.loop.unsigned == 1


def test_what_may_come_unsigned_is_passed_on_as_it_is() -> None:
    class Lenient:
        def accepts(self, _raw: bytes) -> bool:
            return True

    signer: Any = Lenient()
    assert process._accepting(signer)(ATTITUDE) is ATTITUDE


# --- life and death of the application --------------------------------------------------------------------------------


def test_its_last_word_is_the_exit_code() -> None:
    with rigged() as rig:
        rig.up()
        rig.do(f"tell('{Goodbye(7).packed().hex()}'); sys.exit(3)")
        assert rig.loop.run() == 7
        rig.keeper.cycle(rig.now_s(), 0.0)


def test_one_that_is_left_sees_the_end_of_its_socket() -> None:
    """Protects against an application that flies on in the belief that there is a gate."""
    with rigged() as rig:
        rig.up()
        child = rig.keeper.child
        assert child is not None
        rig.keeper.close()
        deadline_s = time.monotonic() + 10.0
        while not [code for pid, code in family.deaths() if pid == child.pid]:
            assert time.monotonic() < deadline_s, "its loop ends with the socket"
            time.sleep(0.01)
        rig.keeper.child = None
        rig.keeper.close()


def test_after_its_last_word_it_is_not_waited_for_for_ever() -> None:
    with rigged() as rig:
        rig.up()
        rig.do(f"tell('{Goodbye(0).packed().hex()}'); time.sleep(60)")
        rig.turn_until(lambda: rig.gate.goodbye)
        rig.turn_for(0.05)
        assert rig.keeper.exit_code is None
        rig.offset_s += LEAVE_S + 0.1
        assert rig.loop.run() == 0
        assert f"did not end within {LEAVE_S:g} s of its last word; it is killed" in rig.words()


@pytest.mark.parametrize(("script", "code"), [("sys.exit(2)", 2), ("sys.exit(0)", 1), ("os.kill(os.getpid(),9)", 1)])
def test_one_that_never_spoke_is_not_started_again(script: str, code: int) -> None:
    """A broken installation does not get better by being started."""
    with rigged(replace(PLAN, command=(sys.executable, "-c", f"import os, sys; {script}"))) as rig:
        assert rig.loop.run() == code
        assert "before its first word" in rig.words()


def test_one_that_died_is_told_and_started_again_when_the_vehicle_is_disarmed() -> None:
    """Nothing that starts in the air knows where it is; and what the dead one had started must be gone."""
    with rigged() as rig:
        rig.up()
        rig.say(ARMED)
        rig.do("import subprocess; subprocess.Popen(['sleep', '60']); os.kill(os.getpid(), 9)")
        dead = rig.keeper.child
        rig.has_died()
        rig.turn_until(lambda: rig.gate.armed)
        rig.offset_s += REST_S + 0.1
        rig.turn_for(0.05)
        rig.offset_s += LOOK_S + 0.1
        rig.turn_for(0.05)
        assert rig.keeper.child is None
        rig.say(HEARTBEAT, ATTITUDE)
        rig.turn_until(lambda: not rig.gate.armed)
        rig.offset_s += LOOK_S + 0.1
        rig.turn_until(lambda: rig.keeper.child)
        assert rig.keeper.child is not dead
        assert "was ended by signal 9 (Killed)" in rig.words()
        # It has another socket, and is heard and spoken to over it.
        rig.beats.clear()
        rig.up()


def test_its_children_are_killed_before_another_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    with rigged() as rig:
        rig.up()
        killed: list[int] = []
        rig.do("sys.exit(1)")
        rig.has_died()
        monkeypatch.setattr(keeper, "children", lambda: [] if killed else [4_194_999])
        monkeypatch.setattr(keeper, "kill", killed.append)
        rig.offset_s += REST_S + 0.1
        rig.turn_until(lambda: killed)
        assert rig.keeper.child is None
        rig.offset_s += LOOK_S + 0.1
        rig.turn_until(lambda: rig.keeper.child)


def test_the_end_of_another_process_is_no_end_of_the_application(monkeypatch: pytest.MonkeyPatch) -> None:
    """Orphans that were adopted end here too."""
    with rigged() as rig:
        rig.up()
        monkeypatch.setattr(keeper, "deaths", lambda: [(4_194_999, 0)])
        rig.keeper.bury(rig.now_s())
        assert rig.keeper.child is not None
        assert rig.keeper.exit_code is None


def test_one_that_dies_again_and_again_is_given_up() -> None:
    ends = (sys.executable, "-c", "pass")
    with rigged(replace(PLAN, restart_command=ends, restarts=2)) as rig:
        rig.up()
        rig.do("sys.exit(1)")
        rig.has_died()
        for _ in range(2):
            rig.offset_s += REST_S + LOOK_S
            rig.turn_until(lambda: rig.keeper.child)
            rig.has_died()
        rig.offset_s += REST_S + LOOK_S
        assert rig.loop.run() == 1
        assert "was started 3 times; it is not started again" in rig.words()


def test_a_restart_that_fails_is_tried_again_and_given_up() -> None:
    with rigged(replace(PLAN, restart_command=("/no/such/program",), restarts=2)) as rig:
        rig.up()
        rig.do("sys.exit(1)")
        rig.has_died()
        while rig.keeper.exit_code is None:
            rig.offset_s += REST_S + LOOK_S
            rig.turn_for(0.02)
        words = rig.words()
        assert rig.keeper.exit_code == 1
        assert words.count("the application cannot be started: [Errno 2]") == 2


def test_one_that_hangs_is_killed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    with rigged() as rig:
        rig.up()
        rig.do("time.sleep(60)")
        monkeypatch.setattr(rig.gate, "hangs", lambda _now_s: True)
        killed: list[int] = []
        monkeypatch.setattr(keeper, "kill", killed.append)
        # A process that waits for a disk does not die at once.
        rig.turn_for(0.05)
        (pid,) = killed
        family.kill(pid)
        rig.has_died()
        words = rig.words()
        assert words.count("the application hung for 10 s; it is killed") == 1


def test_it_may_close_its_socket_and_live() -> None:
    with rigged() as rig:
        rig.up()
        rig.do("beats.shutdown(socket.SHUT_WR); link.close(); time.sleep(60)")
        rig.turn_until(lambda: rig.keeper.child and rig.keeper.child.silent)
        rig.say(ATTITUDE)
        rig.turn_for(0.05)
        assert rig.keeper.exit_code is None


# --- signals ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sent", "heard"), [(signal.SIGTERM, b"SIGTERM"), (signal.SIGINT, b"SIGINT"), (signal.SIGHUP, b"SIGTERM")]
)
def test_who_asks_the_gate_for_the_end_asks_the_application(sent: signal.Signals, heard: bytes) -> None:
    with rigged() as rig:
        rig.up()
        signal.pthread_kill(threading.get_ident(), signal.SIGQUIT)
        signal.pthread_kill(threading.get_ident(), sent)
        rig.turn_until(lambda: heard in rig.beats)
        assert rig.keeper.exit_code is None
        assert b"STOPPING=1" in rig.service_heard()


def test_ctrl_c_reaches_the_application_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The terminal has given it to the whole group already."""
    with rigged() as rig:
        rig.up()
        came = [SimpleNamespace(si_signo=signal.SIGINT, si_code=128)]
        monkeypatch.setattr(signal, "sigtimedwait", lambda *_: came.pop() if came else None)
        rig.turn_for(0.05)
        assert not came
        assert b"SIGINT" not in rig.beats
        # No start follows when it dies now.
        rig.do("os.kill(os.getpid(), 9)")
        assert_gives_up(rig)


def assert_gives_up(rig: Rig) -> None:
    rig.has_died()
    rig.offset_s += REST_S + LOOK_S
    assert rig.loop.run() == 1


def test_in_the_air_the_gate_outlives_a_dead_application_also_when_it_is_asked_to_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It brings the vehicle down; only an autopilot that is gone is not waited for."""
    monkeypatch.setattr(Gate, "airborne", True)
    with rigged() as rig:
        rig.up()
        rig.keeper.ask(None)
        rig.do("os.kill(os.getpid(), 9)")
        rig.has_died()
        rig.offset_s += REST_S + LOOK_S
        rig.loop.turn()
        rig.say(ATTITUDE)
        rig.turn_until(lambda: rig.now_s() - rig.loop._heard_s < 1.0)
        rig.turn_for(0.05)
        assert rig.keeper.exit_code is None
        signal.pthread_kill(threading.get_ident(), signal.SIGTERM)
        rig.turn_for(0.05)
        assert rig.keeper.exit_code is None
        rig.offset_s += GONE_S
        assert rig.loop.run() == 1


def test_signals_are_as_they_were_afterwards() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ()), signal.getsignal(signal.SIGCHLD)
    signals = Signals()
    signals.hushed()
    # A flood of them ends too.
    signals.taken()
    signals.close()
    assert (signal.pthread_sigmask(signal.SIG_BLOCK, ()), signal.getsignal(signal.SIGCHLD)) == before


def test_signals_are_taken_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    signals = Signals()
    monkeypatch.setattr(signal, "sigtimedwait", lambda *_: SimpleNamespace(si_signo=15, si_code=0))
    assert signals.taken() == [signal.SIGTERM] * 16
    signals.close()


# --- the whole process ------------------------------------------------------------------------------------------------


def whole(**changes: Any) -> Plan:
    with _bound() as free:
        url = f"udpin://{HOST}:{free.getsockname()[1]}"
    says_goodbye = (
        sys.executable,
        "-c",
        "import os, socket; "
        "beats = socket.socket(fileno=int(os.environ['COMPANION_GATE_FD'])); "
        f"beats.send(bytes.fromhex('{Goodbye(5).packed().hex()}'))",
    )
    return replace(PLAN, autopilot_url=url, command=says_goodbye, **changes)


def test_the_process_ends_with_the_applications_last_word(capfd: pytest.CaptureFixture[str]) -> None:
    plan = whole(attached=(Attached("udpout://127.0.0.1:9", "read"),))
    assert process.run(plan) == 5
    said = capfd.readouterr().err
    assert "not real time" in said
    assert "gate: " in said.splitlines()[-1]


def test_a_broken_gate_ends_at_once_and_says_why(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Never on in a state that nobody knows: silence is what the autopilot understands."""

    def broken(_self: Gate, _now_s: float) -> list[bytes]:
        raise ArithmeticError("two and two is five")

    monkeypatch.setattr(Gate, "cycle", broken)
    assert process.run(whole()) == 70
    said = capfd.readouterr().err
    assert "the gate is broken and ends" in said
    assert "two and two is five" in said


def test_precedence_is_taken_where_it_is_given(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, int]] = []

    def refused(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(
        os, "sched_setscheduler", lambda _pid, policy, parameter: asked.append((policy, parameter.sched_priority))
    )
    assert process.run(whole(realtime=True)) == 5
    assert "real time" in capfd.readouterr().err
    assert asked == [(os.SCHED_RR, 1)]
    monkeypatch.setattr(os, "sched_setscheduler", refused)
    nice: list[int] = []
    monkeypatch.setattr(os, "setpriority", lambda _which, _who, value: nice.append(value))
    assert precedence.take_precedence() == "nice -10"
    monkeypatch.setattr(os, "setpriority", refused)
    assert precedence.take_precedence().startswith("no precedence")


def test_what_cannot_be_started_or_opened_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(CompanionError, match="the application cannot be started: /no/such program: "):
        process.run(replace(whole(), command=("/no/such", "program")))
    with pytest.raises(InputError, match=r"safety.signing.key_file .*key: "):
        process.run(whole(signing=Signing(str(tmp_path / "key"), 1)))
    key = tmp_path / "key"
    key.write_text("0123456789abcdef" * 4)
    key.chmod(0o644)
    with pytest.raises(InputError, match=r"chmod 600"):
        process.run(whole(signing=Signing(str(key), 1)))
    key.chmod(0o600)
    assert process.run(whole(signing=Signing(str(key), 1))) == 5


def plan_fd(text: str) -> str:
    fd = os.memfd_create("plan")
    os.write(fd, text.encode())
    return str(fd)


def test_the_module_reads_its_plan_and_runs() -> None:
    assert main_module.main(("--plan-fd", plan_fd(whole().dumps()))) == 5


@pytest.mark.parametrize("arguments", [(), ("--plan-fd",), ("--plan", "3"), ("--plan-fd", "x")])
def test_started_by_hand_it_says_how(arguments: tuple[str, ...], capfd: pytest.CaptureFixture[str]) -> None:
    assert main_module.main(arguments) == 2
    assert "companion run" in capfd.readouterr().err


def test_as_a_program_it_ends_with_its_exit_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["safety", "--plan-fd"])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(str(main_module.__file__), run_name="__main__")


def test_a_plan_that_is_none_is_refused(capfd: pytest.CaptureFixture[str]) -> None:
    assert main_module.main(("--plan-fd", plan_fd("{}"))) == 2
    assert main_module.main(("--plan-fd", "1000000")) == 2
    assert capfd.readouterr().err.count("the gate cannot read its plan: ") == 2
