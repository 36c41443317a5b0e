"""Links: nothing that the other end does may raise, wait, or let somebody else take its place."""

from __future__ import annotations

import contextlib
import errno
import os
import pty
import socket
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from companion.errors import InputError
from companion.gate.runtime import serial_port
from companion.gate.runtime.framing import DATAGRAM_BYTES, RETRY_S, FrameReader, FrameWriter, batches
from companion.gate.runtime.transports import Transport, open_transport
from companion.gate.runtime.udp import MOST_FRAMES, PEER_SILENT_S, RIVAL_SILENT_S
from companion.mavlink.codec import Frame
from tests.gate.built import frame
from tests.shared.beside import wait_until

HOST = "127.0.0.1"
HEARTBEAT = frame("HEARTBEAT", component=1, autopilot=12)
ATTITUDE = frame("ATTITUDE", component=1, yaw=1.0)


def bound(kind: socket.SocketKind = socket.SOCK_DGRAM) -> socket.socket:
    made = socket.socket(socket.AF_INET, kind)
    made.bind((HOST, 0))
    made.settimeout(5.0)
    return made


def free_port() -> int:
    with bound() as taken:
        port: int = taken.getsockname()[1]
        return port


def heard(transport: Transport, now_s: float = 0.0, count: int = 1) -> list[Frame]:
    """What comes in until there are so many; a real socket takes a moment."""
    found: list[Frame] = []
    until_s = time.monotonic() + 5.0
    while len(found) < count and time.monotonic() < until_s:
        found += transport.receive(now_s)
    return found


def ticked(transport: Transport, now_s: float) -> Transport:
    transport.tick(now_s)
    return transport


@contextlib.contextmanager
def opened(url: str, system_id: int | None = 1) -> Iterator[Transport]:
    transport = open_transport(url, system_id)
    try:
        yield transport
    finally:
        transport.close()


# --- addresses --------------------------------------------------------------------------------------------------------


def test_an_address_that_is_none_is_refused_in_words() -> None:
    with pytest.raises(InputError, match="is no link: udpin://"):
        open_transport("http://127.0.0.1:80")


def test_an_unknown_host_is_refused_in_words() -> None:
    with pytest.raises(InputError, match="no such host"):
        open_transport("udpout://nobody.invalid:14550")


@pytest.mark.parametrize("scheme", ["udpin", "tcpin"])
def test_a_port_that_is_taken_is_told_at_the_start(scheme: str) -> None:
    with bound(socket.SOCK_DGRAM if scheme == "udpin" else socket.SOCK_STREAM) as other:
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=rf"{scheme}://127.0.0.1:{port} cannot be listened on: Address already"):
            open_transport(f"{scheme}://127.0.0.1:{port}")


def test_without_a_host_it_listens_everywhere() -> None:
    port = free_port()
    with opened(f"udpin://:{port}") as transport, bound() as autopilot:
        autopilot.sendto(HEARTBEAT.raw, (HOST, port))
        assert heard(transport) == [HEARTBEAT]


# --- UDP --------------------------------------------------------------------------------------------------------------


def test_udpin_answers_the_first_that_beats_and_nobody_else() -> None:
    """A second sender of heartbeats of the same number must not get the setpoints."""
    port = free_port()
    with opened(f"udpin://{HOST}:{port}") as transport, bound() as autopilot, bound() as other:
        transport.send(b"to nobody")
        assert transport.unsent == 1
        # Before, everybody is heard: so it can be told who is there instead of ours.
        foreign = frame("HEARTBEAT", component=1, system=7)
        other.sendto(foreign.raw, (HOST, port))
        assert heard(transport) == [foreign]
        transport.send(b"to nobody")
        assert transport.unsent == 2
        autopilot.sendto(HEARTBEAT.raw, (HOST, port))
        assert heard(transport) == [HEARTBEAT]
        other.sendto(HEARTBEAT.raw, (HOST, port))
        wait_until(lambda: not transport.receive(PEER_SILENT_S) and transport.strangers == 1)
        transport.send(b"setpoint")
        assert autopilot.recv(100) == b"setpoint"


