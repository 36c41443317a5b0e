"""Vehicles that hear each other over sessions of Zenoh, and what becomes of them when they do not any more."""

from __future__ import annotations

import contextlib
import select
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.clock import MonotonicClock
from companion.config.link import LinkSettings
from companion.config.load import load
from companion.config.vary import vary
from companion.control.fleet import Report
from companion.flight.company import Company
from companion.link.authority import Authority
from companion.link.certificates import Certificates
from companion.link.fleet_messages import FleetMessage
from companion.link.session import close_session, open_session
from companion.link.vehicle.fleet_guard import FleetGuard
from companion.link.vehicle.fleet_post import MOST_UNREAD_BYTES
from companion.link.vehicle.pipe import Kind, pair, receive, send, unread_bytes
from companion.link.vehicle.process import LinkProcess
from companion.link.wire import fleet_topic
from companion.model import Pose
from companion.pipeline import Explorer
from sitl.launch.processes import free_tcp_port, free_udp_ports
from tests.link.exchange import Mine
from tests.link.rig import BadNetwork, until

STARTS = {1: (10.0, 5.0, 0.15, 0.0), 2: (12.0, 5.0, 0.15, 1.5), 3: (11.0, 7.0, 0.15, 3.0)}
"""All within d_r."""
AT = Pose(0.0, 0.0, 0.0, 1.5, 0.0)
ALONE_M = 1.5


class Member:
    """The process of the link in a thread, and the company of one vehicle at the other end of its socket pair.

    Args:
        number: of it.
        mine: whose map it has.
        settings: of its link.

    Attributes:
        company: of it.
        endpoint: where it listens.
        reads: whether it takes what comes.
        tells: what it tells in the place of what is true.
        end: of the socket pair, to the process.
    """

    def __init__(self, number: int, mine: Mine, **settings: Any) -> None:
        self._clock = MonotonicClock()
        flight = load(None, "flight").settings
        values = {"fleet.number": number, "fleet.start_pose": STARTS[number], "link.enabled": True}
        own = vary(flight, values, lambda name: name)
        self.company = Company(own, Explorer(own, np.random.default_rng(number)), self._clock)
        self.reads = True
        self.tells: bytes | None = None
        self.endpoint = settings["listen"][0]
        link = LinkSettings.model_validate({"enabled": True, "name": f"drone{number}", **settings})
        self.end, theirs = pair()
        self._process = LinkProcess(theirs, link, mine.folder / "map.journal", number)
        self._thread = threading.Thread(target=self._process.run, daemon=True)
        self._thread.start()

    def step(self) -> None:
        """One moment of a flight at its start pose: tell, and hear."""
        now_s = self._clock.now_s()
        self.company.see(now_s, replace(AT, t_s=now_s), ALONE_M, flies=True)
        message = self.tells or self.company.message(with_ground=False)
        assert message is not None
        send(self.end, Kind.FLEET, message)
        while self.reads and select.select([self.end], [], [], 0.0)[0]:
            packet = receive(self.end)
            if packet is None:
                return
            kind, data = packet
            if kind is Kind.FLEET:
                self.company.on_message(data)
            elif kind is Kind.FLEET_REFUSED:
                count, _, why = data.decode().partition(" ")
                self.company.on_refused(int(count), why)

    @property
    def height_m(self) -> float | None:
        """Its layer now."""
        return self.company.clearance(self._clock.now_s()).height_m

    def close(self) -> None:
        self.end.close()
        self._thread.join(5.0)
        self._process.close()


@pytest.fixture
def mine(tmp_path: Path) -> Mine:
    made = Mine(tmp_path / "vehicle")
    made.grow()
    return made


@contextlib.contextmanager
def members(mine: Mine, count: int, certificates: Path | None = None) -> Iterator[list[Member]]:
    """So many vehicles; each connects to those before it."""
    form, found = "tcp" if certificates is None else "tls", list[Member]()
    with contextlib.ExitStack() as stack:
        for number in range(1, count + 1):
            more = {} if certificates is None else {"certificates": str(certificates / f"drone{number}")}
            before = [one.endpoint for one in found]
            listen = [f"{form}/127.0.0.1:{free_tcp_port()}"]
            found.append(Member(number, mine, listen=listen, connect=before, **more))
            stack.callback(found[-1].close)
        yield found


def fly(found: list[Member], holds: Callable[[], object]) -> None:
    """Until something holds."""

    def stepped() -> object:
        for one in found:
            one.step()
        return holds()

    until(stepped)


def hear_each_other(found: list[Member]) -> bool:
    return all(len(one.company.others()) == len(found) - 1 for one in found)


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    made = Authority.make(tmp_path / "authority")
    for number in (1, 2, 3):
        made.issue(f"drone{number}", "vehicle", tmp_path / f"drone{number}", number)
    made.issue("bob", "watch", tmp_path / "bob")
    return tmp_path


