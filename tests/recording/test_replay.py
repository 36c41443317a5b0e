"""A recording can be flown again, and comes out the same to the last bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.config.control import ControlSettings
from companion.config.mission import RecordSettings
from companion.errors import InputError
from companion.recording import open_recording
from companion.recording.replay import replay
from tests.recording.flights import SETTINGS, fly_in_room

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
    assert len(modes) >= 2, "a flight without a change of mode would compare little"


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
