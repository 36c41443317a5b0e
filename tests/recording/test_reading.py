"""A recording that is read again: the figures of the flight, and the flight flown again to the last bit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.config.control import ControlSettings
from companion.config.mission import RecordSettings
from companion.control.ground_grid import FREE, GroundGrid
from companion.control.known_ground import CELL_M, NOWHERE, KnownGround, Window
from companion.errors import InputError
from companion.mapping.files.ground_file import ground_content
from companion.model import Mode
from companion.pipeline import Explorer, Order
from companion.recording import Recorder, open_recording
from companion.recording.content import ENDED, ENGAGED
from companion.recording.flight_stats import Figures, figures, render, show_figures
from companion.recording.replay import _then, replay
from companion.station_keeping import StationKeeper
from sitl.mines import load_world
from tests.recording.flights import SETTINGS, fly_in_room, make_info, make_tick
from tests.shared.clocks import HandClock

PAUSE_S = 0.4


def record(file: Path, *, end: bool = True, engage: bool = True) -> None:
    """1 s of looking, 10 s of control at 20 Hz with one pause, 1 s afterwards.

    In control d is 0.8 m (d_s - 0.2 m) for 2 s, and the mode changes twice.
    """
    clock = HandClock(0.0)
    with Recorder(file, RecordSettings(), make_info(), clock) as recorder:
        for n in range(240):
            t_s = clock.time_s = n / 20.0
            if engage and n == 20:
                recorder.event(ENGAGED, "exploring")
            if end and n == 220:
                recorder.event(ENDED, "map complete")
            in_control = 1.0 <= t_s < 11.0
            if in_control and 5.0 < t_s < 5.0 + PAUSE_S - 0.01:
                continue
            mode = Mode.TANGENT if 3.0 <= t_s < 4.0 else Mode.BOUNDARY
            d_m = 0.8 if 6.0 <= t_s < 8.0 else 1.2
            # Before and after, things are as bad as can be: they are not part of the figures.
            recorder.tick(
                make_tick(t_s, mode=mode if in_control else Mode.HOLD, sent=in_control, d_m=d_m if in_control else 0.1)
            )


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Figures:
    file = tmp_path_factory.mktemp("figures") / "flight.mcap"
    record(file)
    return figures(file)


def test_figures_of_a_known_flight(found: Figures) -> None:
    """Each number as it follows from how the flight was made."""
    assert found.damage is None
    assert found.ticks == 240 - 7
    assert found.engaged_s == pytest.approx(10.0, abs=1e-6)
    assert found.ended == "map complete"
    assert found.setpoints == 200 - 7
    assert found.setpoint_rate_hz == pytest.approx(19.3, abs=1e-4)
    interval, depth, ranges, pose, tick = (
        found.setpoint_interval_s,
        found.depth_age_s,
        found.ranges_age_s,
        found.pose_age_s,
        found.tick_s,
    )
    assert interval is not None
    assert depth is not None
    assert ranges is not None
    assert pose is not None
    assert tick is not None
    assert interval.median == pytest.approx(0.05)
    assert interval.largest == pytest.approx(PAUSE_S)
    assert (depth.median, ranges.median, pose.median) == pytest.approx((0.102, 0.052, 0.022))
    assert (tick.median, tick.p99) == pytest.approx((0.002, 0.002))
    assert (found.least_d_m, found.margin_m) == (0.8, 1.0)
    assert found.near_s == pytest.approx(2.0)
    assert found.mode_changes == 2
    assert (found.ticks_dropped, found.frames_dropped) == (0, 0)


def test_a_loop_that_hangs_until_the_end_shows(tmp_path: Path) -> None:
    """A gap without a setpoint after it is a gap: here the last 3 s of control."""
    clock = HandClock(0.0)
    with Recorder(tmp_path / "f.mcap", RecordSettings(), make_info(), clock) as recorder:
        recorder.event(ENGAGED, "exploring")
        for n in range(40):
            recorder.tick(make_tick(n / 20.0))
        recorder.event(ENDED, "stopped", t_s=4.95)
        recorder.tick(make_tick(5.0, sent=False))
    interval = figures(tmp_path / "f.mcap").setpoint_interval_s
    assert interval is not None
    assert interval.largest == pytest.approx(4.95 - 1.952)


def test_flight_without_an_end_counts_to_its_last_tick(tmp_path: Path) -> None:
    """As after a crash."""
    record(tmp_path / "f.mcap", end=False)
    found = figures(tmp_path / "f.mcap")
    assert found.ended is None
    assert found.engaged_s == pytest.approx(11.95 - 1.0, abs=1e-6)


def test_never_engaged(tmp_path: Path) -> None:
    """What was not flown has no rate, instead of one that divides by nothing."""
    record(tmp_path / "f.mcap", engage=False)
    found = figures(tmp_path / "f.mcap")
    assert found.engaged_s is None
    assert found.setpoint_rate_hz is None
    assert found.setpoint_interval_s is None
    assert found.near_s is None
    assert "never" in render(found)


def test_cut_recordings_have_figures(tmp_path: Path) -> None:
    """At every cut after the beginning there are figures, and they say that the file is cut."""
    record(tmp_path / "f.mcap")
    content = (tmp_path / "f.mcap").read_bytes()
    ticks = []
    for share in (0.9, 0.6, 0.3):
        (tmp_path / "cut.mcap").write_bytes(content[: int(len(content) * share)])
        found = figures(tmp_path / "cut.mcap")
        assert found.damage is not None
        assert "up to the cut" in render(found)
        ticks.append(found.ticks)
    assert ticks == sorted(ticks, reverse=True)


def test_other_files_are_refused(tmp_path: Path) -> None:
    """With the name of the file."""
    (tmp_path / "x.mcap").write_text("no recording")
    with pytest.raises(InputError, match=r"x\.mcap"):
        show_figures(tmp_path / "x.mcap", as_json=False)


def test_both_ways_of_showing(tmp_path: Path) -> None:
    """A table for people, JSON with the same numbers for programs."""
    file = tmp_path / "f.mcap"
    record(file)
    data = json.loads(show_figures(file, as_json=True))
    assert data["setpoints"] == 193
    assert data["setpoint_interval_s"]["largest"] == pytest.approx(PAUSE_S)
    text = show_figures(file, as_json=False)
    assert "193 sent, 19.30 Hz" in text
    assert "median 50.0" in text
    assert "least d" in text


# A recording can be flown again, and comes out the same to the last bit.


LONG_S = 20.0


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("flight") / "flight.mcap"
    recorder = fly_in_room(file, LONG_S)
    assert recorder.problem is None
    assert recorder.ticks_dropped == recorder.frames_dropped == 0
    return file


def test_replay_is_exact(flight: Path) -> None:
    """Protects the whole chain: every input of the tick is recorded, exactly, with the seed and the settings."""
    found = replay(flight)
    assert found.stopped is None
    assert found.ticks == round(LONG_S / SETTINGS.control.period_s)
    assert found.compared == round((LONG_S - 1.0) / SETTINGS.control.period_s)
    assert (found.differing, found.largest_difference) == (0, 0.0)
    modes = {tick["mode"] for tick, _ in open_recording(flight).observations()}
    assert found.graph.counts().vertices >= 2
    assert len(modes) >= 2, "a flight without a change of mode would compare little"


HOME_S, WAITS_S, GOES_ON_S = 9.0, 12.0, 13.0


def told_to(t_s: float) -> Order:
    """Home, with a pause on the way."""
    if WAITS_S <= t_s < GOES_ON_S:
        return Order.WAIT
    return Order.HOME if t_s >= HOME_S else Order.EXPLORE


def test_a_flight_that_was_paused_and_came_home_is_flown_again_exactly(tmp_path: Path) -> None:
    """Protects the records of the way home: where it turned back and waited is in them, and who asks steers nothing."""
    file = tmp_path / "flight.mcap"
    fly_in_room(file, LONG_S, order=told_to)
    found = replay(file)
    assert (found.stopped, found.differing, found.largest_difference) == (None, 0, 0.0)
    ticks = [tick for tick, _ in open_recording(file).observations() if tick["stepped"]]
    assert {tick["order"] for tick in ticks} == {order.value for order in Order}
    waiting = [tick for tick in ticks if tick["order"] == Order.WAIT]
    assert len(waiting) == round((GOES_ON_S - WAITS_S) / SETTINGS.control.period_s)
    assert all(abs(tick["speed_mps"]) < 0.1 and tick["yaw_rate_radps"] == 0.0 for tick in waiting)
    assert {tick["mode"] for tick in waiting} == {Mode.HOLD}


def test_without_its_orders_a_flight_that_came_home_is_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The comparison can fail: it sees what the orders have done."""
    file = tmp_path / "flight.mcap"
    fly_in_room(file, WAITS_S + 0.5, order=told_to)
    step = Explorer.step
    monkeypatch.setattr(Explorer, "step", lambda explorer, observation, _: step(explorer, observation))
    found = replay(file)
    assert found.differing > 0
    assert found.first_difference_s is not None
    assert found.first_difference_s >= HOME_S


