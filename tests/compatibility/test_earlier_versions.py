"""What an earlier version wrote down still works: recordings, journals, settings, command lines."""

from __future__ import annotations

import gzip
import json
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.core import TyperCommand

from companion.cli.main import main
from companion.config.load import load_settings
from companion.pipeline import Explorer
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


def test_an_earlier_recording_is_measured_as_then(flight: Path) -> None:
    """Protects perception through every rewriting: heights of that version, but for rounding.

    d to 5 mm: the memory keeps every pixel now, where it kept the nearest of each bearing. The slope to 2 mm a metre:
    beyond the last ground that was seen the profile goes on as beside.

    Not tied to the processor it was recorded on: kernels without AVX-512 gave the same bits. If a processor or a
    release of numpy rounds differently one day, that is a difference of some 1e-16, not a change of what is measured.
    """
    recording = open_recording(flight)
    settings = load_settings(HERE / "settings.yaml")
    explorer = Explorer(settings, np.random.default_rng(0))
    compared = 0
    for tick, observation in recording.observations():
        if observation is None:
            continue
        found = explorer.look(observation)
        exact = dict.fromkeys(("h_m", "roof_m"), 1e-12) | {"ground_slope": 0.002}
        near = {"d_m": 0.005, "d_front_m": 0.005, "d_bearing_rad": 0.2, "d_dot_mps": 0.1}
        for name, within in (exact | near).items():
            then = tick[name]
            if name == "ground_slope" and found.ground_slope is None:
                continue  # told no longer where a wall stands on the only ground in view
            assert getattr(found, name) == (None if then is None else pytest.approx(then, abs=within)), name
        compared += 1
    assert compared == 50


def test_an_earlier_recording_is_replayed_and_what_the_law_does_otherwise_is_told(flight: Path) -> None:
    """Protects the comparison: every setpoint is, and each is one that this law may give.

    The law has changed since: what stands is led back, and what lies beside no longer slows a flight.
    """
    found = replay(flight)
    assert (found.ticks, found.compared, found.stopped) == (50, 40, None)
    assert 0 < found.differing <= 40
    assert 0.0 < found.largest_difference <= load_settings(HERE / "settings.yaml").control.speed_mps


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


# Command lines of an earlier version are still accepted: scripts and services have them written down.


# Every command and every option that version 4e06dac showed in its `--help`.
EARLIER = """
run
run --config f.yaml --preset flight --start now --seed 1 --fix --skip battery --skip=home --resume-map flights/1
run --start key
run --start command
check
check --config f.yaml --preset flight --fix --skip battery --skip=home
figures flight.mcap
figures --json flight.mcap
replay flight.mcap
replay flight.mcap --config f.yaml --json
config show
config show --config f.yaml --preset table_i
config check f.yaml
config check f.yaml --preset table_ii
config schema
safety budget
safety budget --config f.yaml --preset flight --json
safety faults
safety faults --config f.yaml --preset flight
safety example
map info mission
map info mission --json
map export mission a.ply b.laz
map export mission a.ply --mesh --box -1 -1 -1 1 1 1 --overwrite
map merge one two -o both.journal
map merge one two three --out both.journal --overwrite
map view mission
map view mission --port 8080 --host 127.0.0.1 --points 100000
map view mission --picture a.png --overwrite
sim
sim --world room --seed 1 --preset flight --config f.yaml --time-limit 60 --out runs/1 --vehicles 2 --start 0 0 1 -0.5
sitl autopilot
sitl autopilot --personality ardupilot --system-id 2 --to 127.0.0.1:14540 --to 127.0.0.1:14550 --bind-port 0
sitl autopilot --tcp 5760 --control 5770 --start 0 0 1 -0.5 --world room --seed 1 --config f.yaml --preset flight
sitl autopilot --no-gps --boot-s 2 --battery-percent 80 --battery-minutes 10 --param COM_OF_LOSS_T=0.5 --drop 0.1
sitl autopilot --speed 2 --signing-key key
sitl world
sitl world --world room --seed 1 --truth udp://127.0.0.1:14560 --truth-from auto --truth-hz 100 --system-id 2
sitl world --truth-from hil --stream tcp://127.0.0.1:14600 --start 0 0 1 -0.5 --vehicle 1
sitl world --truth-from sim --config f.yaml --preset flight
sitl world --truth-from local --no-gps --send-distance-sensor --send-obstacle-distance --stop-on-contact
sitl world --odometry none --odometry-hz 50 --odometry-noise 0.02 --odometry-attitude-noise 0.01
sitl world --odometry odometry --odometry-velocity-noise 0.02 --odometry-drift 0.01 --odometry-delay 0.1
sitl world --odometry vision --odometry-loss 0.1 --odometry-outage 10 2 --odometry-align start
sitl world --odometry-align north --score score.json --trajectory t.csv --verbose
sitl world -v
sitl fly
sitl fly --personality ardupilot --no-gps --world room --seed 1 --time-limit 60 --boot-s 2 --out runs/1
""".strip().splitlines()


@pytest.mark.parametrize("line", EARLIER)
def test_earlier_command_line(line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Parsed and converted as for a real call, up to the point where the command would begin."""
    called: list[str | None] = []
    monkeypatch.setattr(TyperCommand, "invoke", lambda command, _context: called.append(command.name))
    with pytest.raises(SystemExit) as ended:
        main(shlex.split(line))
    assert ended.value.code in (None, 0)
    assert called, "no command was reached"
    assert called[0] in line.split()[:2]
