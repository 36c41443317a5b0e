"""One vehicle among others: what it tells them, what it makes of what they tell, and how it stays apart from them.

Nothing of the flight waits for anybody. What comes from outside is decoded, bounded and noted; what cannot be sent is
lost, and the next message says it anew.
"""

from __future__ import annotations

import logging
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import asdict, replace
from typing import Protocol

from companion.clock import Clock
from companion.clock.one_way import OneWay
from companion.config.settings import Settings
from companion.control.fleet import MOST_VEHICLES, Report
from companion.control.separation import Back, Clearance
from companion.control.sharing import Frame, Sharing
from companion.flight.tasks import background
from companion.link.fleet_messages import FleetMessage, FleetMessageError, decode
from companion.link.vehicle.client import FleetListener
from companion.model import Pose, wrap_rad
from companion.pipeline import Explorer, fleet_of

REPORT_PERIOD_S, SHARING_PERIOD_S = 0.2, 2.0
"""Time between two messages, and between two that tell of the ground."""

_log = logging.getLogger(__name__)


class Exchange(Protocol):
    """What carries messages between vehicles.

    Attributes:
        fleet: is given what the others tell.
    """

    fleet: FleetListener | None

    def tell_others(self, message: bytes, *, with_ground: bool) -> None:
        """To all others; lost where that cannot be done at once."""
        ...


class Company:
    """One vehicle among others.

    Args:
        settings: the whole configuration; `fleet.number` is set.
        explorer: what flies it.
        clock: stamps what arrives.
    """

    def __init__(self, settings: Settings, explorer: Explorer, clock: Clock) -> None:
        assert settings.fleet.number is not None  # noqa: S101 - asked for by whoever makes one
        self.own_id: int = settings.fleet.number
        """Its number in the fleet."""
        self.refused = 0
        """Messages that were none, or not to be believed."""
        self._start = settings.fleet.start_pose
        self._explorer = explorer
        self._clock = clock
        self._fleet, self._separation = fleet_of(settings, self.own_id)
        self._clocks: dict[int, OneWay] = {}
        self._frame: Frame | None = None
        self._sharing: Sharing | None = None
        self._report: Report | None = None
        self._flies = False
        self._number = 0

    def see(self, now_s: float, pose: Pose, height_m: float | None, flies: bool) -> None:
        """Where this vehicle is; once a tick. Where it first stands is its start pose in the shared frame.

        Args:
            now_s: now.
            pose: in its own frame.
            height_m: above the ground; None where it is not known.
            flies: whether it is in the air, or about to be.
        """
        if not pose.is_finite:
            return
        if self._frame is None or not (flies or self._flies):
            # It may be carried about until it takes off.
            self._frame = frame_at(self._start, pose)
        if flies and self._sharing is None:
            navigator = self._explorer.navigator
            self._sharing = Sharing(self.own_id, self._frame, navigator.known_ground, navigator.choice)
        self._flies = flies
        at_m = self._frame.shared(pose.x_m, pose.y_m, pose.z_m)
        self._report = self._separation.report(now_s, at_m, height_m, flies)

    @property
    def frame(self) -> Frame | None:
        """Where its own frame lies in the shared one; None before it is known where it stands."""
        return self._frame

    def landed(self) -> None:
        """It stands on the ground and has no layer any more: the others are told, as long as this one still speaks."""
        self._flies = False
        if self._report is not None:
            self._report = replace(self._report, t_s=self._clock.now_s(), flies=False)

    def clearance(self, now_s: float) -> Clearance:
        """What the vehicle may do now."""
        return self._separation.clearance(now_s)

    def others(self) -> dict[int, Report]:
        """The newest report of every other vehicle, by this vehicle's clock."""
        return self._fleet.others()

    def summary(self) -> dict[str, object]:
        """For `summary.json`: its number, where its map lies in the shared frame, who was heard, what was refused."""
        frame = None if self._frame is None else asdict(self._frame)
        return {"number": self.own_id, "frame": frame, "heard": sorted(self.others()), "refused": self.refused}

    def beneath(self) -> tuple[Back, ...]:
        """The vehicles that this one may be above."""
        return self._separation.beneath()

    def shared_yaw_rad(self, pose: Pose) -> float:
        """The heading in the shared frame."""
        return pose.yaw_rad if self._frame is None else wrap_rad(pose.yaw_rad + self._frame.yaw_rad)

    def on_message(self, data: bytes) -> None:
        """Whatever came from outside."""
        try:
            message = decode(data)
        except FleetMessageError as error:
            self._refuse(str(error))
            return
        if message.vehicle == self.own_id:
            self._refuse(f"another vehicle has the number {self.own_id} of this one")
            return
        received_s = self._clock.now_s()
        heard = self._clocks.get(message.vehicle)
        if heard is None:
            if len(self._clocks) >= MOST_VEHICLES:
                self._refuse(f"vehicle {message.vehicle} is one too many")
                return
            heard = self._clocks[message.vehicle] = OneWay()
        report = message.report
        if not heard.add(report.t_s, received_s):
            # It was started anew.
            heard = self._clocks[message.vehicle] = OneWay()
            heard.add(report.t_s, received_s)
        sent_s = min(received_s, heard.to_local_s(report.t_s))
        at = Report(sent_s, report.x_m, report.y_m, report.z_m, report.height_m, report.flies)
        self._fleet.on_report(message.vehicle, at)
        if self._sharing is not None:
            self._sharing.on_claim(message.vehicle, message.claim, sent_s)
            if message.news is not None:
                self._sharing.learn(message.news)

    def message(self, with_ground: bool) -> bytes | None:
        """What it tells the others now; None before it knows where it is."""
        report, sharing = self._report, self._sharing
        if report is None:
            return None
        self._number += 1
        claim = news = None
        if sharing is not None and self._flies:
            claim = sharing.claim(report.t_s)
            news = sharing.news() if with_ground else None
        return FleetMessage(self.own_id, self._number, report, claim, news).encode()

    async def run(self, exchange: Exchange) -> None:
        """Tell the others, until cancelled."""
        next_ground_s = -math.inf
        while True:
            now_s = self._clock.now_s()
            with_ground = now_s >= next_ground_s
            if with_ground:
                next_ground_s = now_s + SHARING_PERIOD_S
            if self._sharing is not None:
                self._sharing.look(now_s)
            message = self.message(with_ground)
            if message is not None:
                exchange.tell_others(message, with_ground=with_ground)
            await self._clock.sleep(REPORT_PERIOD_S)

    def on_refused(self, count: int, why: str) -> None:
        """So many messages did not come so far: nobody has proven that they are of a vehicle, and of now."""
        if self.refused == 0:
            _log.warning("a message of the fleet was refused: %s; further ones are only counted", why)
        self.refused += count

    def _refuse(self, why: str) -> None:
        self.on_refused(1, why)


