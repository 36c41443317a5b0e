"""One vehicle among others, over what carries bytes: where they are in each other's eyes, and who waits for whom."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.config.load import load
from companion.config.settings import Settings
from companion.config.vary import vary
from companion.control.fleet import MOST_VEHICLES, Report
from companion.errors import InputError
from companion.flight.company import Company, frame_at, in_company
from companion.link.fleet_messages import FleetMessage, decode
from companion.link.vehicle.client import FleetListener
from companion.model import Pose
from companion.pipeline import Explorer
from tests.shared.beside import until
from tests.shared.clocks import HandClock

STARTS = {1: (10.0, 5.0, 0.15, 0.0), 2: (12.0, 5.0, 0.15, math.pi / 2.0)}
"""2 m apart; 2 points north, and its own frame is another one."""
OWN = {1: Pose(0.0, 0.0, 0.0, 0.15, 0.0), 2: Pose(0.0, 3.0, -4.0, 1.15, 0.4)}
"""Where they stand by their own autopilots."""


def settings_of(number: int) -> Settings:
    base = load(None, "flight").settings
    values = {"fleet.number": number, "fleet.start_pose": STARTS[number], "link.enabled": True}
    return vary(base, values, lambda name: name)


def company_of(number: int, clock: HandClock) -> Company:
    settings = settings_of(number)
    return Company(settings, Explorer(settings, np.random.default_rng(number)), clock)


def stand(company: Company, t_s: float, up_m: float = 0.0, flies: bool = True) -> None:
    """It is where it started, so much higher."""
    own = OWN[company.own_id]
    company.see(t_s, replace(own, t_s=t_s, z_m=own.z_m + up_m), up_m or None, flies)


def told(company: Company, with_ground: bool = False) -> bytes:
    message = company.message(with_ground)
    assert message is not None
    return message


def test_the_frame_is_that_in_which_it_stands_at_its_start_pose() -> None:
    """Whatever its autopilot takes for its origin and for north."""
    frame = frame_at(STARTS[2], OWN[2])
    assert frame.shared(3.0, -4.0, 1.15) == pytest.approx((12.0, 5.0, 0.15))
    ahead = frame.shared(3.0 + math.cos(0.4), -4.0 + math.sin(0.4), 1.15)
    assert ahead == pytest.approx((12.0, 6.0, 0.15))
    assert frame.own(*ahead) == pytest.approx((3.0 + math.cos(0.4), -4.0 + math.sin(0.4), 1.15))


def test_it_tells_where_it_is_in_the_shared_frame() -> None:
    """Before it knows that, nothing; on the ground it may be carried about, in the air its frame stays."""
    company = company_of(2, HandClock(0.0))
    assert company.message(with_ground=True) is None
    stand(company, 1.0, flies=False)
    company.see(2.0, Pose(2.0, 50.0, 50.0, 0.15, 0.0), None, flies=False)
    stand(company, 3.0, flies=True)
    stand(company, 4.0, up_m=1.35)
    report = decode(told(company)).report
    # It was put down elsewhere after it had stood at its start pose: that is where it stands now.
    assert report.z_m == pytest.approx(0.15 + 1.35 + 1.0, abs=1e-9)
    assert (report.height_m, report.flies) == (1.35, True)


def two_in_the_air(clock: HandClock) -> tuple[Company, Company]:
    """Two that stood beside each other, and fly at one height."""
    one, two = company_of(1, clock), company_of(2, clock)
    for company in (one, two):
        stand(company, 100.0, flies=False)
        stand(company, 100.0, up_m=1.35)
    return one, two


def test_two_beside_each_other_wait_and_go_to_their_layers() -> None:
    """Over bytes and two frames: 2 m apart at one height, the smaller number is to go up."""
    clock = HandClock(100.0)
    one, two = two_in_the_air(clock)
    one.on_message(told(two))
    two.on_message(told(one))
    up, down = one.clearance(100.0), two.clearance(100.0)
    assert up.holds
    assert down.holds
    assert (up.height_m, down.height_m) == (2.0, 1.0)
    ((east_m, north_m),) = up.beside_m
    assert (east_m, north_m) == pytest.approx((2.0, 0.0))
    # 2 points west by its own frame when it points at 1 in the shared one.
    assert math.cos(two.shared_yaw_rad(replace(OWN[2], yaw_rad=0.4 + math.pi / 2.0)) - math.pi) == pytest.approx(1.0)


def test_a_message_that_was_long_on_its_way_is_old() -> None:
    """Stale is not fresh: another computer's clock stands elsewhere, and a queue gives back what was sent long ago."""
    clock, theirs_s = HandClock(100.0), 5000.0
    one = company_of(1, clock)
    stand(one, 100.0, flies=False)
    stand(one, 100.0, up_m=1.35)
    near = FleetMessage(2, 1, Report(theirs_s, 12.0, 5.0, 1.5, 1.5)).encode()
    one.on_message(near)
    late = FleetMessage(2, 2, Report(theirs_s + 1.0, 30.0, 5.0, 1.5, 1.5)).encode()
    clock.advance(4.0)
    one.on_message(late)
    # Sent 1 s after the first, which took no time at all by what is known.
    report = one.clearance(104.0)
    assert not report.holds
    assert [round(seen.t_s, 3) for seen in one.others().values()] == [101.0]


