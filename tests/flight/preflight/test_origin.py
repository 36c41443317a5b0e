"""PX4 without GPS: an origin on the globe that it cannot place makes every landing fly to latitude 0, longitude 0."""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.autopilot.telemetry import Telemetry
from companion.config.settings import Settings
from companion.flight.events import EventEmitter, console
from companion.flight.preflight.origin import origin
from companion.flight.preflight.ready import until_ready
from companion.flight.preflight.result import CheckResult
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavCmd, MavResult
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
BOOTS_S = 6.0


class Bench:
    """An autopilot whose estimator is valid some seconds after its start, as PX4 was measured to be.

    Attributes:
        has_origin: whether one is set.
        feeds_ned: whether its odometry comes as LOCAL_NED, with which it can place an origin.
        takes_origin: whether it takes one that it is told.
        valid: whether its estimator ever knows where it is.
        told: how often it was told one.
        others_origin_s: how long after its start somebody else sets one.
        lines: what the operator was told.
    """

    def __init__(self, kind: AutopilotKind = PX4, frame: str = "local_ned", gps: bool = False) -> None:
        self.clock = HandClock()
        self.link = FakeLink(self.clock, kind)
        self.settings = Settings.model_validate({"autopilot": {"gps": gps, "odometry_frame": frame}})
        self.telemetry = Telemetry(self.link, self.clock, self.settings)
        self.has_origin = gps
        self.feeds_ned = frame == "local_ned"
        self.takes_origin = True
        self.valid = True
        self.told = 0
        self.others_origin_s = math.inf
        self.lines: list[str] = []
        self.link.on_send = self._hears
        self.link.results[MavCmd.REQUEST_MESSAGE] = MavResult.DENIED
        self._began_s = self.clock.now_s()
        self._passed_s = 0.0
        self.clock.pass_by = self._live

    def _hears(self, name: str, fields: dict[str, Any]) -> None:
        if name == "SET_GPS_GLOBAL_ORIGIN":
            self.told += 1
            assert (fields["target_system"], fields["latitude"] != 0) == (1, True)
            self.has_origin |= self.takes_origin

    def _live(self, by_s: float) -> None:
        """Time passes, in which it sends what it sends once a second."""
        self.clock.advance(by_s)
        self._passed_s += by_s
        if self._passed_s < 0.99:
            return
        self._passed_s = 0.0
        self.has_origin |= self.clock.now_s() - self._began_s > self.others_origin_s
        known = self.valid and self.clock.now_s() - self._began_s > BOOTS_S
        estimator = "ESTIMATOR_STATUS" if self.link.kind is PX4 else "EKF_STATUS_REPORT"
        self.link.deliver("HEARTBEAT", {"custom_mode": 0, "base_mode": 0})
        self.link.deliver(estimator, {"flags": 511 - 128 if known else 37})
        if self.has_origin:
            self.link.results[MavCmd.REQUEST_MESSAGE] = MavResult.ACCEPTED
            self.link.deliver("GPS_GLOBAL_ORIGIN", {"latitude": 1, "longitude": 1, "altitude": 0})
        if self.has_origin and self.feeds_ned and known:
            self.link.deliver("GLOBAL_POSITION_INT", {"lat": 1, "lon": 1})

    async def ready(self) -> float:
        """Wait until it is ready; how long that took, in s."""
        began_s = self.clock.now_s()
        events = EventEmitter(console(self.lines.append))
        await until_ready(self.link, self.telemetry, self.settings.autopilot, self.clock, events)
        return self.clock.now_s() - began_s

    async def look(self) -> tuple[CheckResult, ...]:
        """The check, as it is made after the waiting."""
        return await origin(self.link, lambda: self.telemetry.state(self.clock.now_s()), self.settings.autopilot)

    async def result(self) -> CheckResult:
        await self.ready()
        await self.clock.sleep(3.0)
        (result,) = await self.look()
        return result


async def test_px4_that_is_fed_local_ned_is_told_an_origin_and_passes() -> None:
    """Protects hold, which needs one."""
    bench = Bench()
    result = await bench.result()
    assert bench.told == 1
    assert result.ok
    assert "set" in result.found