def ground_of_the_room() -> bytes:
    """What an earlier flight has seen of the simulated room: its whole floor, and nothing about it."""
    corners_m = load_world("room", seed=1).vertices_m
    low_m, high_m = corners_m.min(axis=0), corners_m.max(axis=0)
    columns, rows = np.ceil((high_m - low_m)[:2] / CELL_M).astype(int)
    grid = GroundGrid.unseen(rows, columns)
    grid.cells[:] = FREE
    grid.ground_dm[:] = round(10.0 * float(low_m[2]))
    return ground_content(Window(grid, NOWHERE, float(low_m[0]), float(low_m[1]), CELL_M))


def test_a_flight_that_went_on_from_earlier_ground_is_flown_again_exactly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Protects the records of a second sortie: what it knew before it began decides where it flies."""
    file, content = tmp_path / "flight.mcap", ground_of_the_room()
    fly_in_room(file, LONG_S, earlier=content)
    assert open_recording(file).info.known_ground == content
    found = replay(file)
    assert (found.stopped, found.differing, found.largest_difference) == (None, 0, 0.0)
    assert found.compared == round((LONG_S - 1.0) / SETTINGS.control.period_s)
    monkeypatch.setattr(KnownGround, "go_on_from", lambda *_: None)
    assert replay(file).differing > 0, "without it another flight"


def test_earlier_ground_that_is_of_no_use_now_is_told(tmp_path: Path) -> None:
    """With settings that make other cells of the ground the flight cannot be flown again."""
    file = tmp_path / "flight.mcap"
    fly_in_room(file, 1.2, earlier=ground_of_the_room())
    narrow = SETTINGS.model_copy(update={"control": SETTINGS.control.model_copy(update={"critical_margin_m": 0.5})})
    with pytest.raises(
        InputError, match=r"flight\.mcap: it went on from .* its cells are 0\.5 m wide, .* 0\.3125 m; give"
    ):
        replay(file, narrow)


def test_a_part_to_the_left_is_recorded_and_compared(flight: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protects the replay of a vehicle that is led back to where it stands: that may be to the left alone."""
    ticks = [tick for tick, _ in open_recording(flight).observations() if tick["stepped"]]
    aside = sum(tick["lateral_mps"] != 0.0 for tick in ticks)
    assert 0 < aside < len(ticks)
    forward = StationKeeper.velocity

    def without_left(keeper: StationKeeper, *told: Any) -> tuple[float, float, float]:
        ahead_mps, _, up_mps = forward(keeper, *told)
        return ahead_mps, 0.0, up_mps

    monkeypatch.setattr(StationKeeper, "velocity", without_left)
    assert replay(flight).differing == aside


