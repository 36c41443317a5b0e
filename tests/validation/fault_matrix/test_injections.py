"""What the faults of the matrix make of messages and images, and what tells a computer that stood still."""

from __future__ import annotations

import math
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.config.settings import Settings
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
from validation.fault_matrix import run
from validation.fault_matrix.faults import BY_NAME, FAULTS
from validation.fault_matrix.injection import Final
from validation.fault_matrix.link_faults import LINK_FAULTS
from validation.fault_matrix.outcome import Outcome
from validation.fault_matrix.run import ATTEMPTS, StoodStillError, fly, patience_s, stood_still
from validation.fault_matrix.sensor_faults import SENSOR_FAULTS
from validation.fault_matrix.standstill import HOST, LOOK_S, NOBODY, WIRES, Standstill, Wait
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


# What tells a computer that stood still from a gate that did.


GATE = 17


@pytest.fixture(autouse=True)
def processors(tmp_path: Path) -> None:
    stolen(tmp_path, 0)


def stolen(proc: Path, ticks: int) -> None:
    """The kernel says how long the second processor was given to others, in hundredths of a second."""
    lines = [f"{name} 1 2 3 4 5 6 7 {found} 9 10\n" for name, found in (("cpu", 777), ("cpu0", 50), ("cpu1", ticks))]
    (proc / "stat").write_text("".join([*lines, "intr 17 4 2 9 8 7 6 5 4 3 2\n"]))


def told(proc: Path, thread: int, waited_s: float, of: int = GATE) -> None:
    """The kernel says how long a thread has waited for a processor since it began."""
    folder = proc / str(of) / "task" / str(thread)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "schedstat").write_text(f"123456789 {round(waited_s * 1e9)} 42\n")


def test_it_finds_the_longest_wait_of_any_thread(tmp_path: Path) -> None:
    """Protects the verdict on the gate: a writer of its log that is not run may hold up the thread that steers."""
    standstill = Standstill({"the gate": GATE}, tmp_path)
    told(tmp_path, 17, 5.0)
    told(tmp_path, 18, 0.0)
    standstill.look(10.0)
    assert standstill.longest(0.0, 100.0) == NOBODY, "what it waited before is no wait of this flight"
    told(tmp_path, 17, 5.1)
    standstill.look(10.02)
    told(tmp_path, 18, 0.6)
    standstill.look(10.04)
    told(tmp_path, 17, 5.3)
    standstill.look(10.06)

    longest = standstill.longest(10.0, 11.0)
    assert (longest.ended_s, longest.who) == (10.04, "the gate")
    assert longest.lasted_s == pytest.approx(0.6)
    assert standstill.longest(10.05, 11.0).lasted_s == pytest.approx(0.2)
    assert standstill.longest(10.07, 11.0) == NOBODY


def test_a_thread_that_begins_or_a_process_that_ends_is_no_standstill(tmp_path: Path) -> None:
    """Protects the flights in which a process is killed: they must be judged."""
    standstill = Standstill({"the gate": GATE, "nobody there": 18}, tmp_path)
    standstill.look(10.0)
    told(tmp_path, 17, 3.0)
    standstill.look(10.02)
    (tmp_path / str(GATE) / "task" / "17" / "schedstat").unlink()
    standstill.look(10.04)
    assert standstill.longest(0.0, 100.0) == NOBODY


def test_it_notes_when_it_was_not_run_itself(tmp_path: Path) -> None:
    """Protects against a computer that stands still as a whole, where no thread is told to have waited."""
    standstill = Standstill({}, tmp_path)
    standstill.look(10.0)
    standstill.look(10.0 + LOOK_S + 0.7)
    assert standstill.longest(0.0, 100.0).lasted_s == pytest.approx(0.7)
    assert str(standstill.longest(0.0, 100.0)) == f"{WIRES} for 0.70 s"


def test_it_notes_a_processor_that_the_host_has_taken_away(tmp_path: Path) -> None:
    """Protects against a virtual machine that is held up: the gate ran by the clock of the kernel, and did not."""
    standstill = Standstill({}, tmp_path)
    standstill.look(10.0)
    stolen(tmp_path, 60)
    standstill.look(10.02)
    assert standstill.longest(0.0, 100.0) == Wait(10.02, 0.6, HOST)

    for look in range(1, 40):
        stolen(tmp_path, 60 + 2 * (look // 2))
        standstill.look(10.1 + LOOK_S * look)
    in_pieces = standstill.longest(10.7, 11.0)
    assert in_pieces.who == HOST
    assert in_pieces.lasted_s == pytest.approx(0.25, abs=0.03), "half of the time, in any half second"


def test_it_reads_what_the_kernel_really_tells() -> None:
    """Protects against a file of another form: then no wait would ever be found."""
    columns = Path("/proc/self/schedstat").read_text(encoding="ascii").split()
    assert len(columns) == 3
    assert all(column.isdecimal() for column in columns)
    with Standstill({}) as standstill:
        time.sleep(3.0 * LOOK_S)
    assert standstill._looked_s is not None


def flight(*waits: Wait) -> Any:
    standstill = Standstill({})
    standstill._waits.extend(waits)
    return SimpleNamespace(settings=Settings(), standstill=standstill)


def test_a_flight_is_not_judged_when_the_computer_stood_still_for_longer_than_the_autopilot_waits() -> None:
    """Protects both verdicts: a failsafe that the computer caused is no fault of the gate, and any other one is."""
    limit_s = patience_s(Settings())
    assert 0.3 < limit_s < Settings().autopilot.silence_s

    assert stood_still(flight(Wait(5.0, limit_s, "the gate")), 4.0, 6.0) == limit_s, "the gate should have coped"
    assert stood_still(flight(Wait(3.9, 1.0, "the gate")), 4.0, 6.0) == 0.0, "before the fault"
    with pytest.raises(StoodStillError, match=r"the autopilot for 0\.60 s"):
        stood_still(flight(Wait(5.0, 0.6, "the autopilot")), 4.0, 6.0)


def outcome(attempts: int = 1) -> Outcome:
    fault = BY_NAME["SIGKILL application"]
    return Outcome(
        fault.name, fault.group, "px4", 0.4, 1.4, 0.0, 0.2, 1.2, 0, Final.HELD, ("brake",), None, attempts=attempts
    )


def test_it_flies_again_and_not_for_ever(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Protects the promise that nothing unjudged passes: the last attempt that shows nothing is an error."""
    flown: list[Path] = []

    def second_time_lucky(_injection: object, _personality: str, folder: Path) -> Outcome:
        flown.append(folder)
        if len(flown) < 2:
            raise StoodStillError("the gate for 0.60 s")
        return outcome()

    monkeypatch.setattr(run, "_fly", second_time_lucky)
    assert fly("SIGKILL application", "px4", tmp_path) == outcome(attempts=2)
    assert len(flown) == 2

    def never(*_: object) -> Outcome:
        flown.append(tmp_path)
        raise StoodStillError("the gate for 0.60 s")

    flown.clear()
    monkeypatch.setattr(run, "_fly", never)
    with pytest.raises(StoodStillError):
        fly("SIGKILL application", "px4", tmp_path)
    assert len(flown) == ATTEMPTS
