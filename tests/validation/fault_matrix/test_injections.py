"""What the faults of the matrix make of messages and images: each must be the fault that its name says."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.mavlink.estimator import estimator_valid
from companion.mavlink.firmware import AutopilotKind
from companion.model import Beam, Camera, RangeReading
from companion.sensors.drivers.messages import DepthImage, Ranges
from companion.sensors.sink import RawDepth, SensorSink
from sitl.autopilot.codec import Decoder
from sitl.autopilot.mavlink import Message
from sitl.autopilot.mavlink import dialect as m
from tests.integration.relay import pack
from tests.shared.clocks import HandClock
from validation.fault_matrix.faults import FAULTS
from validation.fault_matrix.link_faults import LINK_FAULTS
from validation.fault_matrix.sensor_faults import SENSOR_FAULTS
from validation.fault_matrix.stream_relay import HONEST

CAMERA = Camera(4, 3, 2.0, 2.0, 1.5, 1.0, 0.2, 8.0)


def injected(name: str) -> Any:
    """What the fault does to relays that are none."""
    relay = SimpleNamespace(alter_down=None)
    stream = SimpleNamespace(depth=HONEST, ranges=HONEST)
    flight: Any = SimpleNamespace(relay=relay, stream=stream, personality="px4")
    (fault,) = [fault for fault in (*LINK_FAULTS, *SENSOR_FAULTS) if fault.name == name]
    fault.inject(flight)
    return flight


def through(alter: Any, message: Message) -> list[Message]:
    """What arrives in the place of a message."""
    (received,) = Decoder().messages(pack(message, (1, 1)))
    pieces = alter(received)
    return [received] if pieces is None else Decoder().messages(b"".join(pieces))


def position(boot_ms: int, north_m: float) -> Message:
    return m.MAVLink_local_position_ned_message(boot_ms, north_m, 2.0, -1.5, 0.5, 0.0, 0.1)


def positions(name: str) -> list[Message]:
    """Three positions on the way, as a fault lets them arrive."""
    alter = injected(name).relay.alter_down
    return [found for k in range(3) for found in through(alter, position(1000 + 20 * k, 1.0 + k))]


def test_names_are_unique_and_the_matrix_holds_more_than_thirty() -> None:
    """Protects the table: one row for each fault, and as many as were promised."""
    names = [fault.name for fault in FAULTS]
    assert len(set(names)) == len(names) >= 30


def test_the_position_jumps_freezes_and_goes_backwards_as_it_should() -> None:
    """Protects the rows of the pose: a fault that is another one proves nothing of this one."""
    assert [found.x for found in positions("pose jump")] == [3.0, 4.0, 5.0]
    frozen = positions("pose frozen while moving")
    assert [(found.time_boot_ms, found.x, found.vx) for found in frozen] == [
        (1000 + 20 * k, 1.0, 0.5) for k in range(3)
    ]
    assert [found.time_boot_ms for found in positions("pose stamps going back")] == [1000, 980, 960]
    assert all(math.isnan(found.x) and math.isnan(found.vz) for found in positions("pose NaN"))
    assert positions("pose silent") == []


def test_lost_messages_are_lost_and_no_others() -> None:
    """Protects the rows that silence one message: the rest of the link is as healthy as ever."""
    assert len(positions("heartbeat lost")) == len(positions("pose without attitude")) == 3
    assert positions("autopilot not heard") == []
    heartbeat = m.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
    assert through(injected("heartbeat lost").relay.alter_down, heartbeat) == []


def test_the_estimator_says_what_makes_it_invalid() -> None:
    """Protects the row of the estimator: the flags must mean what the product reads in them."""
    healthy = m.ESTIMATOR_ATTITUDE | m.ESTIMATOR_VELOCITY_HORIZ | m.ESTIMATOR_VELOCITY_VERT | m.ESTIMATOR_POS_HORIZ_REL
    alter = injected("pose not known to the estimator").relay.alter_down
    for kind, message in (
        (AutopilotKind.PX4, m.MAVLink_estimator_status_message(1, healthy, *[0.1] * 8)),
        (AutopilotKind.ARDUPILOT, m.MAVLink_ekf_status_report_message(healthy, *[0.1] * 5)),
    ):
        assert estimator_valid(kind, message.flags)
        (found,) = through(alter, message)
        assert not estimator_valid(kind, found.flags)


@pytest.mark.parametrize(
    ("name", "accepted"),
    [
        ("depth NaN", 0),
        ("depth all zeros", 0),
        ("depth all maximum", 0),
        ("depth stamps from the future", 0),
        ("depth stamps going back", 1),
        ("depth silent", 0),
        ("depth frozen", 3),
    ],
)
def test_depth_faults_blind_the_application_or_deceive_it(name: str, accepted: int) -> None:
    """Protects the limits in the table: what the sink refuses shows as an age, and what it takes must be found out.

    That a frozen image repeats itself shows only when the vehicle moves, which the sink does not know.
    """
    change = injected(name).stream.depth.depth
    clock = HandClock(100.0)
    sink = SensorSink(clock)
    taken = []
    for k in range(3):
        clock.time_s = 100.0 + 0.2 * k
        made = change(DepthImage(clock.now_s(), np.full((3, 4), 3.0 + k, np.float32)), CAMERA)
        if made is not None:
            sink.depth(RawDepth(made.t_s, made.depth_m, CAMERA))
        depth = sink.take().depth
        taken += [] if depth is None else [float(depth.depth_m[0, 0])]
    assert len(taken) == accepted
    assert len(set(taken)) <= 1


@pytest.mark.parametrize(
    ("name", "read_m"),
    [
        ("ranges frozen", [2.0, 2.0]),
        ("ranges NaN", [math.nan, math.nan]),
        ("ranges all zeros", [0.0, 0.0]),
        ("ranges all maximum", [6.0, 6.0]),
        ("ranges silent", []),
    ],
)
def test_range_faults_say_what_their_names_say(name: str, read_m: list[float]) -> None:
    """Protects the rows of the rangefinders."""
    change = injected(name).stream.ranges.ranges
    found = []
    for k in range(2):
        made = change(Ranges((RangeReading(Beam.FRONT, 1.0 + k, 2.0 + k, 6.0),)))
        found += [] if made is None else list(made.readings)
    assert [reading.range_m for reading in found] == pytest.approx(read_m, nan_ok=True)
    assert [reading.t_s for reading in found] == [1.0, 2.0][: len(found)]


def test_stamps_of_ranges_run_back_or_ahead() -> None:
    """Protects the rows of the rangefinders' stamps."""
    readings = [Ranges((RangeReading(Beam.FRONT, 10.0 + k, 2.0, 6.0),)) for k in range(3)]
    back = injected("ranges stamps going back").stream.ranges.ranges
    ahead = injected("ranges stamps from the future").stream.ranges.ranges
    assert [back(one).readings[0].t_s for one in readings] == [10.0, 9.0, 8.0]
    assert [ahead(one).readings[0].t_s for one in readings] == [15.0, 16.0, 17.0]
