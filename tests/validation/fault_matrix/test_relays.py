"""The relay on the autopilot's link: a fault that was not injected as meant would prove nothing."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator

from sitl.autopilot.codec import Decoder
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from tests.integration.relay import LOOPBACK, UdpRelay, pack, repacked
from tests.shared.beside import wait_until

TIMEOUT_S = 10.0


class Ends:
    """The autopilot's and the gate's socket, with a relay between them."""

    def __init__(self, relay: UdpRelay, autopilot: socket.socket, gate: socket.socket) -> None:
        self.relay, self._autopilot, self._gate = relay, autopilot, gate
        self._to_relay: tuple[str, int] | None = None
        self.came_from: tuple[str, int] | None = None

    def down(self, data: bytes) -> None:
        self._autopilot.sendto(data, (LOOPBACK, self.relay.port))

    def gate_hears(self) -> bytes:
        data, self.came_from = self._gate.recvfrom(65536)
        self._to_relay = self._to_relay or self.came_from
        return data

    def up(self, data: bytes) -> None:
        assert self._to_relay is not None
        self._gate.sendto(data, self._to_relay)

    def answer_to(self, address: tuple[str, int]) -> None:
        self._gate.sendto(b"answer", address)

    def autopilot_hears(self) -> bytes:
        return self._autopilot.recv(65536)

    def meet(self) -> None:
        """Until each knows where the other is."""
        self.down(heartbeat())
        assert self.gate_hears() == heartbeat()

    def wait_for_handled(self, count: int) -> None:
        """Until so many datagrams of the autopilot were passed on or lost: a socket's buffer has an end."""
        wait_until(lambda: self.relay.passed[0] + self.relay.lost[0] >= count)

    def gate_hears_nothing(self) -> bool:
        """Judged by a datagram that is sent after whatever must not come: order is kept on loopback."""
        self._gate.settimeout(0.2)
        try:
            self.gate_hears()
        except TimeoutError:
            return True
        finally:
            self._gate.settimeout(TIMEOUT_S)
        return False


@contextlib.contextmanager
def ends(lost_share: float = 0.0) -> Iterator[Ends]:
    with contextlib.ExitStack() as stack:
        autopilot, gate = (stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2))
        for end in (autopilot, gate):
            end.bind((LOOPBACK, 0))
            end.settimeout(TIMEOUT_S)
        relay = stack.enter_context(UdpRelay(gate.getsockname()[1], lost_share))
        yield Ends(relay, autopilot, gate)


