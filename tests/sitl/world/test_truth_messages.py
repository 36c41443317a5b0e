"""What each simulator says of the true pose: units, signs, grids, stamps, and what must be refused."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from companion.frames import NedPose
from sitl.world.truth_messages import GRID_M, LARGEST_DELAY_S, TruthKind, TruthReader
from tests.sitl.world.messages import ALT_M, LAT_DEG, Ned, hil, sim

BOTH = pytest.mark.parametrize("message_of", [hil, sim], ids=["HIL_STATE_QUATERNION", "SIM_STATE"])


def read(reader: TruthReader, *messages: Any, dt_s: float = 1.0) -> list[NedPose]:
    """Whatever poses come of messages that arrive ``dt_s`` apart."""
    poses = [reader.on_message(message, 100.0 + i * dt_s) for i, message in enumerate(messages)]
    return [pose for pose in poses if pose is not None]


@BOTH
def test_the_first_is_zero_and_the_others_are_metres_from_it(message_of: Any) -> None:
    """North, east and down from where it booted; each autopilot with the earth that it counts with.

    Over 400 m the other radius would be 45 cm off; the grid, twice cut off, is 2.3 cm.
    """
    first, later = read(TruthReader(TruthKind.AUTO), message_of((0.0, 0.0, 0.0)), message_of((400.0, -300.0, -2.5)))
    assert (first.north_m, first.east_m, first.down_m) == (0.0, 0.0, 0.0)
    # Halfway between two latitudes the circles are narrower than at the first: 0.03 % of a thousandth. Free of charge.
    assert later.north_m == pytest.approx(400.0, abs=2 * GRID_M)
    assert later.east_m == pytest.approx(-300.0, abs=2 * GRID_M + 300.0 * 400.0 / 2 / 6.37e6 * 1.1)
    assert later.down_m == pytest.approx(-2.5, abs=2e-3)


@BOTH
def test_velocity_and_heading(message_of: Any) -> None:
    """cm/s or m/s, and yaw clockwise from north, as it stands in the message."""
    (pose,) = read(TruthReader(TruthKind.AUTO), message_of((0.0, 0.0, 0.0), 2.0, (0.5, -0.4, -0.25)))
    assert (pose.v_north_mps, pose.v_east_mps, pose.v_down_mps) == pytest.approx((0.5, -0.4, -0.25), abs=0.0101)
    assert pose.yaw_rad == pytest.approx(2.0, abs=1e-6)
    assert (pose.roll_rad, pose.pitch_rad) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_tilt_and_turn_of_the_quaternion() -> None:
    """The order of the angles, and a heading's rate made of the rates about the body's own axes."""
    (pose,) = read(
        TruthReader(TruthKind.HIL), hil((0.0, 0.0, 0.0), -2.5, tilt_rad=(0.2, -0.3), rates_radps=(9.0, 0.5, 1.0))
    )
    assert (pose.roll_rad, pose.pitch_rad, pose.yaw_rad) == pytest.approx((-0.3, 0.2, -2.5), abs=1e-6)
    expected = (math.sin(-0.3) * 0.5 + math.cos(-0.3) * 1.0) / math.cos(0.2)
    assert pose.yaw_rate_radps == pytest.approx(expected, abs=1e-6)


def test_a_straight_flight_comes_out_straight_and_even() -> None:
    """50 messages a second on a grid of 1.1 cm: no pose further than two cells from the truth, and no jump."""
    reader = TruthReader(TruthKind.HIL)
    poses = read(
        reader, *(hil((0.4 * i * 0.02, 0.3 * i * 0.02, 0.0), 0.0, (0.4, 0.3, 0.0)) for i in range(500)), dt_s=0.02
    )
    assert len(poses) == 500
    for i, pose in enumerate(poses):
        assert math.hypot(pose.north_m - 0.4 * i * 0.02, pose.east_m - 0.3 * i * 0.02) <= 2 * math.sqrt(2) * GRID_M
    steps = [b.north_m - a.north_m for a, b in itertools.pairwise(poses)]
    assert max(steps) - min(steps) < 0.2 * GRID_M


def test_a_message_without_a_stamp_is_as_old_as_its_arrival() -> None:
    """PX4 leaves the stamp of HIL_STATE_QUATERNION at 0, and SIM_STATE has none."""
    assert [pose.t_s for pose in read(TruthReader(TruthKind.HIL), hil((0, 0, 0)), hil((0, 0, 0)))] == [100.0, 101.0]


def stamped(remote_s: float) -> Any:
    return hil((0.0, 0.0, 0.0), time_us=round(remote_s * 1e6))


def test_a_stamp_is_moved_to_our_clock_by_the_least_delay() -> None:
    """A message that was held up 30 ms on its way is 30 ms old, not new."""
    reader = TruthReader(TruthKind.HIL)
    for i in range(100):
        reader.on_message(stamped(5.0 + 0.02 * i), 200.001 + 0.02 * i)
    late = reader.on_message(stamped(7.0), 202.031)
    assert late is not None
    assert late.t_s == pytest.approx(202.001, abs=1e-6)


def test_a_simulator_that_cannot_keep_up_does_not_make_its_truth_old() -> None:
    """Its clock stood still for 0.4 s of ours; what it sends then is new all the same."""
    reader = TruthReader(TruthKind.HIL)
    for i in range(100):
        reader.on_message(stamped(5.0 + 0.02 * i), 200.0 + 0.02 * i)
    after = reader.on_message(stamped(7.0), 202.4)
    assert after is not None
    assert after.t_s == pytest.approx(202.4 - LARGEST_DELAY_S)


def test_time_never_goes_back() -> None:
    """Two messages of one instant: sensors that are shown the past would send it."""
    reader = TruthReader(TruthKind.HIL)
    assert reader.on_message(hil((0, 0, 0)), 100.0) is not None
    assert reader.on_message(hil((0, 0, 0)), 100.0) is None
    assert reader.on_message(hil((0, 0, 0)), 99.0) is None
    assert reader.on_message(hil((0, 0, 0)), 100.01) is not None


def broken_hil(**fields: Any) -> Any:
    message = hil((0.0, 0.0, 0.0))
    for name, value in fields.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    "message",
    [
        pytest.param(broken_hil(attitude_quaternion=[0.0] * 4), id="no attitude yet"),
        pytest.param(broken_hil(attitude_quaternion=[math.nan, 0.0, 0.0, 0.0]), id="attitude is no number"),
        pytest.param(broken_hil(attitude_quaternion=[math.inf, 0.0, 0.0, 0.0]), id="attitude is infinite"),
        pytest.param(broken_hil(yawspeed=math.nan), id="rate is no number"),
        pytest.param(broken_hil(lat=0, lon=0), id="no place yet"),
        pytest.param(sim((0.0, 0.0, 0.0), velocity_mps=(math.nan, 0.0, 0.0)), id="velocity is no number"),
    ],
)
def test_what_makes_no_sense_is_counted_and_does_not_become_the_start(message: Any) -> None:
    """The first pose decides where the mine is: zeros from a simulator that is still booting must not."""
    reader = TruthReader(TruthKind.AUTO)
    assert reader.on_message(message, 100.0) is None
    assert reader.refused == 1
    assert reader.origin is None


def test_auto_stays_with_the_first_that_comes() -> None:
    """Two truths of one vehicle differ by the autopilots' radii: mixed, the vehicle would jump to and fro."""
    reader = TruthReader(TruthKind.AUTO)
    assert reader.on_message(sim((0, 0, 0)), 100.0) is not None
    assert reader.on_message(hil((0, 0, 0)), 101.0) is None
    assert reader.kind is TruthKind.SIM


