"""The loop that flies: what is sent, and what is not, when something is missing."""

from __future__ import annotations

import numpy as np
import pytest

from companion.config.load import load_settings
from companion.flight.control_loop import ControlLoop, Rate
from companion.flight.phase import FlightPhase, PhaseMachine
from companion.model import Beam, Input, Measurement, Mode, Pose, RangeReading, Setpoint
from companion.pipeline import Explorer, Order, Tick
from companion.pose_buffer import PoseBuffer
from companion.sensors.sink import RawDepth, SensorSink
from companion.sensors.synchronizer import Synchronizer
from tests.shared.clocks import HandClock

SETTINGS = load_settings(None, "flight")
CAMERA = SETTINGS.sensors.camera.model()


class Vehicle:
    """Notes what it is asked to send."""

    def __init__(self) -> None:
        self.sent: list[Setpoint] = []
        self.refuses = False

    def send(self, setpoint: Setpoint) -> bool:
        self.sent.append(setpoint)
        return not self.refuses


class Gate:
    """Notes the beats, and what had been sent by then."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.beats: list[tuple[float, Pose | None, Measurement | None]] = []
        self.sent_before: list[int] = []
        self._vehicle = vehicle

    def ticked(self, t_s: float, pose: Pose | None, measurement: Measurement | None) -> None:
        self.beats.append((t_s, pose, measurement))
        self.sent_before.append(len(self._vehicle.sent))


class Bench:
    """A pilot whose sensors and poses come when the test says so."""

    def __init__(self) -> None:
        self.clock = HandClock(100.0)
        self.sink = SensorSink(self.clock)
        self.poses = PoseBuffer()
        self.vehicle = Vehicle()
        self.gate = Gate(self.vehicle)
        self.seen: list[Tick] = []
        self.flight = PhaseMachine()
        self.control_loop = ControlLoop(
            Synchronizer(self.sink, self.poses),
            Explorer(SETTINGS, np.random.default_rng(1)),
            Rate(self.clock, 0.05),
            self.flight,
            self.vehicle.send,
            (self.seen.append,),
            self.gate.ticked,
        )

    def tick(self, *, pose: bool = True, depth: bool = True, down: bool = True, h_m: float = 1.5) -> Tick:
        """Let 50 ms pass in which these arrive, and tick."""
        for _ in range(2):
            self.clock.advance(0.025)
            if pose:
                self.poses.add_attitude(self.clock.time_s, 0.0, 0.0, 0.0, 0.0)
                self.poses.add_position(self.clock.time_s, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0)
        now_s = self.clock.time_s
        if depth:
            shape = (CAMERA.height_px, CAMERA.width_px)
            self.sink.depth(RawDepth(now_s - 0.01, np.full(shape, 4.0, np.float32), CAMERA))
        if down:
            self.sink.ranges([RangeReading(Beam.DOWN, now_s, h_m, 8.0)])
        return self.control_loop.tick(now_s)


def test_it_looks_without_steering_until_it_explores() -> None:
    bench = Bench()
    tick = bench.tick()
    assert tick.setpoint is None
    assert bench.vehicle.sent == []
    assert bench.control_loop.measured_height_m() == pytest.approx(1.5)
    assert tick.mode is Mode.HOLD


def test_exploring_sends_one_setpoint_a_tick() -> None:
    bench = Bench()
    bench.tick()
    bench.flight.phase = FlightPhase.EXPLORING
    for _ in range(4):
        assert bench.tick().sent
    assert len(bench.vehicle.sent) == 4
    assert [setpoint.t_s for setpoint in bench.vehicle.sent] == [tick.t_s for tick in bench.seen[1:]]
    assert bench.vehicle.sent[-1].yaw_rate_radps != 0.0  # R1 turns


def test_on_the_way_home_the_navigator_is_told_so_and_each_tick_says_it() -> None:
    bench = Bench()
    bench.flight.phase = FlightPhase.EXPLORING
    assert bench.tick().order is Order.EXPLORE
    assert bench.control_loop.off_home_m() == 0.0
    bench.flight.phase = FlightPhase.HOMING
    ticks = [bench.tick() for _ in range(50)]
    assert {(tick.order, tick.sent, tick.stepped) for tick in ticks} == {(Order.HOME, True, True)}
    assert bench.control_loop.is_home, "it has never left"
    way = bench.control_loop.way_home()
    assert way is not None
    assert way.length_m == pytest.approx(0.0, abs=0.5)


def test_before_anything_was_flown_nobody_knows_where_home_is() -> None:
    bench = Bench()
    assert (bench.control_loop.way_home(), bench.control_loop.off_home_m()) == (None, None)
    bench.tick()
    assert (bench.control_loop.way_home(), bench.control_loop.off_home_m()) == (None, None)


@pytest.mark.parametrize("phase", [FlightPhase.EXPLORING, FlightPhase.HOMING])
def test_a_paused_flight_stands_and_goes_on_as_before(phase: FlightPhase) -> None:
    """Protects a person's pause: zero goes out at the usual rate, or the autopilot's failsafe would end the flight."""
    bench = Bench()
    bench.flight.phase = FlightPhase.EXPLORING
    bench.tick()
    bench.flight.phase = phase
    mode = bench.tick().mode
    assert bench.flight.pause(True)
    ticks = [bench.tick() for _ in range(10)]
    assert {(tick.order, tick.mode, tick.sent) for tick in ticks} == {(Order.WAIT, Mode.HOLD, True)}
    for tick in ticks:
        assert tick.setpoint is not None
        assert (tick.setpoint.speed_mps, tick.setpoint.yaw_rate_radps) == (0.0, 0.0)
    bench.flight.pause(False)
    tick = bench.tick()
    assert (tick.order, tick.mode) == (Order.HOME if phase is FlightPhase.HOMING else Order.EXPLORE, mode)


def test_a_pause_keeps_the_height() -> None:
    """Protects the ground below and the roof above a vehicle that waits for minutes."""
    bench = Bench()
    bench.flight.phase = FlightPhase.EXPLORING
    bench.tick()
    bench.flight.pause(True)
    low = [bench.tick(h_m=1.2) for _ in range(5)][-1]
    assert low.setpoint is not None
    assert low.setpoint.climb_mps > 0.0
    blind = [bench.tick(h_m=1.2, depth=False) for _ in range(15)][-1]
    assert "depth" in blind.missing
    assert blind.setpoint is not None
    assert blind.setpoint.speed_mps == 0.0


def test_a_lost_pose_is_silence() -> None:
    """A velocity means nothing to an autopilot that does not know its own."""
    bench = Bench()
    bench.flight.phase = FlightPhase.EXPLORING
    bench.tick()
    sent = len(bench.vehicle.sent)
    for _ in range(8):
        tick = bench.tick(pose=False)
    assert tick.missing == (Input.POSE,)
    assert tick.setpoint is None
    # A pose is good for 0.3 s: the first few ticks still had one.
    assert len(bench.vehicle.sent) - sent <= 6
    assert not bench.seen[-1].sent


@pytest.mark.parametrize(("lost", "name"), [({"depth": False}, "depth"), ({"down": False}, "height")])
def test_a_lost_sensor_is_a_stop(lost: dict[str, bool], name: str) -> None:
    bench = Bench()
    bench.flight.phase = FlightPhase.EXPLORING
    for _ in range(3):
        bench.tick()
    for _ in range(12):
        tick = bench.tick(**lost)
    assert name in tick.missing
    assert tick.sent
    assert tick.setpoint is not None
    assert (tick.setpoint.speed_mps, tick.setpoint.yaw_rate_radps) == (0.0, 0.0)
    assert tick.mode is Mode.HOLD
    assert bench.clock.time_s - bench.control_loop.fresh_s > 0.05
    assert bench.tick().missing == ()
    assert bench.control_loop.fresh_s == bench.clock.time_s


def test_before_the_first_pose_a_tick_says_what_is_missing() -> None:
    bench = Bench()
    bench.flight.phase = FlightPhase.EXPLORING
    tick = bench.tick(pose=False)
    assert (tick.missing, tick.observation, tick.sent) == ((Input.POSE,), None, False)
    assert bench.control_loop.measured_height_m() is None


def test_a_vehicle_that_refuses_is_recorded() -> None:
    """The pilot has taken over: the record must not say that our setpoint went out."""
    bench = Bench()
    bench.flight.phase = FlightPhase.EXPLORING
    bench.vehicle.refuses = True
    tick = bench.tick()
    assert tick.setpoint is not None
    assert not tick.sent


def test_every_tick_is_told_to_every_watcher() -> None:
    bench = Bench()
    ticks = [bench.tick() for _ in range(3)]
    assert bench.seen == ticks
    assert all(tick.duration_s > 0.0 for tick in ticks)


def test_the_gate_hears_of_a_tick_before_it_sees_the_setpoint() -> None:
    """Without a beat as new as the setpoint the gate would have to stop the vehicle once in each tick."""
    bench = Bench()
    bench.flight.phase = FlightPhase.EXPLORING
    ticks = [bench.tick() for _ in range(3)]
    assert [t_s for t_s, _, _ in bench.gate.beats] == [tick.t_s for tick in ticks]
    assert [measurement for _, _, measurement in bench.gate.beats] == [tick.measurement for tick in ticks]
    assert bench.gate.beats[-1][1] == bench.control_loop.pose
    assert bench.gate.sent_before == [0, 1, 2]


def test_on_the_ground_and_without_a_pose_the_gate_hears_of_ticks_too() -> None:
    bench = Bench()
    bench.tick(pose=False)
    bench.tick()
    assert bench.gate.beats[0][1:] == (None, None)
    assert bench.gate.beats[1][1] is not None
    assert bench.vehicle.sent == []


@pytest.mark.parametrize("fails", ["observe", "step"])
def test_a_tick_that_fails_is_none(fails: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the meaning of a beat: everything that a setpoint rests on was looked at, and worked."""
    bench = Bench()
    bench.flight.phase = FlightPhase.EXPLORING
    bench.tick()

    def broken(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(Synchronizer if fails == "observe" else Explorer, fails, broken)
    with pytest.raises(ZeroDivisionError):
        bench.tick()
    assert len(bench.gate.beats) == 1
    assert len(bench.vehicle.sent) == 1


async def test_each_tick_is_a_period_after_the_last() -> None:
    """The time that a tick takes does not add to the period."""
    clock = HandClock(5.0)
    times = await ticks(Rate(clock, 0.05), clock, [0.01, 0.02, 0.0])
    assert times == pytest.approx([5.0, 5.05, 5.1, 5.15])


async def test_missed_periods_are_counted_and_not_made_up_for() -> None:
    """After a hang of 0.5 s one tick comes at once, and the next one a period later: no burst of old setpoints."""
    clock = HandClock(0.0)
    rate = Rate(clock, 0.05)
    times = await ticks(rate, clock, [0.51, 0.0, 0.0])
    assert times[1] == pytest.approx(0.51)
    assert times[2] == pytest.approx(0.55)
    assert rate.missed == 9


async def ticks(rate: Rate, clock: HandClock, work_s: list[float]) -> list[float]:
    """The times of ticks which take that long, and of the one after them."""
    times: list[float] = []
    async for now_s in rate.ticks():
        times.append(now_s)
        if len(times) > len(work_s):
            break
        clock.advance(work_s[len(times) - 1])
    return times