def heartbeat(armed: bool = True, custom_mode: int = 7) -> bytes:
    base = m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (m.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    return pack(m.MAVLink_heartbeat_message(2, m.MAV_AUTOPILOT_PX4, base, custom_mode, 4, 3), (1, 1))


def position(north_m: float) -> bytes:
    return pack(m.MAVLink_local_position_ned_message(1000, north_m, 2.0, -1.5, 0.0, 0.0, 0.0), (1, 1), sequence=9)


def setpoint(forward_mps: float) -> bytes:
    numbers = (0.0, 0.0, 0.0, forward_mps, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.25)
    return pack(m.MAVLink_set_position_target_local_ned_message(5, 1, 1, 8, 0x5C7, *numbers), (1, 191))


def shifted(message: Message) -> list[bytes] | None:
    if message.get_type() != "LOCAL_POSITION_NED":
        return None
    message.x += 2.0
    return [repacked(message)]


def test_both_ways_bytes_pass_as_they_were() -> None:
    """Protects every flight of the matrix: without a fault the relay must not be one."""
    with ends() as link:
        link.meet()
        for data in (position(1.0), b"not MAVLink at all", heartbeat() + position(2.0)):
            link.down(data)
            assert link.gate_hears() == data
        for data in (setpoint(0.5), b"garbage"):
            link.up(data)
            assert link.autopilot_hears() == data
        assert (link.relay.passed, link.relay.lost) == ([4, 2], [0, 0])


def test_setpoints_commands_and_texts_are_noted_with_their_time_and_sender() -> None:
    """Protects the measured times: they are those of arrival, and a brake of the gate is told from the application."""
    stop = m.MAVLink_command_long_message(1, 1, m.MAV_CMD_DO_SET_MODE, 0, 1.0, 4.0, 3.0, 0.0, 0.0, 0.0, 0.0)
    with ends() as link:
        link.meet()
        before_s = time.monotonic()
        text = m.MAVLink_statustext_message(4, b"brake: depth_stale")
        link.up(setpoint(0.5) + setpoint(0.0) + pack(stop, (1, 192)) + pack(text, (1, 192)))
        link.autopilot_hears()
        after_s = time.monotonic()
        seen = link.relay.seen
        moving, resting = seen.setpoints()
        assert before_s <= moving.t_s <= after_s
        assert (moving.vx, moving.yaw_rate, moving.frame, moving.mask) == (0.5, 0.25, 8, 0x5C7)
        assert (moving.target, moving.sender, moving.passed, moving.stops) == ((1, 1), (1, 191), True, False)
        assert (resting.vx, resting.stops) == (0.0, False), "it still turns"
        (command,) = seen.commands(before_s)
        assert (command.command, command.params[:3], command.sender) == (176, (1.0, 4.0, 3.0), (1, 192))
        assert [(said.text, said.severity) for said in seen.texts()] == [("brake: depth_stale", 4)]
        assert seen.setpoints(after_s + 1e-6) == []
        assert seen.names["SET_POSITION_TARGET_LOCAL_NED"] == 2


def test_a_hook_changes_one_message_and_leaves_the_rest_of_the_datagram() -> None:
    """Protects faults that touch the pose only: heartbeats beside it, and who sent it, stay as they were."""
    with ends() as link:
        link.meet()
        link.relay.alter_down = shifted
        link.down(b"\x01\x02" + heartbeat() + position(1.0) + b"\x03")
        data = link.gate_hears()
        assert data.startswith(b"\x01\x02" + heartbeat())
        assert data.endswith(b"\x03")
        (changed,) = [found for found in Decoder().messages(data) if found.get_type() == "LOCAL_POSITION_NED"]
        header = changed.get_header()
        assert (changed.x, changed.y) == (3.0, 2.0)
        assert (header.srcSystem, header.srcComponent, header.seq) == (1, 1, 9)


def test_a_hook_drops_and_one_that_fails_changes_nothing_but_is_told() -> None:
    """Protects against a fault that was never injected because the test itself had one."""
    with ends() as link:
        link.meet()
        link.relay.alter_down = lambda message: [] if message.get_type() == "HEARTBEAT" else None
        heard = len(link.relay.seen.heartbeats())
        link.down(heartbeat())
        link.down(position(1.0))
        assert link.gate_hears() == position(1.0), "the heartbeat before it never came"
        assert len(link.relay.seen.heartbeats()) == heard

        def fails(_message: Message) -> list[bytes] | None:
            raise ZeroDivisionError

        link.relay.alter_down = fails
        link.down(position(1.0))
        assert link.gate_hears() == position(1.0)
        assert [type(error) for error in link.relay.errors] == [ZeroDivisionError]


def test_dead_cut_and_lossy_links_lose_what_they_should_and_still_note_the_setpoints() -> None:
    """Protects the faults of the link: what the gate sends into a dead one is still seen."""
    with ends() as link:
        link.meet()
        link.relay.dead = True
        link.down(position(1.0))
        link.up(setpoint(0.0))
        assert link.gate_hears_nothing()
        assert [seen.passed for seen in link.relay.seen.setpoints()] == [False]
        link.relay.dead, link.relay.dead_up = False, True
        link.up(setpoint(0.0))
        link.down(position(3.0))
        assert link.gate_hears() == position(3.0)
        wait_until(lambda: len(link.relay.seen.setpoints()) == 2)
        assert [seen.passed for seen in link.relay.seen.setpoints()] == [False, False]
        link.relay.dead_up = False
        link.relay.cut_for(0.3)
        link.down(position(1.0))
        assert link.gate_hears_nothing()
        time.sleep(0.2)
        link.down(position(2.0))
        assert link.gate_hears() == position(2.0)
    with ends(lost_share=0.2) as link:
        for count in range(1, 501):
            link.down(position(1.0))
            link.wait_for_handled(count)
    assert 50 <= link.relay.lost[0] <= 150, "0.2 of 500, and five standard deviations of that"


def test_it_speaks_as_the_autopilot_or_as_a_stranger() -> None:
    """Protects the faults that invent messages: they come from the address that they are meant to come from."""
    with ends() as link:
        link.meet()
        known = link.came_from
        link.relay.send_down(b"one")
        assert (link.gate_hears(), link.came_from) == (b"one", known)
        link.relay.send_up(b"two")
        assert link.autopilot_hears() == b"two"
        link.relay.speak_down(lambda: b"three", 0.01, as_stranger=True)
        assert [link.gate_hears(), link.gate_hears()] == [b"three", b"three"]
        assert link.came_from != known
        assert link.came_from is not None
        link.answer_to(link.came_from)
        wait_until(lambda: link.relay.stranger_received == 1)
        link.relay.speak_down(None)
