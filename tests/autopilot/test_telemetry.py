"""Telemetry on a link without an autopilot: poses by the autopilot's clock, the state, and asking again."""

from __future__ import annotations

import asyncio
import math
import unittest
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.autopilot.message_rates import wanted_hz
from companion.autopilot.telemetry import SAID_TWICE_S, TEXTS, Telemetry
from companion.autopilot.vehicle_state import VehicleState
from companion.config.settings import Settings
from companion.mavlink.firmware import AutopilotKind
from companion.mavlink.ids import MavChargeState, MavCmd
from companion.model import Pose
from tests.autopilot.fake_link import FakeLink
from tests.shared.clocks import HandClock

BOOTED_S = 900.0
"""When the autopilot was switched on, on our clock."""
PX4_OFFBOARD = 6 << 16
PX4_POSITION = 3 << 16
ESTIMATOR_GOOD = 1 | 2 | 4 | 8 | 32


class Autopilot:
    """An autopilot that flies north at 1 m/s and turns, seen through a link with a delay."""

    def __init__(self, kind: AutopilotKind = AutopilotKind.PX4, settings: Settings | None = None) -> None:
        self.clock = HandClock()
        self.link = FakeLink(self.clock, kind)
        self.telemetry = Telemetry(self.link, self.clock, settings or Settings())
        self.booted_s = BOOTED_S
        self.delay_s = 0.01
        self.rate = 1.0
        """Seconds of its clock in one of ours."""
        self.answers_time = True
        self.link.on_send = self._heard

    def _heard(self, name: str, fields: dict[str, Any]) -> None:
        if name == "TIMESYNC" and self.answers_time:
            answer = round(self.boot_s(self.clock.now_s() + self.delay_s) * 1e9)
            self.clock.advance(2 * self.delay_s)
            self.link.deliver("TIMESYNC", {"tc1": answer, "ts1": fields["ts1"]})

    def boot_s(self, at_s: float) -> float:
        return self.rate * (at_s - self.booted_s)

    def runs(self, rate: float) -> None:
        """From now on its clock runs at this rate."""
        now_s = self.clock.now_s()
        self.booted_s = now_s - self.boot_s(now_s) / rate
        self.rate = rate

    def boot_ms(self) -> int:
        return math.floor(1000.0 * self.boot_s(self.clock.now_s() - self.delay_s))

    def attitude(self, **changed: float) -> None:
        fields = {"roll": 0.1, "pitch": 0.05, "yaw": 0.3, "rollspeed": 0.0, "pitchspeed": 0.0, "yawspeed": 0.4}
        self.link.deliver("ATTITUDE", {"time_boot_ms": self.boot_ms()} | fields | changed)

    def position(self, **changed: float) -> None:
        north_m = self.clock.now_s() - self.delay_s - BOOTED_S
        fields = {"x": north_m, "y": 2.0, "z": -1.5, "vx": 1.0, "vy": 0.0, "vz": -0.1}
        self.link.deliver("LOCAL_POSITION_NED", {"time_boot_ms": self.boot_ms()} | fields | changed)

    def heartbeat(self, custom_mode: int = PX4_OFFBOARD, armed: bool = True) -> None:
        self.link.deliver("HEARTBEAT", {"base_mode": 129 if armed else 1, "custom_mode": custom_mode, "autopilot": 12})

    def tells(self, landed_state: int) -> None:
        """All that its state is read from."""
        self.heartbeat()
        self.link.deliver("SYS_STATUS", {"battery_remaining": 61})
        self.link.deliver("EXTENDED_SYS_STATE", {"landed_state": landed_state})
        self.link.deliver("ESTIMATOR_STATUS", {"flags": ESTIMATOR_GOOD})

    def fly(self, seconds: float, hz: float = 50.0) -> None:
        for i in range(round(seconds * hz)):
            self.clock.advance(1.0 / hz)
            self.attitude()
            self.position()
            if i % 5 == 0:
                self.telemetry.ask(self.clock.now_s())

    def pose(self) -> Pose:
        pose = self.telemetry.poses.newest()
        assert pose is not None
        return pose

    def state(self) -> VehicleState:
        return self.telemetry.state(self.clock.now_s())

    def intervals_asked(self) -> list[tuple[int, float]]:
        return [
            (round(fields["param1"]), fields["param2"])
            for fields in self.link.sent_named("COMMAND_LONG")
            if fields["command"] == MavCmd.SET_MESSAGE_INTERVAL
        ]


