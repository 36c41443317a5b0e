"""What the application and the world of a flight are started with: the same addresses on both sides."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import psutil
import pytest

from companion.config.settings import Settings
from companion.gate.runtime.supervisor import GONE_S
from sitl.launch.processes import WORLD_SERVES, Crew, FlightPlan, odometry_options, run_to_its_end, with_odometry
from sitl.launch.program import Program, Running
from sitl.mines.placing import Reading
from tests.shared.beside import wait_until

STATION = {"url": "udpout://127.0.0.1:14550", "may": "command"}


@pytest.mark.parametrize(("personality", "hz"), [("px4", "30"), ("ardupilot", "50")])
def test_without_gps_the_world_feeds_odometry_as_the_autopilot_needs_it(personality: str, hz: str) -> None:
    """Protects from an estimator that starves, or is flooded."""
    options = odometry_options(personality)
    assert options[options.index("--odometry-hz") + 1] == hz
    assert "--odometry-to" not in options, "to the autopilot itself"


def test_odometry_through_the_gate_arrives_where_the_gate_listens() -> None:
    """Protects from odometry that freezes or ends and that the gate cannot notice, because it never hears it."""
    (one,) = with_odometry({}, 14777)["safety"]["attached"]
    assert one == {"url": "udpin://127.0.0.1:14777", "may": "odometry"}
    options = odometry_options("px4", 14777)
    assert options[options.index("--odometry-to") + 1] == one["url"].replace("udpin", "udpout")


def test_autopilot_and_world_read_a_mesh_alike(tmp_path: Path) -> None:
    """Protects from a vehicle that stands on a floor a thousand times as far away as the one that it is shown."""
    crew = Crew(FlightPlan(tmp_path, world="mm.ply", mesh=Reading(scale=0.001, up="y").options()))
    for program in (crew._autopilot(Settings()), crew._world()):
        given = list(program.arguments)
        assert given[given.index("--world") + 1] == "mm.ply"
        assert given[given.index("--scale") + 1] == "0.001"
        assert given[given.index("--up") + 1] == "y"


def test_what_the_world_says_of_its_mine_is_told(tmp_path: Path) -> None:
    crew = Crew(FlightPlan(tmp_path))
    crew.world = Running(Program("world", ["true"], WORLD_SERVES), tmp_path)
    crew.world.process.wait()
    crew.world.log.write_text(f"12 triangles\nfar from 0\nroom: ...; {WORLD_SERVES} at udp\nmore\n", encoding="utf-8")
    assert crew.about_the_mine() == ["12 triangles", "far from 0"]


def test_who_is_attached_already_stays_attached() -> None:
    """A list in an upper layer of the settings takes the place of a lower one: nobody may be lost by that."""
    safety = with_odometry({"safety": {"attached": [STATION], "restarts": 1}}, 14777)["safety"]
    assert [one["may"] for one in safety["attached"]] == ["command", "odometry"]
    assert safety["restarts"] == 1


LANDS = """
import pathlib, signal, sys, time
def land(*_):
    time.sleep(0.3)  # it takes its time, and nobody kills it meanwhile
    pathlib.Path(sys.argv[1]).write_text("landed")
    sys.exit(7)
signal.signal(signal.SIGINT, land)
pathlib.Path(sys.argv[1] + ".flies").touch()
time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_whoever_ends_the_command_lets_the_application_land(tmp_path: Path, number: signal.Signals) -> None:
    """Protects a flight from a supervisor: the application and what it flew by were left running, without a word."""
    landed, flies = tmp_path / "landed", tmp_path / "landed.flies"

    def end_it() -> None:
        while not flies.exists():
            pass
        os.kill(os.getpid(), number)

    threading.Thread(target=end_it).start()
    before = signal.getsignal(number)
    assert run_to_its_end([sys.executable, "-c", LANDS, str(landed)]) == 7
    assert landed.read_text(encoding="utf-8") == "landed"
    assert signal.getsignal(number) == before


LAUNCHES = """
import os, pathlib, signal, sys
from sitl.launch.program import Program, Running
one = Running(Program("sleeper", ("sleep", "60"), "never"), pathlib.Path(sys.argv[1]), niceness=1)
print(one.process.pid, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_was_started_ends_when_the_launcher_is_killed(tmp_path: Path) -> None:
    """Protects the computer from autopilots and worlds that nobody has: before, they ran on for ever."""
    said = subprocess.run([sys.executable, "-c", LAUNCHES, str(tmp_path)], stdout=subprocess.PIPE, check=False).stdout
    wait_until(lambda: not psutil.pid_exists(int(said)), "it has ended with who started it")


@pytest.mark.flight
def test_a_flight_whose_launcher_is_killed_leaves_nothing_running(tmp_path: Path) -> None:
    """Protects the same for all of a flight: the gate first tries to land, and the map is written."""
    log = tmp_path / "log"
    command = [sys.executable, "-m", "companion", "sitl", "fly", "--out", str(tmp_path / "flight"), "--boot-s", "1"]
    with log.open("wb") as words:
        launcher = subprocess.Popen(command, stdout=words, stderr=subprocess.STDOUT, start_new_session=True)
    try:
        wait_until(lambda: b"\nexploring\n" in log.read_bytes(), "it flies", 110.0)
        family = psutil.Process(launcher.pid).children(recursive=True)
        assert len(family) >= 6, "autopilot, world, gate, application, map, and what multiprocessing keeps"
    finally:
        launcher.kill()
        launcher.wait()
    _, alive = psutil.wait_procs(family, timeout=GONE_S + 15.0)
    assert not alive, "10 s for an autopilot that is gone, and the writing of a small map"
    assert len(list((tmp_path / "flight").glob("*/map.bt"))) == 1