def test_replay_tells_what_another_setting_changes(flight: Path) -> None:
    """The comparison can fail: it sees the first setpoint that another law would have sent."""
    faster = SETTINGS.model_copy(update={"control": ControlSettings.model_validate({"speed_mps": 0.55})})
    found = replay(flight, faster)
    assert found.differing > 0
    assert found.first_difference_s is not None
    assert found.largest_difference > 0.0


def test_replay_of_a_cut_file_is_exact_up_to_the_cut(flight: Path, tmp_path: Path) -> None:
    """A crash ends the file anywhere; what came before is what one wants to see again."""
    cut = tmp_path / "cut.mcap"
    content = flight.read_bytes()
    cut.write_bytes(content[: len(content) * 2 // 3])
    found = replay(cut)
    assert found.stopped is not None
    assert found.compared > 50
    assert found.differing == 0


def test_replay_without_depth_stops_where_the_first_image_is_missing(tmp_path: Path) -> None:
    """Flying on without an image would compare two different flights."""
    file = tmp_path / "flight.mcap"
    fly_in_room(file, 2.0, record=RecordSettings(depth=False))
    found = replay(file)
    assert found.stopped is not None
    assert "depth image" in found.stopped


@pytest.mark.parametrize("name", ["speed_mps", "climb_mps", "yaw_rate_radps"])
def test_a_tick_that_lacks_what_was_always_recorded_is_damaged(name: str) -> None:
    """Protects from comparing with a zero that nobody sent; to the left alone, older ticks ask for nothing."""
    tick = {"stepped": True, "speed_mps": 0.4, "climb_mps": 0.0, "yaw_rate_radps": 0.1, "mode": "R3"}
    tick["wanted_height_m"] = 1.5
    then = _then(tick)
    assert then is not None
    assert then.setpoint == (0.4, 0.0, 0.1, 0.0)
    with pytest.raises(KeyError, match=name):
        _then({key: value for key, value in tick.items() if key != name})


def test_replay_of_settings_that_are_refused_now(flight: Path, tmp_path: Path) -> None:
    """An old recording with a setting that no longer exists is refused with its name, not with a traceback."""
    content = flight.read_bytes()
    assert content.count(b"margin_m: 1.0") >= 1
    file = tmp_path / "old.mcap"
    file.write_bytes(content.replace(b"target_radius_m", b"gone_radius_mmm"))
    with pytest.raises(InputError, match="gone_radius_mmm"):
        replay(file)


def test_pixels_come_back_to_the_last_bit(flight: Path) -> None:
    """NaN, infinity and noise of depth images survive: unknown must not turn into free."""
    frames = [o.frame.depth_m for _, o in open_recording(flight).observations() if o is not None and o.frame]
    assert len(frames) > 50
    assert all(frame.dtype == np.float32 and frame.shape == (48, 64) for frame in frames)
    assert any(np.isnan(frame).any() for frame in frames)
