"""How a true way is read, what bounds the stops in it, and how the program judges them, without an autopilot."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from companion.config.settings import Settings
from companion.errors import InputError
from companion.flight.preflight.parameter_rules import rules
from companion.mavlink.firmware import AutopilotKind
from companion.model import Pose
from companion.safety_case.gate_plan import to_basis, to_plan
from companion.safety_case.stopping_budget import Case, stopping_budget
from validation.fault_matrix import results
from validation.real import braking
from validation.real.brake_bound import Bound, Way, least_brake_mps2, tightest
from validation.real.braking_report import COUNTED, Flown, problems, report
from validation.real.manoeuvres import Order, Stopped, Turned, settings_at
from validation.real.program import OWN_NETWORK
from validation.real.track import Cruise, Stop, Turn, cruise, stop, turn

STEP_S = 0.02
BEARING_RAD = 2.0
"""Of the flight: nothing may depend on it."""


def moving(speeds_mps: Iterator[float]) -> list[Pose]:
    """A straight way with these speeds, one every `STEP_S`."""
    poses, way_m = [], 0.0
    for i, speed_mps in enumerate(speeds_mps):
        cos, sin = math.cos(BEARING_RAD), math.sin(BEARING_RAD)
        poses.append(
            Pose(i * STEP_S, way_m * cos, way_m * sin, 3.0, 0.4, vx_mps=speed_mps * cos, vy_mps=speed_mps * sin)
        )
        way_m += speed_mps * STEP_S
    return poses


def braking_way(speed_mps: float, delay_s: float, brake_mps2: float, creep_mps: float = 0.0) -> list[Pose]:
    """1 s of flight, then ordered to stop; from when it stands it creeps on for 10 s."""
    stands_s = 1.0 + delay_s + (speed_mps - creep_mps) / brake_mps2

    def speed(t_s: float) -> float:
        return min(speed_mps, max(creep_mps, speed_mps - brake_mps2 * (t_s - 1.0 - delay_s)))

    return moving(speed(i * STEP_S) for i in range(round((stands_s + 10.0) / STEP_S)))


@pytest.mark.parametrize("speed_mps", [0.5, 1.0, 2.0])
def test_a_stop_is_as_long_as_the_vehicle_needed(speed_mps: float) -> None:
    """Protects the measurement: the way from the order, and what it creeps on for 5 s, no longer."""
    delay_s, brake_mps2, creep_mps = 0.2, 0.8, 0.04
    found = stop(braking_way(speed_mps, delay_s, brake_mps2, creep_mps), 1.0)
    assert found.stopped_s == pytest.approx(delay_s + (speed_mps - 0.05) / brake_mps2, abs=2 * STEP_S)
    stopped_m = speed_mps * delay_s + (speed_mps**2 - 0.05**2) / (2 * brake_mps2)
    assert found.stopped_m == pytest.approx(stopped_m, abs=0.03)
    assert found.creep_m == pytest.approx(5.0 * creep_mps, abs=0.01)
    assert found.way_m == pytest.approx(stopped_m + 5.0 * creep_mps, abs=0.03)


def test_one_that_swings_back_stood_at_its_farthest() -> None:
    """Protects the way that has to be free: flying backward is not flying on."""
    forward_s = [1.0] * 51 + [1.0 - 0.02 * i for i in range(75)]
    found = stop(moving(itertools.chain(forward_s, [0.0] * 300)), 1.0)
    assert found.way_m == pytest.approx(0.53, abs=0.01)
    assert found.stopped_m == pytest.approx(found.way_m, abs=0.01)
    assert found.creep_m == pytest.approx(0.125, abs=0.03), "it came back by so much"


def test_one_that_never_stands_is_said_to() -> None:
    """Protects the verdict: the end of the watching is no stop."""
    found = stop(moving(iter([1.0] * 51 + [0.2] * 200)), 1.0)
    assert found.stopped_s is None
    assert found.stopped_m is None
    assert found.way_m == pytest.approx(0.2 * 4.0, abs=0.05)


def test_a_cruise_is_behind_by_its_time_constant() -> None:
    """Protects the lag: a first order response is behind by its time constant, whatever the speed."""
    tau_s, wanted_mps = 0.6, 1.5
    way = moving(wanted_mps * (1.0 - math.exp(-i * STEP_S / tau_s)) for i in range(400))
    found = cruise(way, 0.0, 6.0)
    assert found.lag_s == pytest.approx(tau_s, abs=0.02)
    assert found.reached_mps == pytest.approx(wanted_mps, abs=0.01)
    assert found.at_order_mps == pytest.approx(wanted_mps, abs=0.001)
    assert found.largest_mps == pytest.approx(way[300].vx_mps / math.cos(BEARING_RAD), abs=0.001)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_turn_is_behind_its_order_and_its_flight_behind_the_turn(sense: float) -> None:
    """Protects the figures of a turn: rate, lag, slip and overrun, whichever way it turns."""
    tau_s, rate_radps, slip_rad, speed_mps = 0.4, 0.8, 0.3, 1.5
    poses, yaw_rad = [], 3.0
    for i in range(400):
        t_s = i * STEP_S
        rate = rate_radps * (1.0 - math.exp(-t_s / tau_s))
        if t_s > 6.0:
            rate = rate_radps * math.exp(-(t_s - 6.0) / tau_s)
        to_rad = yaw_rad - sense * slip_rad
        velocity = {"vx_mps": speed_mps * math.cos(to_rad), "vy_mps": speed_mps * math.sin(to_rad)}
        poses.append(Pose(t_s, 0.0, 0.0, 3.0, math.remainder(yaw_rad, math.tau), **velocity))
        yaw_rad += sense * rate * STEP_S
    found = turn(poses, 0.0, 6.0, moving=True)
    assert found.reached_radps == pytest.approx(sense * rate_radps, abs=0.01)
    assert found.lag_s == pytest.approx(tau_s, abs=0.03)
    assert found.slip_rad == pytest.approx(slip_rad, abs=0.01)
    assert found.speed_mps == pytest.approx(speed_mps)
    assert found.overrun_rad == pytest.approx(rate_radps * tau_s, abs=0.03)
    assert turn(poses, 0.0, 6.0, moving=False).slip_rad is None


def test_the_tightest_bound_is_that_by_which_the_ways_were_made() -> None:
    """Protects the fit: it finds delay and deceleration, and those that went less far change nothing."""
    made = Bound(0.3, 0.9, 0.25)
    ways: list[Way] = [(v, made.way_m(v)) for v in (0.5, 1.0, 1.5, 2.0)]
    found = tightest([*ways, (1.2, made.way_m(1.2) - 0.2)], 0.25)
    assert found.delay_s == pytest.approx(0.3)
    assert found.brake_mps2 == pytest.approx(0.9)
    assert least_brake_mps2(ways, 0.3, 0.25) == pytest.approx(0.9)
    assert least_brake_mps2(ways, 0.2, 0.25) == pytest.approx(1.0 / (1.0 / 0.9 + 2.0 * 0.1 / 0.5)), (
        "the slowest decides"
    )


def test_stops_of_the_same_time_need_no_deceleration() -> None:
    """Protects what is said of an autopilot that stops in the same time from any speed."""
    found = tightest([(0.5, 0.55), (1.0, 0.85), (2.0, 1.45)], 0.25)
    assert found.delay_s == pytest.approx(0.6)
    assert math.isinf(found.brake_mps2)
    assert found.way_m(1.0) == pytest.approx(0.85)


def test_a_bound_bounds_every_way() -> None:
    """Protects walls: whatever the ways, none is longer than the bound that is told of them."""
    speeds = [0.1 + 0.03 * i for i in range(60)]
    ways = [(v, 0.25 + abs(math.sin(37.0 * v)) * v + 0.4 * v * v) for v in speeds]
    found = tightest(ways, 0.25)
    assert found.left_m(ways) == pytest.approx(0.0, abs=1e-6), "and the longest of them is on it"
    assert tightest([(1.0, 0.2)], 0.25).way_m(1.0) == 0.25
    assert least_brake_mps2([(1.0, 0.2)], 0.15, 0.25) == math.inf
    assert least_brake_mps2([(0.0, 0.3)], 0.15, 0.25) is None


def test_what_is_counted_is_what_the_budget_counts() -> None:
    """Protects the comparison: a constant that changes there changes it here."""
    settings = Settings()
    plan, basis = to_plan(settings, command=(), restart_command=()), to_basis(settings)
    lines: dict[str, Case] = {line.fault: line for line in stopping_budget(plan, basis)}
    for order, fault in (
        (Order.LED_BACK, "setpoint_late"),
        (Order.STAND_HOLD, "setpoint_late"),
        (Order.LAND, "battery"),
    ):
        line = lines[fault]
        assert COUNTED[order] == Bound(line.autopilot_s, line.brake_mps2, line.creep_m)
    line = lines["gate killed"]
    assert COUNTED[Order.SILENCE] == Bound(line.detection_s - basis.pose_fresh_s, line.brake_mps2, line.creep_m)


def flown(way_m: float, order: Order = Order.LED_BACK, autopilot: str = "px4") -> Flown:
    """One with a stop from 1 m/s."""
    stopped = Stopped(order, 1.0, False, Cruise(0.98, 1.05, 0.7, 1.0), Stop(1.9, way_m - 0.1, 0.1, way_m), 0.01)
    turned = Turned(1.5, 0.6, Turn(-0.58, 0.5, 1.4, 0.3, 0.2), 0.02)
    return Flown(autopilot, 1, (stopped,), (turned,), 1.5)


def test_a_stop_that_is_longer_than_counted_is_said() -> None:
    """Protects the verdict: the bound is 1.56 m from 1 m/s, and BRAKE at speed is counted for PX4 only."""
    assert problems([flown(1.5)]) == []
    (said,) = problems([flown(1.66)])
    assert said == "px4 1: zero velocity, led back from 1.00 m/s went 1.66 m, 0.10 m further than is counted"
    assert said in report([flown(1.5), flown(1.66)])
    assert "every stop was as short as is counted" in report([flown(1.5), flown(2.5, Order.HOLD, "ardupilot")])
    assert problems([flown(2.5, Order.HOLD)])
    assert "not judged" in report([flown(2.5, Order.ZERO)])
    never = flown(1.0).stops[0]
    never = replace(never, stop=Stop(None, None, 0.0, 1.0))
    assert problems([replace(flown(1.0), stops=(never,))]) == [
        "px4 1: zero velocity, led back from 1.00 m/s did not stop"
    ]
    assert problems([replace(flown(1.0), problem="no take-off")]) == ["px4 1: no take-off"]


def test_the_report_has_medians_and_the_worst() -> None:
    """Protects the reader: one flight that was lucky does not make the table."""
    text = report([flown(1.0), flown(1.1), flown(1.4), flown(1.2, autopilot="ardupilot")])
    assert "1.10 / 1.40" in text
    assert "ardupilot and px4" in text, "and a bound of both"
    assert "0.97" in text, "the radius of the turn: 1.4 / 0.58 of 1.5 / 0.6"


def test_what_was_flown_reads_as_it_was_written(tmp_path: Path) -> None:
    """Protects hours of flights: they are gone on with."""
    file = tmp_path / "braking.json"
    done = [flown(1.0), replace(flown(1.1), problem="no take-off")]
    results.write_whole(file, [asdict(one) for one in done])
    assert braking.read(file) == done
    assert braking.read(tmp_path / "none.json") == []


def test_what_is_no_speed_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Protects the hour before the mistake is seen; and a network that others share."""
    assert braking.numbers("--speeds", "0.5,1.0") == (0.5, 1.0)
    for text in ("0.5,fast", "0.5,-1", "inf", "0"):
        with pytest.raises(InputError, match="--speeds"):
            braking.numbers("--speeds", text)
    assert braking.main(["--list", "--repeats", "2"]) == 0
    assert capsys.readouterr().out.split("\n")[:2] == ["px4 1", "ardupilot 1"]
    monkeypatch.delenv(OWN_NETWORK, raising=False)
    assert braking.main([]) == 2
    assert "scripts/own-network" in capsys.readouterr().out
    monkeypatch.setenv(OWN_NETWORK, "1")
    monkeypatch.setattr(braking, "prepare", lambda: None)
    assert braking.main(["--speeds", ""]) == 2
    assert "at least one" in capsys.readouterr().out


def test_pre_flight_is_asked_what_it_demands_at_that_speed() -> None:
    """Protects the measurement: PX4 flies to the place of a hold as fast as pre-flight lets it at that speed."""
    found = settings_at(2.0, gps=False)
    (cruise_rule,) = (rule for rule in rules(AutopilotKind.PX4, found) if rule.name == "MPC_XY_CRUISE")
    assert cruise_rule.either[0][0].set_to == 2.0
    assert any(rule.name == "EKF2_EV_CTRL" for rule in rules(AutopilotKind.PX4, found)), "it has no GPS"
    assert not any(rule.name == "EKF2_EV_CTRL" for rule in rules(AutopilotKind.PX4, settings_at(2.0, gps=True)))