def test_a_second_sender_that_calls_itself_the_autopilot_is_told() -> None:
    """Protects from flying whichever of two vehicles was heard first; anybody else is only counted."""
    port = free_port()
    with opened(f"udpin://{HOST}:{port}") as transport, bound() as autopilot, bound() as other:
        autopilot.sendto(HEARTBEAT.raw, (HOST, port))
        assert heard(transport) == [HEARTBEAT]
        for stranger in (frame("HEARTBEAT", component=191), frame("HEARTBEAT", component=1, system=2)):
            other.sendto(stranger.raw, (HOST, port))
        wait_until(lambda: not transport.receive(1.0) and transport.strangers == 2)
        assert transport.problem == ""
        for _ in range(2):
            other.sendto(HEARTBEAT.raw, (HOST, port))
        wait_until(lambda: not transport.receive(1.0) and transport.strangers == 4)
        ours, its = (f"{HOST}:{one.getsockname()[1]}" for one in (autopilot, other))
        assert f"two senders call themselves system 1 component 1: {ours} is heard, {its} is not" in transport.problem
        transport.tick(1.0 + RIVAL_SILENT_S)
        assert transport.problem
        transport.tick(1.1 + RIVAL_SILENT_S)
        assert transport.problem == ""


def test_of_two_who_are_attached_nobody_is_a_rival() -> None:
    port = free_port()
    with opened(f"udpin://{HOST}:{port}", None) as transport, bound() as station, bound() as other:
        station.sendto(HEARTBEAT.raw, (HOST, port))
        assert heard(transport) == [HEARTBEAT]
        other.sendto(HEARTBEAT.raw, (HOST, port))
        wait_until(lambda: not transport.receive(1.0) and transport.strangers == 1)
        assert transport.problem == ""


def test_udpin_follows_an_autopilot_that_comes_back_at_another_address() -> None:
    port = free_port()
    with opened(f"udpin://{HOST}:{port}") as transport, bound() as autopilot, bound() as again:
        autopilot.sendto(HEARTBEAT.raw, (HOST, port))
        heard(transport, 10.0)
        late_s = 10.0 + PEER_SILENT_S + 0.1
        # Not by anything but a heartbeat of ours, by the autopilot itself.
        for wrong in (ATTITUDE, frame("HEARTBEAT", component=191), frame("HEARTBEAT", component=1, system=2)):
            again.sendto(wrong.raw, (HOST, port))
        wait_until(lambda: not transport.receive(late_s) and transport.strangers == 3)
        again.sendto(b"no message", (HOST, port))
        again.sendto(HEARTBEAT.raw, (HOST, port))
        assert heard(transport, late_s) == [HEARTBEAT]
        # Garbage from it does not keep it in its place.
        again.sendto(b"garbage", (HOST, port))
        wait_until(lambda: not transport.receive(late_s + 1.0) and transport.reader.bad == 2)
        transport.send(b"setpoint")
        assert again.recv(100) == b"setpoint"


def test_udpin_for_somebody_attached_takes_whoever_speaks() -> None:
    port = free_port()
    with opened(f"udpin://{HOST}:{port}", None) as transport, bound() as eyes:
        odometry = frame("ODOMETRY", component=197)
        eyes.sendto(odometry.raw, (HOST, port))
        assert heard(transport) == [odometry]
        transport.send(b"up")
        assert eyes.recv(100) == b"up"


def test_a_flood_is_taken_in_parts() -> None:
    """Whoever sends a lot must leave time for the others."""
    port = free_port()
    with opened(f"udpin://{HOST}:{port}") as transport, bound() as autopilot:
        for _ in range(40):
            autopilot.sendto(HEARTBEAT.raw * 3, (HOST, port))
        assert MOST_FRAMES <= len(transport.receive(0.0)) < MOST_FRAMES + 3
    with bound() as autopilot, opened(f"udpout://{HOST}:{autopilot.getsockname()[1]}") as transport:
        transport.tick(0.0)
        transport.send(b"here I am")
        address = autopilot.recvfrom(100)[1]
        for _ in range(40):
            autopilot.sendto(HEARTBEAT.raw * 3, address)
        assert MOST_FRAMES <= len(transport.receive(0.0)) < MOST_FRAMES + 3
    with opened(f"udpin://{HOST}:{port}") as transport, bound() as autopilot:
        for _ in range(2 * MOST_FRAMES):
            autopilot.sendto(b"x", (HOST, port))
        assert transport.fileno() is not None
        transport.receive(0.0)
        assert transport.reader.bad == MOST_FRAMES
    with bound() as autopilot, opened(f"udpout://{HOST}:{autopilot.getsockname()[1]}") as transport:
        transport.tick(0.0)
        transport.send(b"here I am")
        address = autopilot.recvfrom(100)[1]
        for _ in range(2 * MOST_FRAMES):
            autopilot.sendto(b"x", address)
        transport.receive(0.0)
        assert transport.reader.bad == MOST_FRAMES
        transport.close()