def test_poses_come_in_our_frames_at_the_time_of_their_measurement() -> None:
    """Protects the map: stamped when measured, not when they arrived, and east-north-up."""
    autopilot = Autopilot()
    autopilot.delay_s = 0.08
    autopilot.fly(3.0)
    pose = autopilot.pose()
    measured_s = autopilot.clock.now_s() - 0.08
    assert pose.t_s == pytest.approx(measured_s, abs=0.002)
    assert (pose.x_m, pose.y_m, pose.z_m) == pytest.approx((2.0, measured_s - BOOTED_S, 1.5))
    assert (pose.vx_mps, pose.vy_mps, pose.vz_mps) == pytest.approx((0.0, 1.0, 0.1))
    assert pose.yaw_rad == pytest.approx(math.pi / 2 - 0.3)
    assert (pose.roll_rad, pose.pitch_rad, pose.yaw_rate_radps) == pytest.approx((0.1, -0.05, -0.4))
    assert autopilot.state().pose_age_s == pytest.approx(0.08, abs=0.002)
    residual_s = autopilot.telemetry.clock_residual_s
    assert residual_s is not None
    assert 0.08 < residual_s < 0.1


@pytest.mark.parametrize("rates", [[0.97], [1.03], [0.992, 0.969, 0.98, 0.992]])
def test_the_age_of_a_pose_is_true_when_the_autopilots_clock_runs_slow_or_fast(rates: list[float]) -> None:
    """Protects map and flight on a simulator that does not keep real time, and whose rate follows its load."""
    autopilot = Autopilot()
    autopilot.rate = rates[0]
    autopilot.fly(2.0)
    for rate in rates * (12 // len(rates)):
        autopilot.runs(rate)
        for _ in range(100):
            autopilot.fly(0.02)
            autopilot.telemetry.ask(autopilot.clock.now_s())
            autopilot.clock.advance(0.005)
            autopilot.attitude()
            autopilot.position()
            age_s = autopilot.state().pose_age_s
            assert age_s >= 0.0
            assert abs(age_s - autopilot.delay_s) < 0.02
    assert autopilot.telemetry.restarts == 0
    assert autopilot.telemetry.malformed == 0
    assert autopilot.telemetry.clock_rate == pytest.approx(rates[-1], abs=0.01)
    residual_s = autopilot.telemetry.clock_residual_s
    assert residual_s is not None
    assert residual_s < 0.03, "what pre-flight demands"


def test_without_timesync_the_least_delay_is_used() -> None:
    """Protects autopilots that do not answer TIMESYNC: stamps are late by the least delay, never early."""
    autopilot = Autopilot()
    autopilot.answers_time = False
    autopilot.fly(1.0)
    autopilot.delay_s = 0.2
    autopilot.fly(0.5)
    assert autopilot.pose().t_s == pytest.approx(autopilot.clock.now_s() - 0.2 + 0.01, abs=0.002)


def test_timesync_about_another_clock_is_not_believed() -> None:
    """Protects against stamps that are off by half an hour, as seen with one autopilot's time service."""
    autopilot = Autopilot()
    autopilot.fly(1.0)
    autopilot.answers_time = False
    autopilot.fly(5.0)
    (question,) = autopilot.link.sent_named("TIMESYNC")[-1:]
    answer = round((autopilot.clock.now_s() - BOOTED_S + 2534.0) * 1e9)
    autopilot.link.deliver("TIMESYNC", {"tc1": answer, "ts1": question["ts1"]})
    autopilot.fly(0.1)
    assert autopilot.clock.now_s() - autopilot.pose().t_s == pytest.approx(0.0, abs=0.02)


def test_time_answers_that_nobody_asked_for_are_ignored() -> None:
    """Protects against replayed answers, questions of the autopilot's own, and nonsense."""
    autopilot = Autopilot()
    autopilot.answers_time = False
    autopilot.telemetry.ask(autopilot.clock.now_s())
    question = autopilot.link.sent_named("TIMESYNC")[0]["ts1"]
    for fields in (
        {"tc1": 10**11, "ts1": question + 1},
        {"tc1": 0, "ts1": question},
        {"tc1": -5, "ts1": question},
        {"tc1": math.nan, "ts1": question},
        {},
    ):
        autopilot.link.deliver("TIMESYNC", fields)
    assert autopilot.telemetry.clock_residual_s is None
    autopilot.clock.advance(0.01)
    for _ in range(2):
        autopilot.link.deliver("TIMESYNC", {"tc1": 10**11, "ts1": question})
    assert autopilot.telemetry.clock_round_trip_s == pytest.approx(0.01), "an answer counts"
    autopilot.clock.advance(1.0)
    residual_s = autopilot.telemetry.clock_residual_s
    autopilot.link.deliver("TIMESYNC", {"tc1": 10**11 + 10**9, "ts1": question})
    assert autopilot.telemetry.clock_residual_s == residual_s, "and counts once"


@pytest.mark.parametrize(("rate", "least", "most"), [(1.0, 15, 20), (0.9999, 15, 20), (0.98, 60, 100)])
def test_timesync_is_asked_often_at_first_and_of_a_clock_that_drifts(rate: float, least: int, most: int) -> None:
    """Protects a slow serial link, the alignment in the first seconds, and that with a simulation."""
    autopilot = Autopilot()
    autopilot.rate = rate
    autopilot.fly(5.0)
    assert 18 <= len(autopilot.link.sent_named("TIMESYNC")) <= 26
    autopilot.link.sent.clear()
    autopilot.fly(20.0)
    assert least <= len(autopilot.link.sent_named("TIMESYNC")) <= most


def test_timesync_is_asked_often_while_the_round_trips_are_slow() -> None:
    """Protects stamps over a radio: the more questions, the more of them meet an empty queue."""
    autopilot = Autopilot()
    autopilot.delay_s = 0.04
    autopilot.fly(10.0)
    autopilot.link.sent.clear()
    autopilot.fly(10.0)
    assert len(autopilot.link.sent_named("TIMESYNC")) > 25


def test_a_message_is_never_from_the_future() -> None:
    """Protects ages: no clock error may make an old pose look newer than its arrival."""
    autopilot = Autopilot()
    autopilot.fly(1.0)
    autopilot.attitude()
    newest_s = autopilot.clock.now_s()
    autopilot.link.deliver(
        "LOCAL_POSITION_NED",
        {"time_boot_ms": autopilot.boot_ms() + 300, "x": 101.0, "y": 2, "z": -1.5, "vx": 1, "vy": 0, "vz": 0},
    )
    assert autopilot.pose().t_s <= newest_s


def test_a_restart_of_the_autopilot_forgets_the_poses_and_asks_for_everything_again() -> None:
    """Protects against a pose of before the restart, and against telemetry at the default rates after it."""
    autopilot = Autopilot()
    autopilot.fly(8.0)
    autopilot.link.sent.clear()
    autopilot.booted_s = autopilot.clock.now_s() + 0.01
    autopilot.clock.advance(1.0)
    autopilot.attitude()
    autopilot.position()
    autopilot.attitude()
    assert autopilot.telemetry.restarts == 1
    assert autopilot.telemetry.poses.newest() is None
    autopilot.fly(0.2)
    assert len(autopilot.intervals_asked()) == 7
    assert autopilot.clock.now_s() - autopilot.pose().t_s < 0.05


def test_one_replayed_message_is_no_restart() -> None:
    """Protects the flight from a packet that comes twice."""
    autopilot = Autopilot()
    autopilot.fly(8.0)
    before = autopilot.telemetry.poses.newest()
    autopilot.link.deliver("ATTITUDE", {"time_boot_ms": 101_000, "roll": 1, "pitch": 1, "yaw": 1, "yawspeed": 1})
    assert autopilot.telemetry.restarts == 0
    assert autopilot.telemetry.poses.newest() == before


def test_a_leap_of_the_estimate_is_not_interpolated() -> None:
    """Protects the map from a frame that is placed half way between two estimates of the same place."""
    autopilot = Autopilot()
    autopilot.fly(1.0)
    before_s = autopilot.clock.now_s()
    autopilot.clock.advance(0.02)
    autopilot.attitude()
    autopilot.position(y=5.0)
    assert autopilot.telemetry.leaps == 1
    assert autopilot.telemetry.poses.at(before_s - 0.005) is None


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_rates_are_asked_for_and_asked_again_only_where_they_are_missing(kind: AutopilotKind) -> None:
    """Protects the control loop from 4 Hz telemetry, and the link from being flooded with questions."""
    autopilot = Autopilot(kind)
    autopilot.telemetry.ask(autopilot.clock.now_s())
    estimator = 230 if kind is AutopilotKind.PX4 else 193
    assert sorted(autopilot.intervals_asked()) == [
        (1, 1e6), (24, 1e5), (30, 2e4), (32, 2e4), (147, 1e6), (estimator, 1e5), (245, 5e5)
    ]  # fmt: skip
    autopilot.link.sent.clear()
    for _ in range(200):
        autopilot.clock.advance(0.02)
        autopilot.attitude()
        if autopilot.clock.now_s() % 0.1 < 0.02:
            autopilot.position()
        autopilot.telemetry.ask(autopilot.clock.now_s())
    asked = [number for number, _ in autopilot.intervals_asked()]
    assert 30 not in asked, "comes as asked"
    assert asked.count(32) == 1, "comes at 10 Hz instead of 50, asked again after 3 s"


@pytest.mark.parametrize(
    ("kind", "gps", "asked"),
    [
        (AutopilotKind.PX4, False, {33: 5e5}),
        (AutopilotKind.PX4, True, {}),
        (AutopilotKind.ARDUPILOT, False, {}),
        (AutopilotKind.ARDUPILOT, True, {}),
    ],
)
def test_without_gps_the_origin_and_px4s_global_position_are_asked_for_all_the_time(
    kind: AutopilotKind, gps: bool, asked: dict[int, float]
) -> None:
    """Protects from a landing at 0/0: both are needed to see it coming, here and in the gate, also in flight.

    PX4 sends the origin when it changes and when it is asked for, so it is asked for every second.
    """
    autopilot = Autopilot(kind, Settings.model_validate({"autopilot": {"gps": gps}}))
    autopilot.fly(5.0)
    intervals = {number: interval_us for number, interval_us in autopilot.intervals_asked() if number in (33, 49)}
    assert intervals == asked
    polls = [
        fields
        for fields in autopilot.link.sent_named("COMMAND_LONG")
        if (fields["command"], fields["param1"]) == (MavCmd.REQUEST_MESSAGE, 49.0)
    ]
    assert len(polls) == (0 if gps else 5)


def test_an_origin_that_is_no_longer_heard_is_not_known() -> None:
    """Protects from the origin of an autopilot that was restarted and has none any more."""
    autopilot = Autopilot()
    state = autopilot.state()
    assert (state.origin_set, state.global_position) == (False, False)
    autopilot.link.deliver("GPS_GLOBAL_ORIGIN", {"latitude": 1, "longitude": 1, "altitude": 0})
    autopilot.link.deliver("GLOBAL_POSITION_INT", {"lat": 1, "lon": 1})
    state = autopilot.state()
    assert (state.origin_set, state.global_position) == (True, True)
    autopilot.clock.advance(4.0)
    state = autopilot.state()
    assert (state.origin_set, state.global_position) == (False, False)


@pytest.mark.parametrize("kind", list(AutopilotKind))
def test_the_position_fix_is_asked_for_where_it_flies_by_gps(kind: AutopilotKind) -> None:
    """Protects the gate's sight of a lost fix: ArduPilot tells it only to who asks, oftener than the gate misses it."""
    settings = Settings()
    with_gps = wanted_hz(kind, settings.autopilot.model_copy(update={"gps": True}), settings.mission)
    assert 2.0 / with_gps["GPS_RAW_INT"] < settings.safety.stale.gps_s, "one may be lost"
    assert "GPS_RAW_INT" not in wanted_hz(kind, settings.autopilot.model_copy(update={"gps": False}), settings.mission)


def test_the_version_is_asked_for_until_it_comes() -> None:
    """Protects the pre-flight report on a link that loses the first answer."""
    autopilot = Autopilot()

    def asked() -> int:
        commands = autopilot.link.sent_named("COMMAND_LONG")
        return sum(fields["command"] == MavCmd.REQUEST_MESSAGE and fields["param1"] == 148 for fields in commands)

    autopilot.fly(11.0)
    assert asked() == 3
    assert autopilot.state().version is None
    autopilot.link.deliver("AUTOPILOT_VERSION", {"flight_sw_version": 0x040700FF})
    assert autopilot.state().version == "4.7.0"
    autopilot.link.deliver("AUTOPILOT_VERSION", {"flight_sw_version": 0x04070000})
    assert autopilot.state().version == "4.7.0-dev"
    autopilot.fly(11.0)
    assert asked() == 3


def test_the_state_before_anything_was_said_claims_nothing() -> None:
    """Protects against reading silence as landed, disarmed and healthy."""
    autopilot = Autopilot()
    state = autopilot.state()
    assert (state.armed, state.mode, state.landed, state.battery_percent) == (False, "unknown", None, None)
    assert state.heartbeat_age_s == state.pose_age_s == math.inf
    assert not state.position_valid


def test_the_state_is_what_the_messages_say() -> None:
    """Protects the reading of each message that the flight depends on."""
    autopilot = Autopilot()
    autopilot.tells(landed_state=2)
    autopilot.link.deliver("STATUSTEXT", {"severity": 4, "text": "Failsafe"})
    autopilot.clock.advance(0.5)
    state = autopilot.state()
    assert (state.armed, state.mode, state.landed, state.battery_percent) == (True, "offboard", False, 61.0)
    assert (state.heartbeat_age_s, state.position_valid) == (0.5, True)
    assert [(text.severity, text.text) for text in autopilot.telemetry.texts] == [(4, "Failsafe")]
    autopilot.heartbeat(PX4_POSITION, armed=False)
    autopilot.link.deliver("EXTENDED_SYS_STATE", {"landed_state": 1})
    state = autopilot.state()
    assert (state.armed, state.mode, state.landed) == (False, "position", True)


def test_the_speed_is_the_median_of_three_seconds() -> None:
    """Protects the check of the standing vehicle from a single sample, and from what was said long ago."""
    autopilot = Autopilot()
    assert autopilot.state().speed_mps is None
    autopilot.fly(4.0)
    assert autopilot.state().speed_mps == pytest.approx(math.hypot(1.0, 0.1))
    for _ in range(80):  # 1.6 s of standing: more than half of the last three
        autopilot.clock.advance(0.02)
        autopilot.position(vx=0.0, vz=0.0)
    assert autopilot.state().speed_mps == 0.0
    autopilot.clock.advance(3.1)
    assert autopilot.state().speed_mps is None


def test_what_was_said_long_ago_no_longer_counts() -> None:
    """Protects against an estimator that was healthy before the link died."""
    autopilot = Autopilot()
    autopilot.tells(landed_state=1)
    autopilot.clock.advance(11.0)
    state = autopilot.state()
    assert (state.landed, state.battery_percent, state.position_valid) == (None, None, False)
    assert state.heartbeat_age_s == 11.0


@pytest.mark.parametrize(
    ("kind", "flags", "valid"),
    [
        (AutopilotKind.PX4, ESTIMATOR_GOOD, True),
        (AutopilotKind.PX4, ESTIMATOR_GOOD | 1024, True),  # a GPS glitch does not matter underground
        (AutopilotKind.PX4, ESTIMATOR_GOOD | 2048, False),
        (AutopilotKind.PX4, ESTIMATOR_GOOD | 128, True),  # at rest
        (AutopilotKind.PX4, ESTIMATOR_GOOD & ~8, False),
        (AutopilotKind.PX4, ESTIMATOR_GOOD & ~8 | 16, True),
        (AutopilotKind.PX4, ESTIMATOR_GOOD & ~2, False),
        (AutopilotKind.ARDUPILOT, ESTIMATOR_GOOD, True),
        (AutopilotKind.ARDUPILOT, ESTIMATOR_GOOD | 1024, False),
        (AutopilotKind.ARDUPILOT, ESTIMATOR_GOOD | 128, False),
        (AutopilotKind.ARDUPILOT, 0, False),
    ],
)
def test_the_estimator_is_healthy_with_a_relative_position(kind: AutopilotKind, flags: int, valid: bool) -> None:
    """Protects the start underground, where there is no absolute position, and refuses a guessed one."""
    autopilot = Autopilot(kind)
    name = "ESTIMATOR_STATUS" if kind is AutopilotKind.PX4 else "EKF_STATUS_REPORT"
    autopilot.link.deliver(name, {"flags": flags})
    state = autopilot.state()
    assert (state.position_valid, state.estimator_flags) == (valid, flags)


def test_a_battery_that_sys_status_does_not_measure_is_read_from_battery_status() -> None:
    """Protects the low-battery landing on both autopilots; -1 is not measured, not empty."""
    autopilot = Autopilot()
    autopilot.link.deliver("SYS_STATUS", {"battery_remaining": -1})
    assert autopilot.state().battery_percent is None
    autopilot.link.deliver("BATTERY_STATUS", {"battery_remaining": 40})
    assert autopilot.state().battery_percent == 40.0


@pytest.mark.parametrize(
    ("name", "fields", "voltage_v"),
    [
        ("SYS_STATUS", {"voltage_battery": 12345}, 12.345),
        ("SYS_STATUS", {"voltage_battery": 65535}, None),
        ("SYS_STATUS", {"voltage_battery": 0}, None),
        ("SYS_STATUS", {"voltage_battery": True}, None),
        ("BATTERY_STATUS", {"voltages": [4000, 4100, 3900] + [65535] * 7}, 12.0),
        ("BATTERY_STATUS", {"voltages": [65535] * 10}, None),
        ("BATTERY_STATUS", {"voltages": "none"}, None),
        ("BATTERY_STATUS", {"voltages": [4000, None, math.nan, -5]}, 4.0),
    ],
)
def test_the_voltage_is_read_from_either_message(name: str, fields: dict[str, Any], voltage_v: float | None) -> None:
    autopilot = Autopilot()
    autopilot.link.deliver(name, fields)
    assert autopilot.state().voltage_v == (None if voltage_v is None else pytest.approx(voltage_v))
    autopilot.clock.advance(11.0)
    assert autopilot.state().voltage_v is None, "stale is not fresh"


def test_the_worst_charge_of_all_batteries_counts_while_it_is_fresh() -> None:
    """Protects from the battery that is still good and speaks last."""
    autopilot = Autopilot()
    assert autopilot.state().charge_state is None
    for number, state in ((0, 1), (1, 3), (2, 7), (3, 0), (4, 99), (99, 5)):
        autopilot.link.deliver("BATTERY_STATUS", {"id": number, "charge_state": state})
    assert autopilot.state().charge_state is MavChargeState.CRITICAL
    autopilot.link.deliver("BATTERY_STATUS", {"id": 1, "charge_state": 1})
    assert autopilot.state().charge_state is MavChargeState.OK
    autopilot.clock.advance(11.0)
    assert autopilot.state().charge_state is None


def test_a_voltage_has_to_stay_low() -> None:
    """Protects a flight from the sag of its take-off, and from a battery that is empty."""
    autopilot = Autopilot(settings=Settings.model_validate({"mission": {"battery_low_v": 10.5}}))

    def seconds_of(voltage_v: float, seconds: int) -> float:
        for _ in range(seconds):
            autopilot.clock.advance(1.0)
            autopilot.link.deliver("SYS_STATUS", {"voltage_battery": round(1000 * voltage_v)})
        return autopilot.state().low_voltage_s

    assert seconds_of(12.0, 3) == 0.0
    assert seconds_of(10.2, 3) == 2.0
    assert seconds_of(10.6, 1) == 0.0
    assert seconds_of(10.2, 8) == 7.0
    unjudged = Autopilot()
    unjudged.link.deliver("SYS_STATUS", {"voltage_battery": 100})
    unjudged.clock.advance(5.0)
    assert unjudged.state().low_voltage_s == 0.0


@pytest.mark.parametrize(("status", "critical"), [(3, False), (4, False), (5, True), (6, True), (None, False)])
def test_a_heartbeat_in_distress_is_told(status: int | None, critical: bool) -> None:
    autopilot = Autopilot()
    autopilot.link.deliver("HEARTBEAT", {"base_mode": 129, "custom_mode": PX4_OFFBOARD, "system_status": status})
    assert autopilot.state().critical is critical


def test_texts_are_bounded() -> None:
    """Protects memory from an autopilot that complains ten times a second."""
    autopilot = Autopilot()
    for i in range(TEXTS + 30):
        autopilot.link.deliver("STATUSTEXT", {"severity": 6, "text": str(i)})
    texts = autopilot.telemetry.texts
    assert [text.text for text in texts] == [str(i) for i in range(30, TEXTS + 30)]


def test_what_px4_says_as_text_and_as_event_is_told_once() -> None:
    """Protects the reasons of a refusal from being read as twice as many; what is said again later is news."""
    autopilot = Autopilot()

    def says(*said: str) -> None:
        for text in said:
            # As a STATUSTEXT some of them end with what only a ground station makes something of.
            autopilot.link.deliver("STATUSTEXT", {"severity": 4, "text": text})

    says("Arming denied", "Battery low\t")
    autopilot.clock.advance(SAID_TWICE_S)
    says("Arming denied", "Battery low")
    assert [text.text for text in autopilot.telemetry.texts] == ["Arming denied", "Battery low"]
    autopilot.clock.advance(0.01)
    says("Battery low")
    assert [text.text for text in autopilot.telemetry.texts] == ["Arming denied", "Battery low", "Battery low"]


values = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), st.lists(st.integers(), max_size=2)
)
names = st.sampled_from([
    "ATTITUDE", "LOCAL_POSITION_NED", "TIMESYNC", "STATUSTEXT", "HEARTBEAT", "SYS_STATUS", "BATTERY_STATUS",
    "EXTENDED_SYS_STATE", "ESTIMATOR_STATUS", "AUTOPILOT_VERSION",
])  # fmt: skip
keys = st.sampled_from([
    "time_boot_ms", "roll", "pitch", "yaw", "yawspeed", "x", "y", "z", "vx", "vy", "vz", "tc1", "ts1", "text",
    "severity", "base_mode", "custom_mode", "battery_remaining", "landed_state", "flags", "flight_sw_version",
    "system_status", "voltage_battery", "voltages", "charge_state", "id",
])  # fmt: skip


