"""Which of several vehicles is which, and where each starts."""

from __future__ import annotations

import json
import math
from itertools import combinations
from pathlib import Path

import pytest

from companion.cli.main import main
from companion.config.load import load
from companion.errors import InputError
from sitl.launch.fleet import Seat, seats
from sitl.launch.processes import Crew, FlightPlan
from sitl.mines.placing import Reading
from sitl.world.placement import Scene

ENDPOINTS, WORLD_PORTS = [f"tcp/127.0.0.1:{port}" for port in (5001, 5002, 5003)], [6001, 6002, 6003]


@pytest.fixture(scope="module")
def three() -> tuple[Seat, ...]:
    return seats("complex", Reading(), 2, "flight", ENDPOINTS, WORLD_PORTS)


def test_each_stands_where_its_application_is_told(three: tuple[Seat, ...], tmp_path: Path) -> None:
    """The place in the mine, on the floor, in the shared frame: what the world shows and what is configured are one."""
    for seat in three:
        crew = Crew(FlightPlan(tmp_path, world="complex", seed=2, seat=seat))
        settings = crew.write_settings()
        x_m, y_m, z_m, yaw_rad = map(float, seat.start_options()[1:])
        stand = Scene.load("complex", 2, (x_m, y_m, z_m, yaw_rad), settings).stand
        assert settings.fleet.start_pose == pytest.approx((stand.x_m, stand.y_m, stand.z_m, stand.yaw_rad), abs=1e-3)
        assert (settings.fleet.number, settings.autopilot.system_id) == (seat.number, seat.number)
        assert settings.link.enabled
        assert settings.link.name == f"vehicle-{seat.number}"
        assert settings.link.listen == (ENDPOINTS[seat.number - 1],)
        # Each pair has one connection.
        assert settings.link.connect == tuple(ENDPOINTS[: seat.number - 1])
        assert json.loads(crew.config.read_text(encoding="utf-8"))["preset"] == "flight"


def test_they_start_apart_and_choose_apart(three: tuple[Seat, ...], tmp_path: Path) -> None:
    """Two margins from each other at least; with one seed for their draws they would choose the same."""
    margin_m = load(None, "flight").settings.control.margin_m
    for one, other in combinations(three, 2):
        apart_m = math.hypot(one.start.x_m - other.start.x_m, one.start.y_m - other.start.y_m)
        assert apart_m >= 2.0 * margin_m
    plans = [FlightPlan(tmp_path, world="complex", seed=2, seat=seat) for seat in three]
    drawn = [words[words.index("--seed") + 1] for words in (Crew(plan).application() for plan in plans)]
    assert drawn == ["2", "3", "4"]


def test_worlds_hear_all_others_and_not_themselves(three: tuple[Seat, ...]) -> None:
    """As `companion sitl world` takes it."""
    words = three[1].world_options()
    assert words[words.index("--neighbours-port") + 1] == "6002"
    assert [words[k + 1] for k, word in enumerate(words) if word == "--neighbour"] == ["6001", "6003"]


def test_several_real_autopilots_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Both would listen on the same ports of one network."""
    with pytest.raises(SystemExit) as ended:
        main(["sitl", "fly", "--vehicles", "2", "--real", "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert "--vehicles 2: --real flies one" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_more_than_can_meet_are_refused() -> None:
    """By the name of the setting."""
    with pytest.raises(InputError, match=r"fleet.largest_group = 3"):
        seats("complex", Reading(), 2, "flight", [*ENDPOINTS, "tcp/127.0.0.1:5004"], [*WORLD_PORTS, 6004])