def test_udpout_hears_only_the_address_that_it_sends_to() -> None:
    with bound() as autopilot, bound() as other, opened(f"udpout://{HOST}:{autopilot.getsockname()[1]}") as transport:
        assert transport.fileno() is None
        assert transport.receive(0.0) == []
        transport.send(b"too early")
        assert transport.unsent == 1
        transport.tick(0.0)
        transport.tick(0.0)
        transport.send(b"setpoint")
        data, address = autopilot.recvfrom(100)
        assert data == b"setpoint"
        other.sendto(HEARTBEAT.raw, address)
        autopilot.sendto(ATTITUDE.raw, address)
        assert heard(transport) == [ATTITUDE]


def test_udpout_to_where_nobody_listens_yet_goes_on() -> None:
    """The kernel reports the refusal at the next call: it is no reason to end anything."""
    with opened(f"udpout://{HOST}:{free_port()}") as transport:
        transport.tick(0.0)
        for _ in range(4):
            transport.send(b"anybody?")
            time.sleep(0.01)
        transport.receive(0.0)
        assert 1 <= transport.unsent < 4
        transport.tick(0.1)
        assert transport.fileno() is not None


def test_udpout_is_opened_anew_when_the_network_has_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    with opened(f"udpout://{HOST}:{free_port()}") as transport:
        transport.tick(0.0)
        transport.send(b"x" * 70_000)  # no network takes that: stands for any error that is not a refusal
        assert transport.unsent == 1
        transport.tick(1.0)
        assert transport.fileno() is None
        with monkeypatch.context() as patch:
            patch.setattr(socket.socket, "connect_ex", lambda *_: 101)
            transport.tick(1.0 + RETRY_S)
            assert transport.fileno() is None
            assert transport.problem == "Network is unreachable"
        transport.tick(1.0 + 1.5 * RETRY_S)
        assert transport.fileno() is None
        transport.tick(1.0 + 2.0 * RETRY_S)
        assert transport.fileno() is not None
        assert transport.problem == ""


# --- TCP --------------------------------------------------------------------------------------------------------------


def test_tcpin_lets_one_client_in_at_a_time() -> None:
    port = free_port()
    with opened(f"tcpin://{HOST}:{port}") as transport:
        entry = transport.fileno()
        transport.tick(0.0)
        transport.send(b"to nobody")
        assert transport.unsent == 1
        first = socket.create_connection((HOST, port))
        with first:
            wait_until(lambda: transport.receive(0.0) == [] and transport.fileno() != entry)
            assert transport.receive(0.0) == []
            second = socket.create_connection((HOST, port))
            with second:
                # In any pieces.
                first.sendall(HEARTBEAT.raw[:7])
                wait_until(lambda: transport.receive(0.0) == [] and transport.fileno() != entry)
                first.sendall(HEARTBEAT.raw[7:])
                assert heard(transport) == [HEARTBEAT]
                transport.send(b"setpoint")
                transport.tick(0.1)
                assert first.recv(100) == b"setpoint"
                # Half a message is left behind: it is not the beginning of what the next client says.
                first.sendall(ATTITUDE.raw[:9])
                first.close()
                wait_until(lambda: transport.receive(0.2) == [] and transport.fileno() == entry)
                assert transport.problem == "closed by the other end"
                wait_until(lambda: transport.receive(0.3) == [] and transport.fileno() != entry)
                assert transport.problem == ""
                second.sendall(ATTITUDE.raw)
                assert heard(transport, 0.3) == [ATTITUDE]


