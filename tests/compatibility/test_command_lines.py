"""Command lines of an earlier version are still accepted: scripts and services have them written down."""

from __future__ import annotations

import shlex

import pytest
from typer.core import TyperCommand

from companion.cli.main import main

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