def test_the_origin_is_where_it_booted() -> None:
    """It is handed on to an autopilot without GPS."""
    reader = TruthReader(TruthKind.AUTO)
    reader.on_message(hil((0, 0, 0)), 100.0)
    assert reader.origin is not None
    assert reader.origin.latitude_deg == pytest.approx(LAT_DEG, abs=1e-6)
    assert reader.origin.altitude_m == pytest.approx(ALT_M, abs=2e-3)


def attitude(ms: int, yaw_rad: float, rate_radps: float = 0.0) -> Any:
    return mavlink.MAVLink_attitude_message(ms, 0.1, 0.2, yaw_rad, 0.0, 0.0, rate_radps)


def position(ms: int, place: Ned) -> Any:
    return mavlink.MAVLink_local_position_ned_message(ms, *place, 0.1, 0.2, 0.3)


def test_the_autopilots_own_estimate_pairs_position_with_attitude() -> None:
    """Where there is no truth: the attitude, turned on to the time of the position."""
    reader = TruthReader(TruthKind.LOCAL)
    assert reader.on_message(position(5000, (0, 0, 0)), 100.0) is None
    assert reader.on_message(attitude(5000, 1.0, 0.5), 100.0) is None
    pose = reader.on_message(position(5020, (1.0, 2.0, -3.0)), 100.02)
    assert pose is not None
    assert (pose.north_m, pose.east_m, pose.down_m) == (1.0, 2.0, -3.0)
    assert pose.yaw_rad == pytest.approx(1.01)
    assert (pose.v_north_mps, pose.v_east_mps, pose.v_down_mps) == (0.1, 0.2, 0.3)
    assert reader.on_message(position(5500, (1.0, 2.0, -3.0)), 100.5) is None, "an attitude half a second old"


def test_other_messages_are_nothing() -> None:
    """They are neither truth nor wrong."""
    reader = TruthReader(TruthKind.HIL)
    assert reader.on_message(attitude(0, 0.0), 100.0) is None
    assert reader.refused == 0