def test_tcp_that_is_reset_is_lost_and_nothing_raises() -> None:
    port = free_port()
    with opened(f"tcpin://{HOST}:{port}") as transport:
        entry = transport.fileno()
        client = socket.create_connection((HOST, port))
        wait_until(lambda: transport.receive(0.0) == [] and transport.fileno() != entry)
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        client.close()
        wait_until(lambda: transport.receive(0.0) == [] and transport.fileno() == entry)
        transport.send(b"x")
        assert transport.unsent == 1


def test_tcpout_connects_loses_and_connects_again() -> None:
    listener = bound(socket.SOCK_STREAM)
    port = listener.getsockname()[1]
    with opened(f"tcpout://{HOST}:{port}") as transport:
        wait_until(lambda: bool(ticked(transport, 0.0).problem))
        assert transport.fileno() is None
        assert transport.problem == "[Errno 111] Connection refused"
        listener.listen(1)
        now_s = RETRY_S

        def connected() -> bool:
            nonlocal now_s
            now_s += 0.01
            transport.tick(now_s)
            return transport.fileno() is not None

        wait_until(connected)
        server, _ = listener.accept()
        server.sendall(HEARTBEAT.raw)
        assert heard(transport, now_s) == [HEARTBEAT]
        server.close()
        wait_until(lambda: transport.receive(now_s) == [] and transport.fileno() is None)
        transport.tick(now_s)
        assert transport.fileno() is None
        now_s += RETRY_S
        wait_until(connected)
    listener.close()


def test_tcpout_waits_for_an_answer_without_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    with opened(f"tcpout://{HOST}:{free_port()}") as transport:
        monkeypatch.setattr(socket.socket, "connect_ex", lambda *_: 115)
        transport.tick(0.0)
        transport.tick(0.01)
        assert transport.fileno() is None
        assert transport.problem == ""


def test_a_stream_that_is_not_read_keeps_nothing_old() -> None:
    """A setpoint that waits in a connection arrives when it is no longer true: it is not sent at all."""
    port = free_port()
    with opened(f"tcpin://{HOST}:{port}") as transport:
        client = socket.socket()
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.connect((HOST, port))
        with client:
            entry = transport.fileno()
            wait_until(lambda: transport.receive(0.0) == [] and transport.fileno() != entry)
            for _ in range(1000):
                transport.send(b"y" * 250)
            assert transport.unsent > 100
            client.settimeout(0.2)
            taken = 0
            with contextlib.suppress(TimeoutError):
                while data := client.recv(65536):
                    taken += len(data)
            assert taken < 100_000


