"""Files of an earlier version: a recording, a map journal and settings mean today what they meant to it."""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from companion.cli.main import main
from companion.config.load import load_settings
from companion.recording import open_recording
from companion.recording.replay import replay

HERE = Path(__file__).parent

Printed = Callable[..., str]


@pytest.fixture
def printed(capsys: pytest.CaptureFixture[str]) -> Printed:
    """Runs a command of `companion`, which must succeed, and gives what it prints."""

    def run(*words: object) -> str:
        with pytest.raises(SystemExit) as ended:
            main([str(word) for word in words])
        found = capsys.readouterr()
        assert ended.value.code in (None, 0), found.err
        return found.out

    return run


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    file = tmp_path / "flight.mcap"
    file.write_bytes(gzip.decompress((HERE / "flight.mcap.gz").read_bytes()))
    return file


@pytest.fixture
def journal(tmp_path: Path) -> Path:
    """A copy: opening a journal locks it with a file beside its segments."""
    return Path(shutil.copytree(HERE / "map.journal", tmp_path / "map.journal"))


def test_recording_is_read_whole(flight: Path) -> None:
    """Protects the archive of flights: every tick, input and pixel is there."""
    recording = open_recording(flight)
    ticks = list(recording.observations())
    assert recording.damage is None
    assert [tick["number"] for tick, _ in ticks] == list(range(50))
    seen = [observation for _, observation in ticks if observation is not None]
    assert len(seen) == 50
    frames = {o.frame.t_s: o.frame for o in seen if o.frame is not None}
    assert {frame.depth_m.shape for frame in frames.values()} == {(24, 32)}
    assert {len(o.ranges) for o in seen} == {4}
    assert any(o.planar is not None for o in seen)
    assert {tick["mode"] for tick, _ in ticks} == {"R1", "R2"}


def test_figures_of_an_earlier_recording(flight: Path, printed: Printed) -> None:
    """Protects comparisons over the years: the same flight has the same figures."""
    found = json.loads(printed("figures", flight, "--json"))
    assert found["damage"] is None
    assert (found["ticks"], found["setpoints"], found["mode_changes"]) == (50, 39, 1)
    assert (found["ended"], found["ticks_dropped"], found["frames_dropped"]) == ("time is up", 0, 0)
    assert found["engaged_s"] == pytest.approx(3.9)
    assert found["setpoint_rate_hz"] == pytest.approx(10.0)
    assert found["depth_age_s"]["median"] == pytest.approx(0.201)
    assert (found["least_d_m"], found["margin_m"], found["near_s"]) == (pytest.approx(1.3830243101452349), 1.1, 0.0)


def test_replay_of_an_earlier_recording(flight: Path, printed: Printed) -> None:
    """Protects the law through every rewriting: the setpoints of that version, to the last bit.

    Not tied to the processor it was recorded on: kernels without AVX-512 gave the same bits. If a processor or a
    release of numpy rounds differently one day, that is a difference of some 1e-16, not a change of the law.
    """
    found = replay(flight)
    assert (found.ticks, found.compared, found.stopped) == (50, 40, None)
    assert (found.differing, found.largest_difference) == (0, 0.0)
    assert printed("replay", flight) == "50 ticks flown again, 40 setpoints compared, 0 differ\n"


def test_earlier_map_journal(journal: Path, printed: Printed) -> None:
    """Protects the maps: as many voxels of each kind as that version counted."""
    found = json.loads(printed("map", "info", journal, "--json"))
    facts = found["facts"]
    assert (facts["chunks"], facts["occupied"], facts["free"], facts["undecided"]) == (18, 2307, 3423, 155)
    assert facts["low_m"] == pytest.approx([-0.2, -0.2, -0.2])
    assert facts["high_m"] == pytest.approx([6.4, 3.8, 2.8])
    assert facts["surface_m2"] == pytest.approx(36.311, abs=1e-3)
    assert (found["header"]["voxel_m"], found["header"]["frame"]) == (0.2, "east-north-up")
    assert (found["losses"], found["torn_bytes"]) == (0, 0)


def test_earlier_settings_mean_the_same() -> None:
    """Protects vehicles that are not touched by an update: no key is refused, and none has another value.

    Keys that are newer than the file may be added.
    """
    then = json.loads((HERE / "effective.json").read_text(encoding="utf-8"))
    now = load_settings(HERE / "settings.yaml").model_dump(mode="json")
    assert _picked(now, then) == then


def _picked(now: Any, then: Any) -> Any:
    """Of the mappings in ``now`` only the keys that ``then`` has."""
    return {key: _picked(now[key], then[key]) for key in then} if isinstance(then, dict) else now