@pytest.mark.parametrize("is_signed", [False, True], ids=["loopback", "certificates"])
def test_three_hear_each_other_and_take_their_layers(is_signed: bool, mine: Mine, keys: Path) -> None:
    """Each pair over a connection of its own: nobody forwards."""
    with members(mine, 3, keys if is_signed else None) as found:
        fly(found, lambda: hear_each_other(found))
        assert [one.height_m for one in found] == [2.25, 1.5, 0.75]
        assert [one.company.refused for one in found] == [0, 0, 0]
        one = found[0].company.others()[2]
        assert (one.x_m, one.y_m) == pytest.approx((12.0, 5.0))


def test_a_third_lost_and_an_outage_leave_the_layers_and_they_hear_each_other_again(mine: Mine, keys: Path) -> None:
    """Over QUIC through a relay that loses three of ten packets, and then all."""
    (port,) = free_udp_ports(1)
    with contextlib.ExitStack() as stack:
        network = stack.enter_context(BadNetwork(port, 0.3))
        found = []
        for number, listen, connect in ((1, port, []), (2, free_udp_ports(1)[0], [f"quic/127.0.0.1:{network.port}"])):
            certificates = str(keys / f"drone{number}")
            listens = [f"quic/127.0.0.1:{listen}"]
            found.append(Member(number, mine, listen=listens, connect=connect, certificates=certificates))
            stack.callback(found[-1].close)
        fly(found, lambda: hear_each_other(found))
        network.silent = True
        silent_s = time.monotonic() + 1.2
        fly(found, lambda: time.monotonic() > silent_s)
        assert all(_age_s(one) > 1.0 for one in found), "stale"
        assert [one.height_m for one in found] == [2.0, 1.0]
        network.silent = False
        fly(found, lambda: all(_age_s(one) < 0.5 for one in found))
        assert [one.height_m for one in found] == [2.0, 1.0]
        assert network.lost > 10


def _age_s(one: Member) -> float:
    (other,) = one.company.others().values()
    return time.monotonic() - other.t_s


def test_silence_keeps_the_layers(mine: Mine) -> None:
    """Two of three are gone, with their links; the one that is left keeps its layer, and theirs stay reserved."""
    with members(mine, 3) as found:
        fly(found, lambda: hear_each_other(found))
        for lost in (found[0], found[2]):
            lost.close()
        (left,) = found[1:2]
        for _ in range(20):
            left.step()
        later_s = time.monotonic() + 60.0
        left.company.see(later_s, replace(AT, t_s=later_s), ALONE_M, flies=True)
        assert left.company.clearance(later_s).height_m == 1.5, "what was heard is a minute old"
        assert sorted(left.company.others()) == [1, 3]


def test_forged_numbers_are_refused_and_counted(mine: Mine, keys: Path) -> None:
    """By who only watches, and by another vehicle: both are in the network, and the layers stay as they are."""
    with members(mine, 2, keys) as found:
        fly(found, lambda: hear_each_other(found))
        one = found[0]
        far = FleetMessage(2, 10**6, Report(time.monotonic(), 900.0, 0.0, 0.0)).encode()
        for forger in ("bob", "drone3"):
            before, given = one.company.refused, Certificates(keys / forger)
            with forging(one.endpoint, given) as session:
                unsigned = FleetGuard("drone2", 2, "f" * 16, None)
                signed = FleetGuard("drone2", 2, "e" * 16, given)
                for guard in (unsigned, signed):
                    session.put(fleet_topic("drone2"), guard.sealed(far, 0.0))
                fly(found, partial(_has_refused, one, before + 2))
        assert one.company.others()[2].x_m == pytest.approx(12.0)
        assert [vehicle.height_m for vehicle in found] == [2.0, 1.0]
        # A vehicle that says another number than its certificate does.
        claimed = FleetMessage(1, 10**6, Report(time.monotonic(), 900.0, 0.0, 0.0)).encode()
        before = one.company.refused
        found[1].tells = claimed
        fly(found, lambda: one.company.refused > before)
        assert sorted(one.company.others()) == [2]


def _has_refused(one: Member, count: int) -> bool:
    return one.company.refused >= count


@contextlib.contextmanager
def forging(endpoint: str, certificates: Certificates) -> Iterator[Any]:
    session = open_session([], [endpoint], certificates)
    try:
        until(lambda: session.info.peers_zid())
        yield session
    finally:
        close_session(session)


def test_an_application_that_does_not_read_gets_the_newest_afterwards(mine: Mine) -> None:
    """Nothing piles up, there is room for an order all the time, and the newest is not lost."""
    with members(mine, 2) as found:
        fly(found, lambda: hear_each_other(found))
        one, two = found
        one.reads = False
        sent = 0
        while sent < 400:
            sent += 1
            send(two.end, Kind.FLEET, FleetMessage(2, sent, Report(time.monotonic(), 12.0 + sent, 0.0, 0.0)).encode())
            time.sleep(0.001)
        last = FleetMessage(2, 10**6, Report(time.monotonic(), 777.0, 0.0, 0.0)).encode()
        send(two.end, Kind.FLEET, last)
        assert unread_bytes(one._process._end) < 2 * MOST_UNREAD_BYTES
        one.reads = True
        fly([one], lambda: one.company.others()[2].x_m == 777.0)