def frame_at(start: tuple[float, float, float, float], pose: Pose) -> Frame:
    """The frame of a vehicle that stands at ``start`` (x, y, z in m and yaw in rad) by the frame that is shared.

    Args:
        start: where it stands, and where it points.
        pose: the same in its own frame.
    """
    yaw_rad = wrap_rad(start[3] - pose.yaw_rad)
    turned_x_m, turned_y_m, turned_z_m = Frame(yaw_rad=yaw_rad).shared(pose.x_m, pose.y_m, pose.z_m)
    return Frame(start[0] - turned_x_m, start[1] - turned_y_m, start[2] - turned_z_m, yaw_rad)


@asynccontextmanager
async def in_company(
    settings: Settings, explorer: Explorer, clock: Clock, exchange: Exchange | None
) -> AsyncIterator[Company | None]:
    """The other vehicles, who hear of this one while the block lasts; None where it flies alone.

    Args:
        settings: the whole configuration.
        explorer: what flies this vehicle.
        clock: stamps what arrives.
        exchange: carries the messages; None where there is no link, and so no other vehicle.
    """
    if settings.fleet.number is None or exchange is None:
        yield None
        return
    company = Company(settings, explorer, clock)
    exchange.fleet = company
    try:
        async with background(company.run(exchange)):
            yield company
    finally:
        exchange.fleet = None