def test_a_message_is_sent_whole_or_not_at_all() -> None:
    """What follows a part of a message would be read as its rest."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        ours.setblocking(False)
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        writer = FrameWriter(1 << 30)
        # As large as it never comes, so that only a part of it is taken.
        piece = bytes(range(250)) * 400
        assert writer.put(ours.fileno(), piece)
        assert not writer.put(ours.fileno(), b"second")
        taken = b""
        theirs.settimeout(0.2)
        with contextlib.suppress(TimeoutError):
            while len(taken) < len(piece):
                taken += theirs.recv(1000)
                if writer.put(ours.fileno(), b"second"):
                    break
            while True:
                taken += theirs.recv(65536)
        assert taken == piece + b"second"
        assert writer.put(ours.fileno(), b"third")
        assert theirs.recv(100) == b"third"
        writer.restart()


# --- serial -----------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def terminal() -> Iterator[tuple[int, str]]:
    """The far end of a serial line, and the name of the near one."""
    far, near = pty.openpty()
    name = os.ttyname(near)
    os.close(near)
    os.set_blocking(far, False)
    try:
        yield far, name
    finally:
        with contextlib.suppress(OSError):
            os.close(far)


def test_serial_carries_messages_and_survives_unplugging() -> None:
    with terminal() as (far, name), opened(f"serial://{name}:57600") as transport:
        transport.tick(0.0)
        assert transport.fileno() is not None
        os.write(far, HEARTBEAT.raw + ATTITUDE.raw)
        assert heard(transport, count=2) == [HEARTBEAT, ATTITUDE]
        transport.send(b"setpoint")
        wait_until(lambda: os.read(far, 100) == b"setpoint")
        os.close(far)
        wait_until(lambda: transport.receive(5.0) == [] and transport.fileno() is None)
        assert transport.problem == "nothing can be read any more: was it unplugged?"
        transport.send(b"gone")
        assert transport.unsent == 1
        transport.tick(5.1)
        transport.tick(5.0 + RETRY_S)
        assert transport.fileno() is None
        assert transport.problem.startswith(f"there is no {name}: look at cable and power")


def test_a_serial_port_is_ours_alone() -> None:
    with terminal() as (_, name), opened(f"serial://{name}") as transport, opened(f"serial://{name}") as second:
        transport.tick(0.0)
        assert transport.fileno() is not None
        second.tick(0.0)
        assert second.fileno() is None
        assert f"{name} is used by another program" in second.problem


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.ENOENT, "there is no /dev/ttyX: look at cable and power"),
        (errno.EACCES, "sudo usermod -aG dialout"),
        (errno.EBUSY, "/dev/ttyX is used by another program"),
        (errno.EIO, "/dev/ttyX: "),
    ],
)
def test_what_is_wrong_with_a_port_is_said_with_what_to_do(
    monkeypatch: pytest.MonkeyPatch, number: int, said: str
) -> None:
    """Protects whoever stands at the vehicle with a cable in the hand."""

    def fails(*_: object, **__: object) -> None:
        raise serial.SerialException(number, os.strerror(number))

    monkeypatch.setattr(serial, "Serial", fails)
    with opened("serial:///dev/ttyX:57600") as transport:
        transport.tick(0.0)
        assert said in transport.problem


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (None, "no serial port of USB is plugged in"),
        ("ab", "plugged in: {0}/a, {0}/b"),
        ("fedcba", "plugged in: {0}/a, {0}/b, {0}/c, {0}/d and 2 more"),
    ],
)
def test_the_ports_that_are_there_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, names: str | None, said: str
) -> None:
    """Protects from the number behind ttyACM, which is another one after each plugging in."""
    by_id = tmp_path / "by-id"
    monkeypatch.setattr(serial_port, "BY_ID", by_id)
    if names is not None:
        by_id.mkdir()
        for name in names:
            (by_id / name).touch()
    with opened(f"serial://{tmp_path}/ttyX") as transport:
        transport.tick(0.0)
        assert transport.problem.endswith(said.format(by_id) if names else "is empty)")
        assert said.format(by_id) in transport.problem


def test_a_port_that_is_no_serial_line_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise termios.error(5, "Input/output error")

    monkeypatch.setattr(serial, "Serial", fails)
    with opened("serial:///dev/ttyX:57600") as transport:
        transport.tick(0.0)
        assert transport.problem == "/dev/ttyX: (5, 'Input/output error')"


def test_a_port_that_does_not_know_of_delays_is_taken_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object) -> None:
        raise ValueError("not supported")

    monkeypatch.setattr(serial.Serial, "set_low_latency_mode", unknown)
    with terminal() as (_, name), opened(f"serial://{name}:57600") as transport:
        transport.tick(0.0)
        assert transport.fileno() is not None


# --- what comes and goes ----------------------------------------------------------------------------------------------


def test_what_is_not_accepted_is_counted_and_goes_nowhere() -> None:
    reader = FrameReader(lambda found: found if found.message_id == 0 else None, datagram=False)
    assert reader.frames(HEARTBEAT.raw + ATTITUDE.raw) == [HEARTBEAT]
    assert reader.refused == 1
    reader.frames(b"garbage")
    reader.restart()
    reader.frames(b"garbage")
    assert reader.bad == 2


def test_batches_hold_whole_messages_and_fit_into_a_datagram() -> None:
    frames = [frame("STATUSTEXT", component=1, text="x" * (number % 50)) for number in range(200)]
    found = batches(frames)
    assert b"".join(found) == b"".join(one.raw for one in frames)
    assert max(map(len, found)) <= DATAGRAM_BYTES
    assert all(len(batch) > DATAGRAM_BYTES - 80 for batch in found[:-1])
    reader = FrameReader(None, datagram=True)
    assert sum(len(reader.frames(batch)) for batch in found) == 200
    assert reader.bad == 0
    assert batches([]) == []