@given(st.lists(st.tuples(names, st.dictionaries(keys, values, max_size=8)), max_size=12))
def test_malformed_messages_are_never_believed_and_never_crash(messages: list[tuple[str, dict[str, Any]]]) -> None:
    """Protects the application from whatever a broken or hostile sender says with our autopilot's address."""
    autopilot = Autopilot()
    autopilot.fly(0.2)
    with unittest.TestCase().assertNoLogs("companion", "ERROR"):  # a handler that raises would be logged
        for name, fields in messages:
            autopilot.link.deliver(name, fields)
    autopilot.telemetry.ask(autopilot.clock.now_s())
    state = autopilot.state()
    pose = autopilot.telemetry.poses.newest()
    assert pose is None or all(math.isfinite(getattr(pose, name)) for name in type(pose).__slots__)
    assert state.battery_percent is None or 0.0 <= state.battery_percent <= 100.0
    assert state.voltage_v is None or 0.0 < state.voltage_v < math.inf


async def test_run_asks_until_it_is_cancelled() -> None:
    """Protects the loop that keeps telemetry alive."""
    autopilot = Autopilot()
    asking = asyncio.create_task(autopilot.telemetry.run())
    await autopilot.clock.sleep(1.2)
    asking.cancel()
    assert 5 <= len(autopilot.link.sent_named("TIMESYNC")) <= 7, "five times a second at first"
    assert autopilot.intervals_asked()