async def test_px4_that_is_fed_local_frd_is_told_none_and_passes_with_a_warning() -> None:
    """Protects every landing: with one it would fly off at 4 m/s."""
    bench = Bench(frame="local_frd")
    result = await bench.result()
    assert bench.told == 0
    assert result.ok
    assert "every hold will be a landing" in result.found


async def test_an_origin_of_a_ground_station_is_refused_where_it_cannot_be_placed() -> None:
    bench = Bench(frame="local_frd")
    bench.has_origin = True
    result = await bench.result()
    assert result.failed
    assert result.found == "one is set, but no GLOBAL_POSITION_INT comes"
    assert "0°/0°" in result.reason
    assert "reboot the autopilot and let nobody set an origin" in result.fix


async def test_odometry_in_another_frame_than_the_settings_say_is_refused() -> None:
    """LOCAL_FRD from the tracker's program, local_ned in the settings: our own origin would be the deadly one."""
    bench = Bench()
    bench.feeds_ned = False
    result = await bench.result()
    assert result.failed
    assert "no GLOBAL_POSITION_INT" in result.found
    assert "LOCAL_NED" in result.fix
    assert "local_frd" in result.fix


async def test_an_origin_that_is_not_taken_is_told_again_and_refused() -> None:
    bench = Bench()
    bench.takes_origin = False
    result = await bench.result()
    assert bench.told > 3
    assert result.failed
    assert "not taken" in result.found


async def test_an_origin_that_somebody_has_set_is_left_alone() -> None:
    """A second one with another altitude shifts the height at once, by 1.39 m where it was measured."""
    bench = Bench()
    bench.has_origin = True
    await bench.clock.sleep(2.0)
    result = await bench.result()
    assert bench.told == 0
    assert result.ok


async def test_an_origin_that_somebody_is_just_setting_is_waited_for() -> None:
    """The tracker's program or a ground station that starts together with us, and is heard once a second."""
    bench = Bench()
    bench.others_origin_s = 2.5
    result = await bench.result()
    assert bench.told == 0
    assert result.ok


@pytest.mark.parametrize("frame", ["local_ned", "local_frd"])
async def test_what_cannot_be_asked_is_not_known_to_be_safe(frame: str) -> None:
    """Silence is no denial."""
    bench = Bench(frame=frame)
    bench.takes_origin = False
    bench.link.results[MavCmd.REQUEST_MESSAGE] = None
    assert (await bench.result()).failed
    bench.link.results[MavCmd.REQUEST_MESSAGE] = MavResult.ACCEPTED
    result = await bench.result()
    assert result.failed
    assert result.found == "one is set, but was not heard"


@pytest.mark.parametrize(("kind", "gps"), [(PX4, True), (ARDUPILOT, True), (ARDUPILOT, False)])
async def test_others_are_not_asked(kind: AutopilotKind, gps: bool) -> None:
    """ArduPilot lands where it is; with GPS the origin is the autopilot's own."""
    bench = Bench(kind, gps=gps)
    await bench.ready()
    assert await bench.look() == ()
    assert bench.told == (0 if gps else 1)


async def test_it_waits_for_position_and_origin_and_no_longer_than_it_must() -> None:
    """Protects the start of an autopilot that was just switched on, and the operator from silence."""
    bench = Bench()
    took_s = await bench.ready()
    assert BOOTS_S < took_s < BOOTS_S + 3.0
    assert bench.lines == ["waiting for the autopilot's position, up to 60 s"]
    bench = Bench()
    bench.feeds_ned = False
    assert await bench.ready() < BOOTS_S + 6.0, "a global position that has not come after 5 s does not come"
    bench = Bench()
    bench.valid = False
    assert 59.0 < await bench.ready() < 62.0


async def test_a_link_that_is_gone_ends_no_waiting() -> None:
    """The check of the link says it better than an error would."""
    bench = Bench()
    bench.link.gone = True
    assert 59.0 < await bench.ready() < 62.0