def test_what_is_none_of_theirs_is_refused_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    """Garbage, its own number from another one, and one vehicle too many; one line in the log, not one for each."""
    one = company_of(1, HandClock(0.0))
    stand(one, 0.0)
    one.on_message(b"garbage")
    one.on_message(FleetMessage(1, 1, Report(0.0, 0.0, 0.0, 0.0)).encode())
    for number in range(2, MOST_VEHICLES + 4):
        one.on_message(FleetMessage(number, 1, Report(0.0, 500.0, 0.0, 0.0)).encode())
    assert one.refused == 4
    assert len(caplog.records) == 1


def test_a_vehicle_that_was_started_anew_is_heard() -> None:
    """Its clock begins again: what was known of it must not shut it out."""
    clock = HandClock(100.0)
    one = company_of(1, clock)
    stand(one, 100.0)
    for t_s, x_m in ((5000.0, 30.0), (10.0, 12.0), (10.2, 12.0), (10.4, 12.0), (10.6, 12.0)):
        one.on_message(FleetMessage(2, 1, Report(t_s, x_m, 5.0, 1.5, 1.5)).encode())
        clock.advance(0.2)
    assert [seen.x_m for seen in one.others().values()] == [12.0]


def test_who_has_landed_says_so() -> None:
    """Its layer is free from then on: silence alone would keep it."""
    clock = HandClock(100.0)
    one, two = two_in_the_air(clock)
    one.on_message(told(two))
    assert one.clearance(100.0).height_m == 2.0
    clock.advance(60.0)
    stand(one, 160.0, up_m=1.35)
    assert one.clearance(160.0).height_m == 2.0
    two.landed()
    one.on_message(told(two))
    assert one.clearance(160.0).height_m == 1.5
    summary = one.summary()
    assert (summary["number"], summary["heard"], summary["refused"]) == (1, [2], 0)
    assert summary["frame"] is not None


def test_a_pose_that_is_no_number_tells_nothing_new() -> None:
    """NaN never leaves: what was known before is what is told, and grows old."""
    one = company_of(1, HandClock(0.0))
    stand(one, 1.0)
    one.see(2.0, replace(OWN[1], t_s=2.0, x_m=math.nan), 1.0, flies=True)
    assert decode(told(one)).report.t_s == 1.0


class Others:
    """In the place of the link: what is told, and whom to tell."""

    def __init__(self) -> None:
        self.fleet: FleetListener | None = None
        self.told: list[tuple[bytes, bool]] = []

    def listener(self) -> FleetListener | None:
        return self.fleet

    def tell_others(self, message: bytes, *, with_ground: bool) -> None:
        self.told.append((message, with_ground))


async def test_alone_there_is_no_company() -> None:
    """Nothing is opened, nothing is told."""
    settings, others = load(None, "flight").settings, Others()
    async with in_company(settings, Explorer(settings, np.random.default_rng(1)), HandClock(), others) as company:
        assert company is None
        assert others.listener() is None


async def test_it_is_told_while_the_block_lasts() -> None:
    """Where it is five times a second, the ground each two seconds; what the link refuses is in the summary."""
    clock, others = HandClock(), Others()
    settings = settings_of(1)
    async with in_company(settings, Explorer(settings, np.random.default_rng(1)), clock, others) as company:
        assert company is not None
        assert others.listener() is company
        stand(company, clock.now_s(), flies=False)
        await until(lambda: len(others.told) >= 20, "messages of four seconds")
        company.on_refused(3, "it is not signed")
    assert others.listener() is None
    assert [with_ground for _, with_ground in others.told[:20]].count(True) == 2
    assert company.summary()["refused"] == 3


def test_a_number_without_a_link_is_refused() -> None:
    """It would fly among others that it neither hears nor is heard by; both settings are named."""
    with pytest.raises(InputError, match=r"fleet.number = 2, but link.enabled = false"):
        vary(load(None, "flight").settings, {"fleet.number": 2}, lambda name: name)
